"""Devices for Bluesky: both axes as motors, and a scan as a flyer. Needs `pip install ridged[bluesky]`.

    import ridged.bluesky
    rig = ridged.bluesky.devices(ridged.connect())
    RE(bps.mv(rig.theta_c, 10, rig.phi_s, 90))
    rig.scan.prepare_scan("B-17", preset="paper")
    RE(ridged.bluesky.measure(rig.scan))

A pause of the RunEngine pauses the scan, `RE.resume()` resumes it, and `RE.abort()` aborts it and stops the rig.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from bluesky import plan_stubs, preprocessors
from bluesky.protocols import Hints, Location, Reading
from bluesky.utils import MsgGenerator
from event_model import DataKey, PartialEvent

from .errors import Conflict, MotionFailed, WrongValue
from .fits import Fit
from .lab import Lab
from .rig import AxisName
from .scans import ENDED, Scan
from .steps import OnStep, show

#: States in which a scan moves nothing.
HALTED = (*ENDED, "paused", "interrupted")


class Status:
    """Status of an action that runs on a thread of its own."""

    def __init__(self, action: Callable[[], None], name: str) -> None:
        self._callbacks: list[Callable[[Status], None]] = []
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._error: BaseException | None = None
        self._action = action
        self._name = name
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def __repr__(self) -> str:
        # The RunEngine shows this where an action failed.
        if not self.done:
            return f"<{self._name}: not over>"
        return f"<{self._name}: {self._error or 'done'}>"

    def _run(self) -> None:
        try:
            self._action()
        except Exception as error:
            self._error = error
        with self._lock:
            self._over.set()
            callbacks = list(self._callbacks)
        for callback in callbacks:
            callback(self)

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Calls a function with this status when the action is over, at once if it is."""
        with self._lock:
            if not self._over.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """The error of the action; None if there was none. Raises TimeoutError if it is not over after `timeout`."""
        if not self._over.wait(timeout):
            raise TimeoutError("the action is not over")
        return self._error

    @property
    def done(self) -> bool:
        """Whether the action is over."""
        return self._over.is_set()

    @property
    def success(self) -> bool:
        """Whether it is over and had no error."""
        return self.done and self._error is None


class Motor:
    """An axis of the rig, in degrees."""

    parent = None

    def __init__(self, lab: Lab, axis: AxisName, name: str, turn: threading.Lock) -> None:
        self.name = name
        self._lab = lab
        self._axis = axis
        # The rig takes one motion at a time; motions that a plan starts together follow one another.
        self._turn = turn
        self._target_deg: float | None = None
        self._stops = 0

    def __repr__(self) -> str:
        return f"Motor({self._axis!r}, name={self.name!r})"

    @property
    def hints(self) -> Hints:
        """What to plot."""
        return {"fields": [self.name]}

    @property
    def position(self) -> float:
        """Position, degrees. Raises MotionFailed if it is unknown."""
        status = self._lab.rig.status()
        position = status.position_deg(self._axis)
        if position is None:
            raise MotionFailed(f"the position of {self.name} is unknown: {status.problem or 'home the rig first'}")
        return position

    def set(self, value: float) -> Status:
        """Moves to a position."""
        self._target_deg = value
        asked_at = self._stops

        def move() -> None:
            with self._turn:
                # A stop also ends motions that have not begun.
                if self._stops != asked_at:
                    raise MotionFailed(f"{self.name} was stopped before its motion began")
                self._lab.rig.move_axis(self._axis, value)

        return Status(move, f"{self.name} to {value:g}°")

    def stop(self, success: bool = True) -> None:
        """Stops both axes of the rig."""
        del success
        self._stops += 1
        self._lab.rig.stop()

    def locate(self) -> Location[float]:
        """Target and position, degrees."""
        position = self.position
        return {"setpoint": position if self._target_deg is None else self._target_deg, "readback": position}

    def check_value(self, value: float) -> None:
        """Raises WrongValue for a position outside the travel."""
        axis = self._lab.rig.status().axis(self._axis)
        low, high = axis["limit_min_deg"], axis["limit_max_deg"]
        if not low <= value <= high:
            raise WrongValue(f"{self.name} {value:g}° is outside its travel, {low:g}° to {high:g}°")

    def read(self) -> dict[str, Reading[Any]]:
        """Position now."""
        return {self.name: {"value": self.position, "timestamp": time.time()}}

    def describe(self) -> dict[str, DataKey]:
        """Unit and source."""
        return {self.name: number(f"{self._lab.url}/api/v1/rig#{self._axis}", "deg")}

    def read_configuration(self) -> dict[str, Reading[Any]]:
        """The travel."""
        axis = self._lab.rig.status().axis(self._axis)
        now = time.time()
        return {
            f"{self.name}_limit_min": {"value": axis["limit_min_deg"], "timestamp": now},
            f"{self.name}_limit_max": {"value": axis["limit_max_deg"], "timestamp": now},
        }

    def describe_configuration(self) -> dict[str, DataKey]:
        """Units of the travel."""
        source = f"{self._lab.url}/api/v1/rig#{self._axis}"
        return {f"{self.name}_limit_{end}": number(source, "deg") for end in ("min", "max")}


class ScanFlyer:
    """A scan as a flyer: `kickoff` starts it, `complete` waits for it and its fit, `collect` gives the documents.

    Stream `observations` has one event per pose, stream `fit` one event with θr, u (k = 1), U and k.
    """

    parent = None

    def __init__(self, lab: Lab, name: str, on_step: OnStep) -> None:
        self.name = name
        self._lab = lab
        self._on_step = on_step
        self._start: Callable[[], Scan] | None = None
        self._scan: Scan | None = None
        self._fit: Fit | None = None
        self._is_resumed = False

    def __repr__(self) -> str:
        return f"ScanFlyer(name={self.name!r})"

    @property
    def last_scan(self) -> Scan | None:
        """The scan that runs, or the last one that ran."""
        return self._scan

    def prepare_scan(self, sample: str | int, **plan: Any) -> None:
        """States what the next scans measure, with the arguments of `lab.measure`."""
        self._start = lambda: self._lab.measure(sample, **plan)

    def kickoff(self) -> Status:
        """Starts the scan. After a pause the RunEngine repeats this: then the scan that was resumed goes on."""

        def start() -> None:
            if self._start is None:
                raise WrongValue(f"{self.name} has nothing to measure: call prepare_scan first")
            is_replay, self._is_resumed = self._is_resumed, False
            if is_replay and self._scan is not None and self._scan.refresh().state not in ENDED:
                return
            self._fit = None
            self._scan = self._start()

        return Status(start, f"{self.name} starts")

    def complete(self) -> Status:
        """Waits for the end of the scan and for its fit."""

        def wait() -> None:
            scan = self._running()
            scan.wait(progress=False, on_step=self._on_step)
            self._fit = scan.fit

        return Status(wait, f"{self.name} runs")

    def describe_collect(self) -> dict[str, dict[str, DataKey]]:
        """The streams and their keys."""
        source = f"{self._lab.url}/api/v1/scans"
        observations = {
            "theta_c_deg": number(source, "deg"),
            "phi_s_deg": number(source, "deg"),
            "signal": number(source),
            "sigma": number(source),
            "n_frames": integer(source),
        }
        fit = {
            "scan_id": integer(source),
            "fit_id": integer(source),
            "status": text(source),
            "theta_r_deg": number(source, "deg"),
            "theta_r_u_deg": number(source, "deg"),
            "theta_r_U_deg": number(source, "deg"),
            "theta_r_k": number(source),
        }
        streams = {"observations": observations, "fit": fit}
        return {
            stream: {f"{self.name}_{key}": description for key, description in keys.items()}
            for stream, keys in streams.items()
        }

    def collect(self) -> Iterator[PartialEvent]:
        """Gives observations and fit of a completed scan. One that still runs is aborted: the RunEngine gives it up."""
        scan = self._running()
        if scan.refresh().state not in ENDED:
            self.abort()
        if self._fit is None:
            return
        for row in scan.observations(rows=True):
            yield self._event(dict(row))
        theta_r = self._fit.theta_r
        nan = float("nan")
        yield self._event(
            {
                "scan_id": scan.id,
                "fit_id": self._fit.id,
                "status": self._fit.status or "",
                "theta_r_deg": nan if theta_r.value is None else theta_r.value,
                "theta_r_u_deg": nan if theta_r.u is None else theta_r.u,
                "theta_r_U_deg": nan if theta_r.U is None else theta_r.U,
                "theta_r_k": nan if theta_r.k is None else theta_r.k,
            }
        )

    def pause(self) -> None:
        """Pauses the scan, so that the stages stand still."""
        scan = self._scan
        if scan is None or scan.refresh().state in HALTED:
            return
        try:
            scan.pause()
        except Conflict:
            # It has ended or paused in the meantime.
            if scan.refresh().state not in (*HALTED, "pausing"):
                raise
        while scan.refresh().state not in HALTED:
            time.sleep(0.05)

    def resume(self) -> None:
        """Resumes the scan that a pause has stopped."""
        scan = self._scan
        if scan is not None and scan.refresh().state in ("paused", "interrupted"):
            self._is_resumed = True
            scan.resume()

    def stop(self, success: bool = True) -> None:
        """Aborts a scan that runs, and stops the stages."""
        del success
        self.abort()

    def abort(self) -> None:
        """Aborts the scan if it runs, and stops the rig in any case."""
        self._is_resumed = False
        try:
            scan = self._scan
            if scan is not None and scan.refresh().state not in ENDED:
                scan.abort()
        finally:
            self._lab.rig.stop()

    def _running(self) -> Scan:
        if self._scan is None:
            raise WrongValue(f"{self.name} has no scan: kickoff starts one")
        return self._scan

    def _event(self, values: Mapping[str, Any]) -> PartialEvent:
        data = {f"{self.name}_{key}": value for key, value in values.items()}
        now = time.time()
        return {"data": data, "timestamps": dict.fromkeys(data, now), "time": now}


@dataclass(frozen=True)
class Devices:
    """The devices of one rig."""

    theta_c: Motor
    """Camera tilt."""
    phi_s: Motor
    """Sample azimuth."""
    scan: ScanFlyer
    """A scan with its fit."""


def devices(lab: Lab, *, prefix: str = "", on_step: OnStep = show) -> Devices:
    """Returns the devices of a lab. `prefix` begins their names; `on_step` confirms operator steps (as in `Scan.wait`)."""
    turn = threading.Lock()
    return Devices(
        theta_c=Motor(lab, "theta_c", f"{prefix}theta_c", turn),
        phi_s=Motor(lab, "phi_s", f"{prefix}phi_s", turn),
        scan=ScanFlyer(lab, f"{prefix}scan", on_step),
    )


def measure(flyer: ScanFlyer, *, md: Mapping[str, Any] | None = None) -> MsgGenerator[str]:
    """A plan: one run with one scan. If the plan fails or is aborted, the scan is aborted and the rig stopped."""

    def abort(error: Exception) -> MsgGenerator[None]:
        del error
        flyer.abort()
        # Nothing is yielded: the engine would raise the failed status of the aborted scan in place of the abort.
        yield from ()

    def run() -> MsgGenerator[None]:
        yield from plan_stubs.checkpoint()
        yield from plan_stubs.kickoff(flyer, wait=True)
        yield from plan_stubs.complete(flyer, wait=True)
        yield from plan_stubs.collect(flyer)

    whole = preprocessors.run_wrapper(run(), md={"plan_name": "ridged_measure", **(md or {})})
    return (yield from preprocessors.contingency_wrapper(whole, except_plan=abort))


def number(source: str, units: str | None = None) -> DataKey:
    """Description of a number."""
    key: DataKey = {"source": source, "dtype": "number", "shape": []}
    if units is not None:
        key["units"] = units
    return key


def integer(source: str) -> DataKey:
    """Description of a whole number."""
    return {"source": source, "dtype": "integer", "shape": []}


def text(source: str) -> DataKey:
    """Description of a text."""
    return {"source": source, "dtype": "string", "shape": []}
