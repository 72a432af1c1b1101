"""Scans: start, wait, order, read."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Literal, cast, overload

from . import steps, tables
from ._api import CertaintyBody, FrameBody, FrameKind, IncidentBody, ObservationBody, ObservationsBody, Plan, ScanBody
from ._api import ScanState
from ._connection import Connection
from ._progress import Bar, Progress, ShowProgress
from .errors import Conflict, ScanStopped, WorkFailed, WrongValue
from .fits import Fit
from .jobs import FOLLOWS_S, Map, Pace, Work
from .steps import OnStep, OperatorStep

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

#: States that a scan does not leave.
ENDED: frozenset[ScanState] = frozenset({"completed", "aborted", "failed"})
#: Facts about the observations that a DataFrame has as `attrs`.
ATTRIBUTES = ("scan_id", "absolute", "complete", "region", "warnings")


class Scan:
    """A scan. `body` is the row of the daemon when it was last read."""

    def __init__(self, connection: Connection, body: ScanBody) -> None:
        self._connection = connection
        self.body = body

    def __repr__(self) -> str:
        return f"<scan {self.id} of {self.sample_name!r}: {self.state}>"

    @property
    def id(self) -> int:
        """Number of the scan."""
        return self.body["id"]

    @property
    def state(self) -> ScanState:
        """Its state when it was last read; `refresh` reads it again."""
        return self.body["state"]

    @property
    def reason(self) -> str | None:
        """Reason for the state, if it is not the normal course."""
        return self.body.get("reason")

    @property
    def sample_id(self) -> int:
        """Number of the part."""
        return self.body["sample_id"]

    @property
    def sample_name(self) -> str:
        """Name of the part."""
        return self.body["sample_name"]

    @property
    def plan(self) -> Plan:
        """The whole plan."""
        return self.body["plan"]

    @property
    def regions(self) -> list[str]:
        """Regions of a part with patches, each with a fit of its own; else empty."""
        return self.body["regions"]

    @property
    def step(self) -> OperatorStep | None:
        """The operator step that it waits for."""
        operator = self.body.get("operator")
        if operator is None:
            return None
        return OperatorStep(scan_id=self.id, action=operator["action"], message=operator["message"])

    @property
    def progress(self) -> Progress:
        """How far it is."""
        body = self.body["progress"]
        detail = f"{body['frames_done']} of {body['frames_total']} frames"
        if self.state != "running":
            detail = f"{self.state}, {detail}"
        return Progress(f"scan {self.id} {self.sample_name}", body["fraction"], body.get("time_left_s"), detail)

    def refresh(self) -> Scan:
        """Reads it again."""
        self.body = self._connection.get(f"/scans/{self.id}")
        return self

    def wait(
        self,
        *,
        timeout_s: float | None = None,
        progress: ShowProgress = True,
        on_step: OnStep | None = None,
        raise_on_pause: bool = False,
    ) -> Scan:
        """Waits until the scan is completed, and shows its progress.

        `on_step` is called at each operator step: `ridged.ask` (where a person can answer), `ridged.show` (the page
        confirms; elsewhere), `ridged.confirm` (a simulated rig), or a function of your own, e.g. for a robot.

        A scan that pauses can be resumed on the page or by another program, so the wait continues; `raise_on_pause`
        raises ScanStopped at once. Raises ScanStopped if the scan is aborted, fails or is interrupted, TimedOut after
        `timeout_s`. The scan itself continues after Ctrl-C, TimedOut and a loss of the connection.
        """
        on_step = on_step or steps.default()
        pace = Pace(f"scan {self.id}", timeout_s)
        # Each step and each pause is announced once.
        announced: tuple[str, str, int] | None = None
        with Bar(progress) as bar:
            while self.refresh().state not in ENDED:
                bar.update(self.progress)
                if self.state == "interrupted":
                    why = self.reason or "the daemon was ended"
                    raise ScanStopped(f"scan {self.id} was interrupted: {why}; scan.resume() continues it", self)
                step = self.step
                now = (self.state, step.action if step else self.reason or "", self.body["progress"]["frames_done"])
                if step is not None and now != announced:
                    announced = now
                    bar.note(f"scan {self.id}: {step.message}")
                    if on_step(step):
                        self.confirm(step)
                        continue
                if self.state == "paused" and now != announced:
                    announced = now
                    why = f"scan {self.id} is paused" + (f": {self.reason}" if self.reason else "")
                    if raise_on_pause:
                        raise ScanStopped(f"{why}; scan.resume() or scan.abort()", self)
                    bar.note(f"{why}; resume or abort it on the page")
                pace.wait()
        if self.state != "completed":
            raise ScanStopped(f"scan {self.id} is {self.state}" + (f": {self.reason}" if self.reason else ""), self)
        return self

    def confirm(self, step: OperatorStep | None = None) -> None:
        """Confirms an operator step: the given one, or the one that the scan waits for.

        A step that another one has confirmed in the meantime is no error.
        """
        body = None if step is None else {"action": step.action}
        try:
            self._order("continue", body)
        except Conflict:
            if step is None:
                raise
            self.refresh()

    def pause(self) -> None:
        """Pauses it: the stages stop, and the scan can be resumed."""
        self._order("pause")

    def resume(self) -> None:
        """Resumes a paused or interrupted scan."""
        self._order("resume")

    def abort(self) -> None:
        """Ends it for good and stops the stages. Its frames are kept."""
        self._order("abort")

    def assign(self, sample_id: int) -> None:
        """Assigns it to another part. The earlier one stays on record."""
        self.body = self._connection.patch(f"/scans/{self.id}", {"sample_id": sample_id})

    def _order(self, order: str, body: object = None) -> None:
        self._connection.post(f"/scans/{self.id}/{order}", body)
        self.refresh()

    @overload
    def observations(self, *, region: str | None = None, rows: Literal[True]) -> list[ObservationBody]: ...

    @overload
    def observations(
        self, *, region: str | None = None, rows: bool = False
    ) -> DataFrame | list[ObservationBody]: ...

    def observations(
        self, *, region: str | None = None, rows: bool = False
    ) -> DataFrame | list[ObservationBody]:
        """Returns the reduced measurements: theta_c_deg, phi_s_deg, signal, sigma (k = 1), n_frames.

        A DataFrame, with `absolute` (a white reference defines the scale), `complete`, `region` and `warnings` in its
        `attrs`; with `rows=True`, or without pandas, a list of typed rows.
        """
        body = self.reduced(region=region)
        facts = {name: value for name, value in body.items() if name in ATTRIBUTES}
        frame = None if rows else tables.frame_of(body["items"], facts)
        return body["items"] if frame is None else frame

    def reduced(self, *, region: str | None = None) -> ObservationsBody:
        """Returns the observations as the daemon states them, with the rejected frames and the warnings."""
        params = None if region is None else {"region": region}
        return cast("ObservationsBody", self._connection.get(f"/scans/{self.id}/observations", params))

    def frames(self, kind: FrameKind | None = None) -> list[FrameBody]:
        """Returns the frames, the rejected ones included, in the order in which they were taken."""
        return list(self._connection.pages(f"/scans/{self.id}/frames", {"kind": kind}, None))

    def image(self, frame_id: int) -> bytes:
        """Returns a frame as it is stored: a 16-bit grey PNG."""
        return self._connection.bytes_of(f"/frames/{frame_id}/image.png")

    def incidents(self) -> list[IncidentBody]:
        """Returns what went wrong during the scan, and what was overcome."""
        return list(self._connection.pages(f"/scans/{self.id}/incidents", {}, None))

    def uncertainty(self) -> list[CertaintyBody]:
        """Returns the fits during the scan: values with their standard uncertainties against the time of the rig."""
        return list(self._connection.pages(f"/scans/{self.id}/uncertainty", {}, None))

    def fits(self) -> list[Fit]:
        """Returns all fits of the scan, newest first."""
        rows = self._connection.pages("/fits", {"scan_id": self.id}, None)
        return [Fit(self._connection, row) for row in rows]

    @property
    def fit(self) -> Fit:
        """The newest fit that is not cancelled. Waits until it is over.

        Raises WorkFailed if there is none, or if it failed; WrongValue if each region of the part has its own.
        """
        if self.regions:
            raise WrongValue(
                f"scan {self.id} has a fit for each region ({', '.join(self.regions)}): use scan.fits(), whose `region` "
                "names it"
            )
        row = self._follower("fits", "has no fit; scan.start_fit() starts one", "not-fitted")
        return Fit(self._connection, row).wait(progress=False)

    def _follower(self, kind: str, otherwise: str, code: str) -> Any:
        """The newest fit or verdict of the scan. The daemon starts it a moment after what it follows."""
        until = time.monotonic() + FOLLOWS_S
        pace = Pace(f"scan {self.id}", None)
        while True:
            for row in self._connection.pages(f"/{kind}", {"scan_id": self.id}, None):
                if row["state"] not in ("cancelled", "interrupted"):
                    return row
            if self.state != "completed" or time.monotonic() >= until:
                raise WorkFailed(f"scan {self.id} is {self.state} and {otherwise}", code)
            pace.wait()

    def start_fit(self, *, variant: str = "auto", region: str | None = None, **options: Any) -> Fit:
        """Starts a fit and returns it; `fit.wait()` waits for it.

        `options` are the fields of the request, e.g. `fix={"rho_d": 0.3}`, `loss="huber"`, `max_seconds=60`.
        """
        request = {"scan_id": self.id, "variant": variant, **options}
        if region is not None:
            request["region"] = region
        return Fit(self._connection, self._begun("fits", request))

    @property
    def verdict(self) -> str:
        """`pass`, `fail` or `cannot-tell`: the newest verdict that is not cancelled. Waits until it is over.

        A scan with a specification is judged once it is fitted. Raises WorkFailed if there is no verdict.
        """
        if self.body.get("specification"):
            _ = self.fit
        row = self._follower("verdicts", "was not judged; scan.start_verdict() judges it", "not-judged")
        return str(Work(self._connection, "verdicts", row).result["verdict"])

    def start_map(self, **options: Any) -> Map:
        """Starts the fit of every pixel; `options` are `max_seconds` and `target_error`."""
        return Map(self._connection, "maps", self._begun("maps", {"scan_id": self.id, **options}))

    def start_contrast(self, region: str | None = None) -> Work:
        """Starts the measurement of the contrast after rotation."""
        request = {"scan_id": self.id, "region": region}
        return Work(self._connection, "contrasts", self._begun("contrasts", request))

    def start_verdict(self, specification: dict[str, Any], **options: Any) -> Work:
        """Starts the judgement against limits.

        E.g. `{"name": "part 17", "limits": {"theta_r_deg": {"lower": 9.5, "upper": 10.5}}}`. The `verdict` of the
        result is `pass`, `fail` or `cannot-tell`.
        """
        request = {"scan_id": self.id, "specification": specification, **options}
        return Work(self._connection, "verdicts", self._begun("verdicts", request))

    def _begun(self, kind: str, request: object) -> Any:
        begun = self._connection.post(f"/{kind}", request)
        return self._connection.get(f"/{kind}/{begun['id']}")

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draws the signal against φs, one colour per θc, with error bars; needs matplotlib."""
        from . import plots

        return plots.observations(self, axes)
