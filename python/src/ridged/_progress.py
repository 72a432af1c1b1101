"""Progress on a terminal or in a notebook, on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

#: Characters of the bar.
WIDTH = 24


@dataclass(frozen=True)
class Progress:
    """How far something is."""

    what: str
    """What it is, e.g. `scan 3`."""
    fraction: float
    """Share of the predicted time that is over, 0 to 1."""
    time_left_s: float | None
    """Predicted time left, s; None if unknown."""
    detail: str
    """E.g. the number of frames."""

    def __str__(self) -> str:
        fraction = min(max(self.fraction, 0.0), 1.0)
        done = round(fraction * WIDTH)
        left = "" if self.time_left_s is None else f"  {clock(self.time_left_s)} left"
        return f"{self.what} [{'#' * done}{'.' * (WIDTH - done)}] {fraction:4.0%}  {self.detail}{left}"


ShowProgress = bool | Callable[[Progress], None]
"""True: a bar on a terminal and in a notebook, else only the lines that matter. False: nothing. Or a function to call."""


def clock(seconds: float) -> str:
    """A time to go: `0:42`, `1:05:00`."""
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def in_notebook() -> bool:
    """Whether the code runs in a Jupyter kernel."""
    shell = sys.modules.get("IPython")
    found = shell.get_ipython() if shell is not None else None
    return type(found).__name__ == "ZMQInteractiveShell"


def can_ask() -> bool:
    """Whether a person can answer a question of the program."""
    stdin = sys.stdin
    return in_notebook() or (stdin is not None and stdin.isatty())


class Bar:
    """The line of progress, and lines above it. A `with` block ends it."""

    def __init__(self, show: ShowProgress) -> None:
        self._call = show if callable(show) else None
        self._is_quiet = show is False or callable(show)
        self._has_line = not self._is_quiet and (sys.stderr.isatty() or in_notebook())
        self._shown = ""

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, *_: object) -> None:
        self._clear()

    def update(self, progress: Progress) -> None:
        """Shows how far it is."""
        if self._call is not None:
            self._call(progress)
        text = str(progress)
        if self._has_line and text != self._shown:
            sys.stderr.write("\r" + text.ljust(len(self._shown)))
            sys.stderr.flush()
            self._shown = text

    def note(self, text: str) -> None:
        """Writes a line that stays."""
        if not self._is_quiet:
            self._clear()
            sys.stderr.write(text + "\n")
            sys.stderr.flush()

    def _clear(self) -> None:
        if self._shown:
            sys.stderr.write("\r" + " " * len(self._shown) + "\r")
            sys.stderr.flush()
            self._shown = ""
