"""Errors: what the daemon refuses, and what happens on the way to it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    import httpx

    from ._api import FieldProblem, HolderBody, Problem, QueueBody
    from .scans import Scan


class RidgedError(Exception):
    """Base of all errors of this package."""


class WrongValue(RidgedError, ValueError):
    """A value that this program gave, or asks for, cannot be used; nothing was sent. The message names it."""


class NoDaemon(RidgedError):
    """No daemon was found, or the one that was found does not answer."""


class ConnectionLost(RidgedError):
    """The daemon stopped answering and did not return within the patience of the connection."""


class Refused(RidgedError):
    """The daemon refused a request.

    `code` is a stable word for programs, `str(error)` the daemon's own words.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem["detail"])
        self.problem = problem

    @property
    def code(self) -> str:
        """Stable word for programs, e.g. `plan-invalid`."""
        return self.problem["code"]

    @property
    def status(self) -> int:
        """Status of the HTTP answer."""
        return self.problem["status"]

    @property
    def title(self) -> str:
        """The kind of problem in words."""
        return self.problem["title"]

    @property
    def fields(self) -> list[FieldProblem]:
        """Each wrong value with its path, its message and, where it has one, its range."""
        return self.problem.get("errors", [])


class Unauthorized(Refused):
    """The daemon asks for a token, or the token lacks the role."""


class NotFound(Refused):
    """There is no such part, scan, fit or file."""


class Conflict(Refused):
    """The state of the rig or of the scan does not allow it now."""


class LeaseHeld(Conflict):
    """Another caller holds the rig; `holder` names it."""

    @property
    def holder(self) -> HolderBody | None:
        """Who holds the rig, and until when."""
        return self.problem.get("holder")


class LeaseLost(Conflict):
    """The lease has ended, by its term, by a restart of the daemon, or because another caller took the rig over."""


class Invalid(Refused):
    """A value is not valid; `fields` lists each of them."""


class Unavailable(Refused):
    """Stages, camera, disk or daemon cannot do it now."""


class MotionFailed(RidgedError):
    """A motion did not reach its target."""


class ScanStopped(RidgedError):
    """A scan ended, or paused, before it was completed."""

    def __init__(self, message: str, scan: Scan) -> None:
        super().__init__(message)
        self.scan = scan


class QueueStopped(RidgedError):
    """The queue stopped while orders wait; `status` is its state."""

    def __init__(self, message: str, status: QueueBody) -> None:
        super().__init__(message)
        self.status = status


class WorkFailed(RidgedError):
    """A fit, map, contrast, verdict or trace ended without a result; `code` is a stable word."""

    def __init__(self, message: str, code: str) -> None:
        super().__init__(message)
        self.code = code


class TimedOut(RidgedError):
    """What was waited for was not over in the time given. It continues."""


BY_CODE: dict[str, type[Refused]] = {"lease-held": LeaseHeld, "lease-lost": LeaseLost}
BY_STATUS: dict[int, type[Refused]] = {
    401: Unauthorized,
    403: Unauthorized,
    404: NotFound,
    409: Conflict,
    400: Invalid,
    413: Invalid,
    422: Invalid,
    429: Unavailable,
    503: Unavailable,
    507: Unavailable,
}


def problem_of(answer: httpx.Response) -> Problem:
    """Reads the problem of an answer. An answer of another program, e.g. of a proxy, becomes a problem with its status."""
    try:
        body = json.loads(answer.content)
    except ValueError:
        body = None
    if isinstance(body, dict) and isinstance(body.get("code"), str) and isinstance(body.get("detail"), str):
        body.setdefault("status", answer.status_code)
        body.setdefault("title", answer.reason_phrase)
        return cast("Problem", body)
    start = answer.text[:200].strip()
    foreign = {
        "type": "about:blank",
        "title": answer.reason_phrase,
        "status": answer.status_code,
        # No daemon answers with this code.
        "code": "not-ridged",
        "detail": f"{answer.url.host} answered {answer.status_code} {answer.reason_phrase}, not as ridged does: {start!r}",
    }
    return cast("Problem", foreign)


def refusal(answer: httpx.Response) -> Refused:
    """Returns the error of an answer that is not a success."""
    problem = problem_of(answer)
    kind = BY_CODE.get(problem["code"]) or BY_STATUS.get(answer.status_code, Refused)
    return kind(problem)
