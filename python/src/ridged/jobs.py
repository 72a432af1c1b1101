"""Work of the daemon that takes a while: fits, maps, contrasts, verdicts, traces."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from ._api import TaskState, WorkProgress
from ._connection import Connection
from ._progress import Bar, Progress, ShowProgress
from .errors import TimedOut, WorkFailed

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy import float32
    from numpy.typing import NDArray

#: Time between two looks at running work, s: the first, and the longest.
LOOK_S, LOOK_S_MAX = 0.1, 1.0
#: Time after the end of a scan, or of its fit, within which the daemon starts what follows, s.
FOLLOWS_S = 3.0


class Pace:
    """Waits between two looks, longer from look to look, until a time limit."""

    def __init__(self, what: str, timeout_s: float | None) -> None:
        self._what = what
        self._timeout_s = timeout_s
        self._began = time.monotonic()
        self._pause_s = LOOK_S

    def wait(self) -> None:
        """Waits. Raises TimedOut at the time limit."""
        if self._timeout_s is not None and time.monotonic() - self._began >= self._timeout_s:
            raise TimedOut(f"{self._what} was not over after {self._timeout_s:g} s; it continues")
        time.sleep(self._pause_s)
        self._pause_s = min(self._pause_s * 1.3, LOOK_S_MAX)


class Work:
    """A piece of work. `body` is the row of the daemon, and has the result once it is completed."""

    def __init__(self, connection: Connection, kind: str, body: Mapping[str, Any]) -> None:
        self._connection = connection
        self.kind = kind
        self.body: Any = body

    def __repr__(self) -> str:
        return f"<{self.kind.removesuffix('s')} {self.id}: {self.state}>"

    @property
    def id(self) -> int:
        """Number of the work, counted per kind."""
        return int(self.body["id"])

    @property
    def state(self) -> TaskState:
        """`running`, `completed`, `failed`, `cancelled` or `interrupted`, when it was last read."""
        return cast("TaskState", self.body["state"])

    @property
    def result(self) -> Mapping[str, Any]:
        """The answer of the daemon with all results. Waits if the work is not over."""
        self.wait(progress=False)
        return cast("Mapping[str, Any]", self.body)

    def refresh(self) -> Work:
        """Reads its state again."""
        self.body = self._connection.get(f"/{self.kind}/{self.id}")
        return self

    def wait(self, *, timeout_s: float | None = None, progress: ShowProgress = True) -> Work:
        """Waits until it is over. Raises WorkFailed if it gave no result, TimedOut after `timeout_s`."""
        what = f"{self.kind.removesuffix('s')} {self.id}"
        pace = Pace(what, timeout_s)
        with Bar(progress) as bar:
            while self.state == "running":
                bar.update(progress_of(what, self.body.get("progress")))
                pace.wait()
                self.refresh()
        if self.state != "completed":
            error = self.body.get("error") or {}
            why = error.get("detail", "the daemon states no reason")
            raise WorkFailed(f"{what} is {self.state}: {why}", error.get("code", self.state))
        return self

    def cancel(self) -> None:
        """Ends it without a result."""
        self._connection.post(f"/{self.kind}/{self.id}/cancel")
        self.refresh()


class Files(Work):
    """Work that also makes files: a map or a trace."""

    def file(self, name: str) -> bytes:
        """Gets one of its files."""
        return self._connection.bytes_of(f"/{self.kind}/{self.id}/files/{name}")

    @property
    def files(self) -> list[str]:
        """Names of its files."""
        return [str(name) for name in self.result.get("files", [])]

    def save(self, folder: str | Path) -> list[Path]:
        """Writes all its files into a folder, which is made if it is missing. Returns their paths."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        paths = [folder / Path(name).name for name in self.files]
        for path in paths:
            path.write_bytes(self.file(path.name))
        return paths


class Map(Files):
    """The fit of every pixel."""

    def array(self, name: str = "theta_r_deg") -> NDArray[float32]:
        """Returns one quantity of every pixel, NaN where it has none; needs NumPy and Pillow (matplotlib brings both)."""
        import io

        import numpy
        from PIL import Image

        with Image.open(io.BytesIO(self.file(f"{name}.tif"))) as image:
            return numpy.array(image, dtype=numpy.float32)

    def plot(self, name: str = "theta_r_deg", axes: Axes | None = None) -> Axes:
        """Draws one quantity over the sample; needs matplotlib."""
        from . import plots

        return plots.map_of(self, name, axes)


def progress_of(what: str, body: WorkProgress | None) -> Progress:
    """The progress of running work."""
    if body is None:
        return Progress(what, 0.0, None, "starts")
    position = body.get("queued_position")
    detail = body["stage"] if not position else f"waits, {position} before it"
    return Progress(what, body["fraction"], body.get("time_left_s"), detail)
