"""A scan from its start to its answer."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import Daemon

import ridged
from ridged import fits, samples


def test_a_scan_tells_its_steps_and_its_progress(lab: ridged.Lab, capsys: pytest.CaptureFixture[str]) -> None:
    steps: list[ridged.OperatorStep] = []
    shown: list[ridged.Progress] = []

    def on_step(step: ridged.OperatorStep) -> bool:
        steps.append(step)
        return True

    scan = lab.measure(
        "model 15°", theta_c_deg=[-10, 10], phi_s_deg=(0, 180), exposures_s=[0.02], plan={"reuse_calibrations": False}
    )
    assert scan.wait(on_step=on_step, progress=shown.append, timeout_s=60) is scan
    assert [step.action for step in steps] == ["cap-lens", "place-white-reference", "place-sample"]
    assert "cap on the lens" in steps[0].message
    assert shown[0].what == f"scan {scan.id} model 15°"
    assert max(progress.fraction for progress in shown) > 0.0
    assert capsys.readouterr().err == "", "a function takes the place of the bar"
    scan = lab.measure("model 15°", theta_c_deg=[-10, 10], phi_s_deg=(0, 180), exposures_s=[0.02])
    scan.wait(on_step=ridged.confirm, timeout_s=60)
    lines = capsys.readouterr().err.splitlines()
    assert f"scan {scan.id}: Take the cap off, put the part on the table, then continue." in lines


def test_observations_are_a_table_or_typed_rows(scan: ridged.Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    pandas = pytest.importorskip("pandas")
    table = scan.observations()
    assert isinstance(table, pandas.DataFrame)
    assert list(table.columns) == ["theta_c_deg", "phi_s_deg", "signal", "sigma", "n_frames"]
    assert len(table) == 15
    assert table.attrs["absolute"] is True
    rows = scan.observations(rows=True)
    assert rows[0]["theta_c_deg"] == pytest.approx(-20, abs=0.01)
    monkeypatch.setitem(sys.modules, "pandas", None)
    assert scan.observations() == rows
    without = scan.fit.table()
    assert isinstance(without, list) and isinstance(without[0], ridged.Quantity)


def test_the_fit_of_a_scan_has_value_u_and_U(scan: ridged.Scan) -> None:
    theta_r = scan.fit.theta_r
    assert theta_r.value is not None and theta_r.u is not None and theta_r.U is not None and theta_r.k is not None
    assert abs(theta_r.value - 15) < theta_r.U
    assert theta_r.U == pytest.approx(theta_r.k * theta_r.u)
    assert sum(part**2 for part in theta_r.budget.values()) ** 0.5 == pytest.approx(theta_r.u)
    assert float(theta_r) == theta_r.value
    assert scan.fit.status == "converged"
    assert scan.fit.id == scan.fits()[-1].id
    with pytest.raises(KeyError, match="theta_r_deg"):
        scan.fit["theta_x"]


def test_a_quantity_prints_its_expanded_uncertainty_with_k() -> None:
    known = fits.Quantity.of("theta_r_deg", {"identifiable": True, "value": 10.0312, "std": 0.0156, "expanded": 0.0312, "coverage_factor": 2.0})  # fmt: skip
    assert str(known) == "10.031 ± 0.031° (k = 2)"
    unknown = fits.Quantity.of("rho_d", {"identifiable": False, "note": "no white reference"})
    assert str(unknown) == "not determined (no white reference)"
    with pytest.raises(ridged.WrongValue, match="no white reference"):
        float(unknown)
    assert [fits.decimals(number) for number in (0.031, 0.0996, 0.00015, 12.0, 1.0)] == [3, 2, 5, 0, 1]


def test_fits_with_options_verdicts_and_contrasts_give_results(scan: ridged.Scan, lab: ridged.Lab) -> None:
    fit = scan.start_fit(variant="sawtooth", fix={"rho_d": 0.3}).wait(progress=False, timeout_s=120)
    assert fit.rho_d.value == pytest.approx(0.3)
    assert lab.fit(fit.id).theta_r == fit.theta_r
    assert fit.id in [found.id for found in lab.fits(theta_r_deg_min=14, theta_r_deg_max=16)]
    limits = {"theta_r_deg": {"lower": 14.5, "upper": 15.5}}
    verdict = scan.start_verdict({"name": "part 17", "limits": limits}, variant="sawtooth")
    assert verdict.result["verdict"] == "pass"
    contrast = scan.start_contrast()
    assert contrast.result["lines"][0]["theta_c_deg"] == pytest.approx(-20, abs=0.01)
    failing = scan.start_map()
    with pytest.raises(ridged.WorkFailed, match="scan more tilts") as failed:
        failing.wait(progress=False, timeout_s=120)
    assert failed.value.code == "no-map"


def test_frames_and_calibrations_are_listed(scan: ridged.Scan, lab: ridged.Lab) -> None:
    frames = scan.frames("sample")
    assert len(frames) == 30
    assert scan.image(frames[0]["id"]).startswith(b"\x89PNG")
    assert {calibration["kind"] for calibration in lab.calibrations()} == {"dark", "flat"}
    assert scan.id in [found.id for found in lab.scans(sample="model 15°", state="completed")]
    assert lab.scans(limit=1)[0].id >= scan.id
    assert scan.incidents() == []
    assert scan.uncertainty()


def test_a_recipe_states_plan_fit_and_material_and_a_specification_judges(lab: ridged.Lab) -> None:
    material = {"eta": 1.54, "eta_std": 0.005}
    plan = {"theta_c_deg": [-20, -10, 0, 10, 20], "phi_s_deg": [0, 90, 180, 270], "exposures_s": [0.02]}
    added = lab.add_recipe({"name": "PX-1204", "plan": plan, "material": material, "fit": {"variant": "sawtooth"}})
    assert lab.recipe("PX-1204") == added == lab.recipe(added["id"])
    limits = {"theta_r_deg": {"lower": 0.0, "upper": 45.0}}
    specification = lab.add_specification({"name": "drawing 4711", "limits": limits})
    assert specification["name"] in [found["name"] for found in lab.specifications()]
    scan = lab.measure("B-18", recipe="PX-1204", specification="drawing 4711", lot="7", operator_name="Anna")
    scan.wait(on_step=ridged.confirm, progress=False, timeout_s=60)
    assert (scan.body.get("lot"), scan.body.get("operator_name")) == ("7", "Anna")
    assert scan.sample_name == "B-18" and lab.sample("B-18").material["eta"] == 1.54
    assert scan.verdict == "pass"
    assert scan.fit.body["variant"] == "sawtooth"
    with pytest.raises(ridged.NotFound, match=r"lab.recipes\(\)"):
        lab.measure("B-19", recipe="PX-1205")
    with pytest.raises(ridged.WrongValue, match="not both"):
        lab.measure("B-18", recipe="PX-1204", preset="paper")


def test_an_aborted_scan_and_a_time_limit_raise(lab: ridged.Lab) -> None:
    scan = lab.measure("model 15°", preset="full")
    with pytest.raises(ridged.TimedOut, match="it continues"):
        scan.wait(on_step=ridged.show, progress=False, timeout_s=0.2)
    with pytest.raises(ridged.Conflict) as refused:
        lab.measure("model 15°", preset="full")
    assert refused.value.code == "busy"
    scan.pause()
    with pytest.raises(ridged.ScanStopped, match="paused"):
        scan.wait(progress=False, raise_on_pause=True)
    scan.abort()
    with pytest.raises(ridged.ScanStopped, match="aborted"):
        scan.wait(progress=False)
    with pytest.raises(ridged.WorkFailed, match="has no fit"):
        _ = scan.fit


def test_samples_are_added_found_and_renamed(lab: ridged.Lab) -> None:
    sample = lab.add_sample("B-16", index=1.54, index_std=0.005, note="lot 3")
    sample.rename("B-17")
    assert lab.sample("B-17").id == sample.id
    assert lab.sample(sample.id).note == "lot 3"
    with pytest.raises(ridged.NotFound, match="add_sample"):
        lab.sample("B-16")
    lab.add_sample("B-17", metal="Cr")
    with pytest.raises(ridged.WrongValue, match=f"give the number of one: .*{sample.id}"):
        lab.sample("B-17")
    assert lab.add_sample("die", index=2.0 + 3.0j).material["kind"] == "conductor"
    with pytest.raises(ridged.WrongValue, match="give the material"):
        samples.request_of("x", None, None, None, None)


def test_an_estimate_moves_nothing(lab: ridged.Lab) -> None:
    estimate = lab.estimate("model 15°", preset="full", repeats=2)
    assert estimate["plan"]["repeats"] == 2
    assert estimate["duration_s"] > 0
    with pytest.raises(ridged.WrongValue, match="say what to visit"):
        lab.estimate("model 15°", theta_c_deg=[0])


def test_scans_are_compared_and_their_scatter_is_put_beside_the_stated_uncertainty(
    lab: ridged.Lab, scan: ridged.Scan
) -> None:
    again = lab.measure("model 15°", preset="paper").wait(on_step=ridged.confirm, progress=False, timeout_s=120)
    # The fits follow the scans.
    first, second = scan.fit.theta_r, again.fit.theta_r
    compared = lab.compare(scan, again.id)
    angle = compared["parameters"][0]
    difference = angle["difference"]
    assert angle["name"] == "theta_r_deg" and difference is not None
    assert difference["value"] == pytest.approx(float(second) - float(first))
    shared = {line["line"] for line in compared["shared_lines"] if line["shared"]}
    assert {"reference", "angles", "model"} <= shared
    apart = lab.compare(scan, again, shared=[])["parameters"][0]["difference"]
    assert apart is not None and first.u is not None and second.u is not None
    assert apart["std"] == pytest.approx((first.u**2 + second.u**2) ** 0.5)
    study = lab.repeatability([scan, again], shared=[])
    scatter = study["scatter"]
    assert scatter is not None
    assert scatter["std"] == pytest.approx(abs(difference["value"]) / 2**0.5)
    assert study["gauge"] is None and study["gauge_note"]
    with pytest.raises(ridged.Invalid, match="expected 2 to 200 scans"):
        lab.repeatability([scan])


def test_a_zip_archive_of_this_machine_is_imported(lab: ridged.Lab, tmp_path: Path) -> None:
    series = Path(__file__).parents[2] / "tests" / "data" / "series" / "paper-rig-full"
    archive = shutil.make_archive(str(tmp_path / "paper"), "zip", series)
    imported = lab.import_series(archive)
    assert imported.body["origin"] == "import"
    with pytest.raises(ridged.Invalid, match="pack the folder"):
        (tmp_path / "empty.zip").write_bytes(b"no archive")
        lab.import_series(tmp_path / "empty.zip")


def test_a_queue_measures_its_parts_and_their_results_are_a_table(own_daemon: Callable[..., Daemon]) -> None:
    with ridged.connect(data=own_daemon().data) as lab:
        lab.add_recipe(
            {
                "name": "quick",
                "plan": {"preset": "paper", "exposures_s": [0.02]},
                "fit": {"variant": "sawtooth"},
                "material": {"eta": 1.5},
            }
        )
        lab.add_specification({"name": "drawing", "limits": {"theta_r_deg": {"lower": 5, "upper": 30}}})
        parts = [{"part": "model 15°", "external_id": f"A-{n}"} for n in range(3)]
        orders = lab.queue.add(parts, recipe="quick", specification="drawing", lot="4")
        lab.queue.remove(lab.queue.add("model 15°", recipe="quick")[0]["id"])
        assert [order["state"] for order in lab.queue.orders()] == ["waiting"] * 3
        with pytest.raises(ridged.Conflict, match="A-0"):
            lab.queue.add(parts[0], recipe="quick")
        with pytest.raises(ridged.QueueStopped, match="while 3 orders wait"):
            lab.queue.wait(progress=False)
        assert lab.queue.move(orders[2]["id"], 1)["external_id"] == "A-2"
        lab.queue.start()
        seen: list[str] = []

        def on_step(step: ridged.OperatorStep) -> bool:
            seen.append(step.action)
            return True

        lab.queue.wait(on_step=on_step, progress=False, timeout_s=120)
        assert seen.count("place-sample") == 3
        assert seen.count("cap-lens") == 1, "references are taken once"
        done = lab.queue.orders("done")
        assert [order["external_id"] for order in done] == ["A-2", "A-0", "A-1"]
        # The wait includes the fit and the verdict of the last part.
        assert [order["verdict"] for order in done] == ["pass"] * 3
        for order in done:
            assert order["scan_id"] is not None
            lab.scan(order["scan_id"]).fit.wait(progress=False)
        rows = lab.results(lot="4", rows=True, sort="scan_id")
        assert [row["external_id"] for row in rows] == ["A-2", "A-0", "A-1"]
        table = lab.results(lot="4", limit=2)
        assert not isinstance(table, list) and list(table["recipe"]) == ["quick", "quick"]
        assert lab.results(lot="5", rows=True) == []
