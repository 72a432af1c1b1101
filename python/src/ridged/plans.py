"""What a scan visits: a preset, or angles of one's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ._api import Preset
from .errors import WrongValue

Angles = Iterable[float]
"""Angles in degrees: a list, a range, or an array."""

Poses = Iterable[tuple[float, float]]
"""Poses as pairs of camera tilt θc and sample azimuth φs in degrees, in the order of the visits."""


def plan_of(
    plan: Mapping[str, Any] | None,
    preset: Preset | None,
    theta_c_deg: Angles | None,
    phi_s_deg: Angles | None,
    poses: Poses | None,
    exposures_s: Iterable[float] | None,
    repeats: int | None,
) -> dict[str, Any]:
    """Returns the plan of a request. What is given beside `plan` or `preset` replaces its part of it.

    Raises WrongValue if neither a plan, a preset, both angles nor poses are given.
    """
    wanted: dict[str, Any] = dict(plan or {})
    if preset is not None:
        wanted["preset"] = preset
    for name, numbers in (("theta_c_deg", theta_c_deg), ("phi_s_deg", phi_s_deg), ("exposures_s", exposures_s)):
        if numbers is not None:
            wanted[name] = [float(number) for number in numbers]
    if poses is not None:
        wanted["poses"] = [{"theta_c_deg": float(theta_c), "phi_s_deg": float(phi_s)} for theta_c, phi_s in poses]
    if repeats is not None:
        wanted["repeats"] = repeats
    if not {"preset", "poses"} & wanted.keys() and not {"theta_c_deg", "phi_s_deg"} <= wanted.keys():
        raise WrongValue(
            'say what to visit: preset="paper" (5 × 3 poses), preset="full" (9 × 12 poses), theta_c_deg= and phi_s_deg=, '
            "or poses="
        )
    return wanted
