"""Operator steps: what a person does at the rig before a scan continues, and who confirms it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ._api import OperatorAction
from ._progress import can_ask


@dataclass(frozen=True)
class OperatorStep:
    """A step that a scan waits for."""

    scan_id: int
    """Number of the scan."""
    action: OperatorAction
    """The step, as a word: cap-lens, place-white-reference, place-sample."""
    message: str
    """What to do, as a sentence."""


OnStep = Callable[[OperatorStep], bool]
"""Called at each step. It returns True if the step is done, so that the scan continues, and False if another one confirms it."""


def ask(step: OperatorStep) -> bool:
    """Asks the person at this program to do the step and to press Enter."""
    input(f"scan {step.scan_id}: {step.message} Press Enter when it is done. ")
    return True


def show(step: OperatorStep) -> bool:
    """Leaves the confirmation to the page, or to another program."""
    del step
    return False


def confirm(step: OperatorStep) -> bool:
    """Confirms the step at once: for a simulated rig, which does the step itself."""
    del step
    return True


def default() -> OnStep:
    """Asks where a person can answer, and waits for the page elsewhere."""
    return ask if can_ask() else show
