"""The devices under the real RunEngine: a plan that scans, pauses, resumes and aborts."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import pytest
from bluesky import RunEngine, plan_stubs, plans, protocols
from bluesky.utils import FailedStatus, RunEngineInterrupted

import ridged
import ridged.bluesky
from ridged.bluesky import Devices

Documents = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def engine() -> RunEngine:
    return RunEngine(context_managers=[])


@pytest.fixture
def devices(lab: ridged.Lab) -> Devices:
    lab.rig.home(timeout_s=60)
    return ridged.bluesky.devices(lab, on_step=ridged.confirm)


def collected(engine: RunEngine, plan: Any) -> Documents:
    documents: Documents = defaultdict(list)
    engine(plan, lambda name, document: documents[name].append(document))
    return documents


def when(condition: Callable[[], bool], action: Callable[[], object]) -> threading.Thread:
    """Does something from a thread once a condition holds."""

    def watch() -> None:
        until = time.monotonic() + 60
        while not condition() and time.monotonic() < until:
            time.sleep(0.02)
        action()

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


def frames_of(devices: Devices) -> int:
    scan = devices.scan.last_scan
    return 0 if scan is None else scan.refresh().body["progress"]["frames_done"]


def test_the_devices_have_the_protocols(devices: Devices) -> None:
    motor: tuple[type, ...] = (protocols.NamedMovable, protocols.Readable, protocols.Locatable, protocols.Stoppable)
    flyer: tuple[type, ...] = (protocols.Flyable, protocols.EventCollectable, protocols.Pausable, protocols.Stoppable)
    for protocol in motor:
        assert isinstance(devices.theta_c, protocol) and isinstance(devices.phi_s, protocol)
    for protocol in flyer:
        assert isinstance(devices.scan, protocol)


def test_both_axes_move_and_are_read(engine: RunEngine, devices: Devices) -> None:
    points: tuple[Any, ...] = (devices.theta_c, [-5, 5], devices.phi_s, [30, 60])
    documents = collected(engine, plans.list_scan([], *points))
    events = [event["data"] for event in documents["event"]]
    assert [round(event["theta_c"], 2) for event in events] == [-5, 5]
    assert [round(event["phi_s"], 2) for event in events] == [30, 60]
    assert devices.theta_c.locate()["setpoint"] == 5
    with pytest.raises(ridged.WrongValue, match="outside its travel"):
        devices.theta_c.check_value(61)
    with pytest.raises(FailedStatus, match="theta_c to 900°: .*limits -60"):
        engine(plan_stubs.mv(devices.theta_c, 900))


def test_a_scan_pauses_resumes_and_gives_its_documents(engine: RunEngine, devices: Devices) -> None:
    devices.scan.prepare_scan(
        "model 15°", theta_c_deg=[-20, -10, 0, 10, 20], phi_s_deg=range(0, 360, 45), exposures_s=[0.02]
    )
    documents: Documents = defaultdict(list)
    token = engine.subscribe(lambda name, document: documents[name].append(document))
    pausing = when(lambda: frames_of(devices) >= 12, engine.request_pause)
    with pytest.raises(RunEngineInterrupted):
        engine(ridged.bluesky.measure(devices.scan, md={"lot": 3}))
    pausing.join()
    scan = devices.scan.last_scan
    assert scan is not None and scan.refresh().state == "paused"
    frames = frames_of(devices)
    time.sleep(0.2)
    assert frames_of(devices) == frames, "nothing is measured during the pause"
    engine.resume()
    engine.unsubscribe(token)
    assert scan.refresh().state == "completed"
    assert documents["start"][0]["lot"] == 3
    assert documents["stop"][0]["exit_status"] == "success"
    assert {descriptor["name"] for descriptor in documents["descriptor"]} == {"observations", "fit"}
    pages = {frozenset(page["data"]): page["data"] for page in documents["event_page"]}
    [fit] = [data for data in pages.values() if "scan_theta_r_deg" in data]
    [observations] = [data for data in pages.values() if "scan_signal" in data]
    assert len(observations["scan_signal"]) == 40
    assert fit["scan_scan_id"] == [scan.id]
    assert abs(fit["scan_theta_r_deg"][0] - 15) < fit["scan_theta_r_U_deg"][0]


def test_poses_of_a_script_are_one_scan_in_their_order(engine: RunEngine, lab: ridged.Lab) -> None:
    poses = [(10, 90), (-10, 0), (10, 0), (0, 45), (-10, 90), (0, 0), (0, 90), (10, 45), (-10, 45)]
    steps: list[ridged.OperatorStep] = []

    def noted(step: ridged.OperatorStep) -> bool:
        steps.append(step)
        return ridged.confirm(step)

    scanner = ridged.bluesky.devices(lab, on_step=noted).scan
    scanner.prepare_scan("model 15°", poses=poses, exposures_s=[0.02])
    documents = collected(engine, ridged.bluesky.measure(scanner))
    pages = {frozenset(page["data"]): page["data"] for page in documents["event_page"]}
    [observations] = [data for data in pages.values() if "scan_signal" in data]
    assert len(observations["scan_signal"]) == 9
    assert len(steps) <= 3, "cap, white reference and sample once"
    scan = scanner.last_scan
    assert scan is not None
    assert [(pose["theta_c_deg"], pose["phi_s_deg"]) for pose in scan.body["plan"]["poses"]] == poses


@pytest.mark.parametrize("by", ["the plan of the package", "the plan of Bluesky"])
def test_an_abort_ends_the_scan_and_stops_the_rig(
    engine: RunEngine, devices: Devices, lab: ridged.Lab, by: str
) -> None:
    devices.scan.prepare_scan("model 15°", preset="full", exposures_s=[0.02])
    plan = ridged.bluesky.measure(devices.scan) if by == "the plan of the package" else plans.fly([devices.scan])
    documents: Documents = defaultdict(list)
    token = engine.subscribe(lambda name, document: documents[name].append(document))
    aborting = when(lambda: frames_of(devices) >= 12, engine.abort)
    with pytest.raises(RunEngineInterrupted):
        engine(plan)
    aborting.join()
    engine.unsubscribe(token)
    scan = devices.scan.last_scan
    assert scan is not None and scan.refresh().state == "aborted"
    assert documents["stop"][0]["exit_status"] == "abort"
    status = lab.rig.status()
    assert status.activity == "idle"
    assert not any(status.axis(axis)["moving"] for axis in ("theta_c", "phi_s"))


def test_a_refused_scan_fails_the_plan_with_the_words_of_the_daemon(engine: RunEngine, devices: Devices) -> None:
    devices.scan.prepare_scan("model 15°", theta_c_deg=[900], phi_s_deg=[0])
    with pytest.raises(FailedStatus, match="outside the travel") as failed:
        engine(ridged.bluesky.measure(devices.scan))
    assert isinstance(failed.value.__cause__, ridged.Invalid)
