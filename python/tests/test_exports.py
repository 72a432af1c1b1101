"""Files of a scan, read by the programs that they are for."""

from __future__ import annotations

import csv
import io
import json
import math
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import mitsuba
import numpy
import pytest

import ridged
from conftest import RIDGED, Daemon


def export(daemon: Daemon, scan: ridged.Scan, kind: str, file: Path) -> Path:
    """Writes a file of a scan beside the running daemon."""
    options = {"--data": daemon.data, "--scan": scan.id, "--format": kind, "--out": file}
    command = [str(RIDGED), "export", *(str(word) for option in options.items() for word in option)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return file


class Surface(NamedTuple):
    """A sawtooth as `ridged eval sawtooth` reads it; the index is 1.54."""

    theta_r: float
    alpha_u: float
    alpha_v: float
    rho_d: float
    eta: float
    k: float
    theta_l: float
    translucency: float
    tail: float
    crest_radius: float
    land_share: float

    @classmethod
    def of(cls, scan: ridged.Scan) -> Surface:
        """The surface that the fit of a scan found."""
        result = scan.fit.result
        assert result["variant"] == "sawtooth"
        value = {name: parameter["value"] for name, parameter in result["parameters"].items() if parameter}
        shape = (result.get("slope_distribution") or {}).get("shape")
        return cls(
            theta_r=math.radians(value["theta_r_deg"]),
            alpha_u=value["alpha_u"],
            alpha_v=value["alpha_v"],
            rho_d=value["rho_d"],
            eta=1.54,
            k=0.0,
            theta_l=math.radians(10.0),
            translucency=value.get("translucency", 0.0),
            tail=0.0 if shape is None else 1 / (shape - 1),
            crest_radius=value.get("crest_radius", 0.0),
            land_share=value.get("land_share", 0.0),
        )

    def brdf(self, pairs: Sequence[Sequence[float]], folder: Path) -> numpy.ndarray[Any, Any]:
        """f in 1/sr for pairs of directions (theta_i, phi_i, theta_o, phi_o), by `ridged eval`."""
        cases, answers = folder / "cases.csv", folder / "answers.csv"
        with cases.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["theta_i", "phi_i", "theta_o", "phi_o", *self._fields])
            table.writerows([*pair, *self] for pair in pairs)
        subprocess.run([RIDGED, "eval", "sawtooth", "--cases", cases, "--out", answers], check=True, capture_output=True)
        with answers.open(newline="") as file:
            return numpy.array([float(row["f"]) for row in csv.DictReader(file)])


def material(file: Path) -> tuple[Any, Any]:
    """The material of a file in Mitsuba, and the context to evaluate it in."""
    mitsuba.set_variant("scalar_spectral")
    return mitsuba.load_dict({"type": "measured", "filename": str(file)}), mitsuba.BSDFContext()


def direction(theta: float, phi: float) -> list[float]:
    return [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]


def test_mitsuba_reads_the_fitted_surface_and_gets_its_values_back(
    scan: ridged.Scan, daemon: Daemon, tmp_path: Path
) -> None:
    surface = Surface.of(scan)
    bsdf, context = material(export(daemon, scan, "rgl", tmp_path / "surface.bsdf"))

    def at(theta: float, phi: float) -> Any:
        hit = mitsuba.SurfaceInteraction3f()
        hit.wi = direction(theta, phi)
        hit.wavelengths = [550.0] * 4
        return hit

    # 40 directions of incidence up to a limit, 60 outgoing ones for each: a third is spread over the hemisphere, the rest is
    # drawn by the renderer. The errors of f cos θo are over the largest value at the same incidence.
    random = numpy.random.default_rng(20)
    for limit_deg, rms_max in [(60, 0.007), (75, 0.03)]:
        pairs: list[tuple[float, ...]] = []
        read: list[float] = []
        while len(pairs) < 40 * 60:
            theta_i = math.acos(random.uniform(math.cos(math.radians(limit_deg)), 1))
            phi_i = random.uniform(-math.pi, math.pi)
            hit = at(theta_i, phi_i)
            outgoing: list[tuple[float, float]] = []
            while len(outgoing) < 60:
                wo = direction(math.acos(random.uniform(0.05, 1)), random.uniform(-math.pi, math.pi))
                if len(outgoing) % 3:
                    wo = list(bsdf.sample(context, hit, 0.5, random.uniform(size=2).tolist())[0].wo)
                if 0.05 < wo[2] < 1:
                    outgoing.append((math.acos(wo[2]), math.atan2(wo[1], wo[0])))
            pairs += [(theta_i, phi_i, theta_o, phi_o) for theta_o, phi_o in outgoing]
            read += [bsdf.eval(context, hit, direction(*o))[0] for o in outgoing]
        own = (surface.brdf(pairs, tmp_path) * numpy.cos([pair[2] for pair in pairs])).reshape(40, 60)
        errors = numpy.abs(numpy.reshape(read, (40, 60)) - own) / own.max(axis=1, keepdims=True)
        rms, most = float(numpy.sqrt(numpy.mean(errors**2))), float(numpy.quantile(errors, 0.95))
        print(f"up to {limit_deg}°: rms {rms:.2%}, 95 % below {most:.2%}, largest {errors.max():.1%}")
        assert rms < rms_max


def test_the_samples_of_mitsuba_have_the_density_of_the_file(scan: ridged.Scan, daemon: Daemon, tmp_path: Path) -> None:
    surface = Surface.of(scan)
    bsdf, context = material(export(daemon, scan, "rgl", tmp_path / "surface.bsdf"))
    hit = mitsuba.SurfaceInteraction3f()
    hit.wavelengths = [550.0] * 4
    n = 60
    cosines = (numpy.arange(n) + 0.5) / n
    azimuths = (numpy.arange(2 * n) + 0.5) / n * math.pi
    for theta_i, phi_i in [(0.2, 1.0), (0.8, -1.2)]:
        hit.wi = direction(theta_i, phi_i)
        random = numpy.random.default_rng(3)
        drawn = [bsdf.sample(context, hit, 0.5, random.uniform(size=2).tolist())[1][0] for _ in range(4000)]
        grid = [(theta_i, phi_i, math.acos(c), phi) for c in cosines for phi in azimuths]
        values = surface.brdf(grid, tmp_path) * numpy.repeat(cosines, 2 * n)
        reflectance = float(values.mean() * 2 * math.pi)
        assert numpy.mean(drawn) == pytest.approx(reflectance, rel=0.03)


def test_h5py_reads_frames_poses_observations_and_fit(scan: ridged.Scan, daemon: Daemon, tmp_path: Path) -> None:
    from PIL import Image

    fit = scan.fit
    file = export(daemon, scan, "nexus", tmp_path / "scan.nxs")
    with h5py.File(file) as nexus:
        assert (nexus.attrs["NX_class"], nexus.attrs["default"]) == ("NXroot", "entry")
        entry = nexus["entry"]
        classes = {name: group.attrs["NX_class"] for name, group in entry.items() if isinstance(group, h5py.Group)}
        assert classes == {
            "fit": "NXprocess",
            "frames": "NXdata",
            "instrument": "NXinstrument",
            "observations": "NXdata",
            "sample": "NXsample",
            "user": "NXuser",
        }
        assert entry.attrs["default"] == "observations"
        assert entry["sample/name"].asstr()[()] == "model 15°"

        frames = entry["frames"]
        assert (frames.attrs["signal"], list(frames.attrs["axes"])) == ("data", ["frame", ".", "."])
        data = frames["data"]
        rows = [row for row in scan.frames() if row["accepted"]]
        assert (data.dtype, data.compression, data.chunks[0]) == (numpy.uint16, "gzip", 1)
        detector = entry["instrument/detector"]
        assert (detector.attrs["NX_class"], detector["count_time"].attrs["units"]) == ("NXdetector", "s")
        kinds = {"sample": 0, "flat": 1, "dark": 2}
        names = list(detector["file_name"].asstr()[:])
        assert len(set(names)) == len(names) == data.shape[0]
        # Dark frames and white reference of an earlier scan count for this one as long as they are fresh.
        own_files = {row["file"] for row in rows}
        assert {key for key, name in zip(detector["image_key"], names, strict=True) if name not in own_files} <= {1, 2}
        for row in rows:
            k = names.index(row["file"])
            assert detector["image_key"][k] == kinds[row["kind"]]
            assert detector["count_time"][k] == row["exposure_s"]
            if row["kind"] == "sample":
                assert frames["camera_tilt"][k] == row["theta_c_deg"]
                assert frames["sample_rotation"][k] == row["phi_s_deg"]
        for row in rows[::11]:
            pixels = numpy.array(Image.open(io.BytesIO(scan.image(row["id"]))))
            assert numpy.array_equal(data[names.index(row["file"])], pixels)

        observations = entry["observations"]
        assert (observations.attrs["signal"], observations["signal"].attrs["units"]) == ("signal", "1/sr")
        own = [(row["signal"], row["sigma"]) for row in scan.observations(rows=True)]
        assert list(zip(observations["signal"], observations["signal_errors"], strict=True)) == own

        theta_r = entry["fit/parameters/theta_r_deg"]
        assert (theta_r[()], theta_r.attrs["units"]) == (fit.theta_r.value, "deg")
        assert theta_r.attrs["standard_uncertainty"] == fit.theta_r.u
        assert theta_r.attrs["expanded_uncertainty"] == fit.theta_r.U
        n = len(entry["fit/covariance/parameters"])
        assert entry["fit/covariance/values"].shape == (n, n)
        assert json.loads(entry["fit/report/data"].asstr()[()])["variant"] == fit.result["variant"]
