"""The rig: positions, motions, stop, lease."""

from __future__ import annotations

import sys
import threading
from array import array
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, cast

from ._api import Activity, AxisBody, HolderBody, LeaseBody, LeaseStateBody, PreviewAnswer, PreviewFrameBody, RigBody
from ._connection import Connection, logger
from .errors import LeaseLost, MotionFailed, RidgedError, WrongValue
from .jobs import Pace

AxisName = Literal["theta_c", "phi_s"]
AXES: tuple[AxisName, AxisName] = ("theta_c", "phi_s")

#: Largest difference between a target and the position after the motion, degrees.
ARRIVED_DEG = 0.1


@dataclass(frozen=True)
class RigStatus:
    """State of the rig at one moment. `body` is the whole answer of the daemon."""

    body: RigBody

    @property
    def connected(self) -> bool:
        """Whether the stages answer."""
        return self.body["connected"]

    @property
    def activity(self) -> Activity:
        """`idle`, `moving`, `homing`, `scanning`, `paused` or `not-connected`."""
        return self.body["activity"]

    @property
    def is_simulated(self) -> bool:
        """Whether it is a simulated rig."""
        return self.body["simulated"]

    @property
    def problem(self) -> str | None:
        """What is wrong with the stages, and what to do; None if nothing is."""
        problem = self.body.get("problem")
        return problem["detail"] if problem else None

    @property
    def scan_id(self) -> int | None:
        """Number of the scan that holds the rig."""
        return self.body.get("scan_id")

    def axis(self, name: AxisName) -> AxisBody:
        """State of one axis."""
        return self.body["axes"][name]

    def position_deg(self, name: AxisName) -> float | None:
        """Position of an axis, degrees; None if it is not referenced or does not answer."""
        axis = self.axis(name)
        return axis.get("position_deg") if axis["referenced"] else None

    @property
    def theta_c_deg(self) -> float | None:
        """Camera tilt, degrees; None until it is known."""
        return self.position_deg("theta_c")

    @property
    def phi_s_deg(self) -> float | None:
        """Sample azimuth, degrees; None until it is known."""
        return self.position_deg("phi_s")

    @property
    def is_homed(self) -> bool:
        """Whether both positions are known."""
        return all(self.axis(name)["referenced"] for name in AXES)

    def __str__(self) -> str:
        words = []
        for name in AXES:
            position = self.position_deg(name)
            words.append(f"{name} {'unknown until homed' if position is None else f'{position:.3f}°'}")
        trouble = f"; {self.problem}" if self.problem else ""
        return f"{self.activity}: {', '.join(words)}{trouble}"


@dataclass(frozen=True)
class Preview:
    """Frames at one pose that were measured and not stored. `body` is the whole answer of the daemon."""

    body: PreviewAnswer
    _connection: Connection

    @property
    def frames(self) -> list[PreviewFrameBody]:
        """The figures of each exposure."""
        return self.body["frames"]

    @property
    def suggested_exposures_s(self) -> list[float]:
        """Exposures for a scan, shortest first; empty if there is no suggestion."""
        suggestion = self.body.get("suggestion")
        return list(suggestion["exposures_s"]) if suggestion else []

    @property
    def reason(self) -> str | None:
        """Why there is no suggestion, or why the brightest pixel does not reach 70 % of full scale."""
        suggestion = self.body.get("suggestion")
        return suggestion.get("reason") if suggestion else None

    def png(self, frame: int = 0) -> bytes:
        """Returns the 8-bit picture of a frame. Raises NotFound once the daemon has dropped it for newer ones."""
        return self._connection.bytes_of(self.frames[frame]["image"]["path"].removeprefix("/api/v1"))

    def counts(self, frame: int = 0) -> array[int]:
        """Returns the 16-bit counts of a frame, row by row from the top left. Raises NotFound as `png` does."""
        counts = array("H", self._connection.bytes_of(self.frames[frame]["pixels"].removeprefix("/api/v1")))
        if sys.byteorder == "big":
            counts.byteswap()
        return counts


class Rig:
    """The stages of the daemon."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def __repr__(self) -> str:
        return f"<rig {self.status()}>"

    def status(self) -> RigStatus:
        """Reads the state of the rig from the stages."""
        return RigStatus(cast("RigBody", self._connection.get("/rig")))

    def stop(self) -> None:
        """Stops both axes at once; a running scan pauses. It needs no lease.

        Raises Unavailable if the stages do not confirm it: use the hardware emergency switch.
        """
        self._connection.post("/rig/stop")

    def move(
        self,
        *,
        theta_c_deg: float | None = None,
        phi_s_deg: float | None = None,
        timeout_s: float | None = None,
    ) -> RigStatus:
        """Moves to a pose, one axis after the other, and waits for it. An angle that is omitted stays.

        Raises MotionFailed if an axis does not reach its target, e.g. after a stop.
        """
        targets: dict[AxisName, float | None] = {"theta_c": theta_c_deg, "phi_s": phi_s_deg}
        status = None
        for name, target in targets.items():
            if target is not None:
                status = self.move_axis(name, target, timeout_s=timeout_s)
        return status or self.status()

    def move_axis(self, axis: AxisName, position_deg: float, *, timeout_s: float | None = None) -> RigStatus:
        """Moves one axis and waits for it. Raises MotionFailed if it does not reach the position."""
        self._connection.post(f"/rig/axes/{axis}/move", {"position_deg": float(position_deg)})
        try:
            status = self.wait(timeout_s=timeout_s)
        except MotionFailed as error:
            raise MotionFailed(f"{axis} did not reach {position_deg:g}°: {error}") from None
        position = status.position_deg(axis)
        if position is None or abs(position - position_deg) > ARRIVED_DEG:
            at = "its position is unknown" if position is None else f"it is at {position:.3f}°"
            raise MotionFailed(f"{axis} did not reach {position_deg:g}°, {at}: {why_not(status)}")
        return status

    def home(self, *, timeout_s: float | None = None) -> RigStatus:
        """Homes both axes and waits for it. Raises MotionFailed if one has no reference afterwards."""
        self._connection.post("/rig/home")
        status = self.wait(timeout_s=timeout_s)
        if not status.is_homed:
            raise MotionFailed(f"the rig is not homed: {why_not(status)}")
        return status

    def wait(self, *, timeout_s: float | None = None) -> RigStatus:
        """Waits until no motion runs, and returns the state. A scan is not waited for.

        Raises MotionFailed if the motion failed.
        """
        pace = Pace("the motion", timeout_s)
        status = self.status()
        while status.activity in ("moving", "homing"):
            pace.wait()
            status = self.status()
        failure = status.body.get("failure")
        if failure:
            raise MotionFailed(failure["detail"])
        return status

    def preview(
        self,
        exposures_s: Iterable[float] | None = None,
        *,
        lamp: bool = True,
        suggest: int | None = None,
    ) -> Preview:
        """Takes a frame per exposure at the present pose and measures it; nothing moves and nothing is stored.

        `suggest` is the number of exposures to suggest for a scan, 0 to 2. Raises Conflict while a motion or a scan
        holds the rig.
        """
        body: dict[str, object] = {"lamp": lamp}
        if exposures_s is not None:
            body["exposures_s"] = [float(exposure_s) for exposure_s in exposures_s]
        if suggest is not None:
            body["suggest"] = suggest
        answer = self._connection.post("/rig/preview", body, timeout_s=None)
        return Preview(cast("PreviewAnswer", answer), self._connection)

    def unpark(self) -> None:
        """Releases axes that another program parked. They keep their positions and do not move."""
        for axis in AXES:
            self._connection.post(f"/rig/axes/{axis}/unpark")

    def holder(self) -> HolderBody | None:
        """Who holds the rig: the holder of the lease, or else the caller whose scan or motion runs."""
        state = cast("LeaseStateBody", self._connection.get("/lease"))
        return state.get("holder")

    @contextmanager
    def lease(self, name: str, *, seconds: int = 60, take_over: bool = False) -> Iterator[Lease]:
        """Holds the rig for a `with` block: other callers can read and stop, and are refused everything else.

        The lease is renewed in the background, so that it ends `seconds` after this program has gone. `name` is shown
        to others. Raises LeaseHeld if another caller holds the rig, unless `take_over` is true, and WrongValue inside
        another such block.
        """
        if self._connection.lease is not None:
            raise WrongValue("this connection presents a lease already (a `with` block around this one, or RIDGED_LEASE)")
        body = {"name": name, "seconds": seconds, "take_over": take_over}
        taken = cast("LeaseBody", self._connection.post("/lease", body))
        self._connection.lease = taken["id"]
        lease = Lease(self._connection, taken, seconds)
        try:
            yield lease
        finally:
            lease.end()
            self._connection.lease = None


class Lease:
    """A lease that is held and renewed."""

    def __init__(self, connection: Connection, body: LeaseBody, seconds: int) -> None:
        self.name = body["name"]
        self.taken_from = body.get("taken_from")
        self.lost = False
        self._connection = connection
        self._pause_s = seconds / 4
        self._is_over = threading.Event()
        self._renewal = threading.Thread(target=self._renew, name="ridged lease", daemon=True)
        self._renewal.start()

    def _renew(self) -> None:
        while not self._is_over.wait(self._pause_s):
            try:
                # Every request that presents the lease renews it.
                state = cast("LeaseStateBody", self._connection.get("/lease"))
            except RidgedError as error:
                logger.warning("the lease %r could not be renewed: %s", self.name, error)
                continue
            if not state["own"] and not self._is_over.is_set():
                self.lost = True
                holder = state.get("holder")
                to = f"{holder['who']} ({holder['name']}) holds the rig" if holder else "no caller holds the rig"
                logger.warning("the lease %r is lost: %s", self.name, to)
                return

    def end(self) -> None:
        """Returns the lease, if it is still held."""
        self._is_over.set()
        self._renewal.join()
        try:
            self._connection.delete("/lease")
        except LeaseLost:
            pass
        except RidgedError as error:
            if not self.lost:
                logger.warning("the lease %r was not returned: %s", self.name, error)


def why_not(status: RigStatus) -> str:
    """Why a motion did not end as it should."""
    return status.problem or "it was stopped, or another motion came between"

