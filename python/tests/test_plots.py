"""Plots, on the axes that they draw."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib
import numpy
import pytest

import ridged

matplotlib.use("Agg")


def test_curves_lie_over_the_observations(scan: ridged.Scan) -> None:
    axes = scan.plot()
    assert axes.get_ylabel() == "BRDF × cos θi / sr⁻¹"
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["-20°", "-10°", "0°", "10°", "20°"]
    axes = scan.fit.plot()
    assert "± " in axes.get_title() and "k = 2" in axes.get_title()
    curves = [line for line in axes.lines if numpy.size(line.get_xdata()) > 10]
    assert len(curves) == 5
    assert scan.fit.plot_residuals().get_ylabel() == "residual / % of the largest observation"
    matplotlib.pyplot.close("all")


def test_a_map_is_an_array_a_picture_and_files(lab: ridged.Lab, tmp_path: Path) -> None:
    scan = lab.measure(
        "model 15°", theta_c_deg=range(-30, 31, 15), phi_s_deg=range(0, 360, 60), exposures_s=[0.02]
    )
    scan.wait(on_step=ridged.confirm, progress=False, timeout_s=120)
    of = scan.start_map(max_seconds=60)
    of.wait(progress=False, timeout_s=300)
    values = of.array("theta_r_deg")
    assert values.shape == (128, 128)
    known = sorted(float(value) for value in values.flat if math.isfinite(value))
    assert known[len(known) // 2] == pytest.approx(15, abs=0.5)
    assert of.plot().get_title() == f"map {of.id} of scan {scan.id}"
    assert tmp_path / "theta_r_deg.tif" in of.save(tmp_path)
    assert (tmp_path / "summary.json").stat().st_size > 0
    matplotlib.pyplot.close("all")
