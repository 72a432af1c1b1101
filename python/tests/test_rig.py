"""Motions, stop and lease."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

import ridged
from conftest import Daemon


def test_the_rig_is_homed_moved_and_read(lab: ridged.Lab) -> None:
    status = lab.rig.home(timeout_s=60)
    assert status.is_homed
    status = lab.rig.move(theta_c_deg=10, phi_s_deg=90, timeout_s=60)
    assert status.theta_c_deg == pytest.approx(10, abs=0.01)
    assert status.phi_s_deg == pytest.approx(90, abs=0.01)
    assert str(status) == "idle: theta_c 10.000°, phi_s 90.000°"


def test_a_preview_shows_a_frame_and_suggests_exposures(lab: ridged.Lab) -> None:
    before = len(list(lab.scans()))
    preview = lab.rig.preview([5.0], suggest=1)
    [frame] = preview.frames
    assert frame["saturated_px"] > 1000
    [exposure_s] = preview.suggested_exposures_s
    assert exposure_s < 5.0 and preview.reason is None
    fine = lab.rig.preview([exposure_s], suggest=0)
    assert fine.frames[0]["saturated_px"] == 0
    assert fine.suggested_exposures_s == []
    counts = fine.counts()
    assert len(counts) == frame["width_px"] * frame["height_px"]
    assert fine.frames[0]["max_dn"] in counts
    assert fine.png().startswith(b"\x89PNG")
    assert len(list(lab.scans())) == before


def test_a_number_that_json_cannot_have_is_named_before_anything_is_sent(lab: ridged.Lab) -> None:
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: lab.rig.move(theta_c_deg=float("nan")), "position_deg: expected a finite number, got nan"),
        (
            lambda: lab.estimate("model 15°", theta_c_deg=[0], phi_s_deg=[0], exposures_s=[1.0, float("inf")]),
            r"plan.exposures_s\[1\]: expected a finite number, got inf",
        ),
        (lambda: lab.add_recipe({"name": {1}}), "name: expected a number, .*got set"),
    ]
    for call, words in calls:
        with pytest.raises(ridged.WrongValue, match=words) as wrong:
            call()
        assert isinstance(wrong.value, ridged.RidgedError) and isinstance(wrong.value, ValueError)


def test_a_refusal_has_code_field_and_the_words_of_the_daemon(lab: ridged.Lab) -> None:
    with pytest.raises(ridged.Invalid, match="-60") as refused:
        lab.rig.move(theta_c_deg=900)
    assert refused.value.code == "outside-limits"
    with pytest.raises(ridged.Invalid) as refused:
        lab.measure("model 15°", theta_c_deg=[0, 900], phi_s_deg=[0])
    assert refused.value.code == "plan-invalid"
    [field] = refused.value.fields
    assert field["field"] == "plan.theta_c_deg[1]"
    assert field["out_of_range"] == {"value": 900.0, "lower": -60.0, "upper": 60.0}


def test_a_motion_that_was_stopped_raises(daemon: Daemon, lab: ridged.Lab) -> None:
    lab.rig.home(timeout_s=60)
    raised = threading.Event()

    def stop_motions() -> None:
        # A stop may come just after the motion that it was meant for.
        with ridged.connect(daemon.url) as other:
            while not raised.is_set():
                if other.rig.status().activity == "moving":
                    other.rig.stop()

    stopper = threading.Thread(target=stop_motions)
    stopper.start()
    try:
        with pytest.raises(ridged.MotionFailed, match="phi_s did not reach .* stopped"):
            for target in (380, 0) * 20:
                lab.rig.move(phi_s_deg=target, timeout_s=60)
    finally:
        raised.set()
        stopper.join()


def test_a_lease_keeps_others_out_until_it_is_returned_or_taken_over(daemon: Daemon, lab: ridged.Lab) -> None:
    lab.rig.home(timeout_s=60)
    with ridged.connect(daemon.url) as other:
        with lab.rig.lease("night run", seconds=10) as lease:
            assert lab.rig.move(theta_c_deg=5).theta_c_deg == pytest.approx(5, abs=0.01)
            with pytest.raises(ridged.LeaseHeld, match="night run") as refused:
                other.rig.move(theta_c_deg=0)
            holder = refused.value.holder
            assert holder is not None and holder["name"] == "night run"
            assert other.rig.holder() == holder
            other.rig.stop()
            assert not lease.lost
            with pytest.raises(ridged.WrongValue, match="already"), lab.rig.lease("inner"):
                pass
        assert other.rig.holder() is None
        with lab.rig.lease("night run", seconds=10) as lease, other.rig.lease("urgent", take_over=True) as taken:
            assert taken.taken_from is not None and taken.taken_from["name"] == "night run"
            until = time.monotonic() + 10
            while not lease.lost and time.monotonic() < until:
                time.sleep(0.05)
            assert lease.lost, "the renewal notices that another caller has the rig"
            with pytest.raises(ridged.LeaseHeld, match="urgent"):
                lab.rig.move(theta_c_deg=0)
        assert lab.rig.holder() is None
