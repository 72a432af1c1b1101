"""Fits: parameters with their uncertainties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

from . import tables
from ._api import CurvesBody, FitFinding, FitParameter, PointBody
from ._api import Fit as FitBody
from ._connection import Connection
from ._progress import ShowProgress
from .errors import WrongValue
from .jobs import Work

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame


@dataclass(frozen=True)
class Quantity:
    """A fitted parameter with its uncertainty. What the data do not determine has no value, and `note` says why."""

    name: str
    """Name of the parameter, with its unit."""
    value: float | None
    """Estimate, in `unit`."""
    u: float | None
    """Standard uncertainty (k = 1)."""
    U: float | None
    """Expanded uncertainty: k × u."""
    k: float | None
    """Coverage factor of U."""
    unit: str
    """`°`, or empty for a number without unit."""
    identifiable: bool
    """Whether the data determine it."""
    note: str | None
    """E.g. why it has no value, or that it was fixed."""
    budget: Mapping[str, float] = field(repr=False)
    """Contributions to u, by source. Their squares add up to u²."""

    @classmethod
    def of(cls, name: str, body: FitParameter) -> Quantity:
        """Reads a parameter of a fit."""
        return cls(
            name=name,
            value=body.get("value"),
            u=body.get("std"),
            U=body.get("expanded"),
            k=body.get("coverage_factor"),
            unit="°" if name.endswith("_deg") else "",
            identifiable=body["identifiable"],
            note=body.get("note"),
            budget=body.get("budget") or {},
        )

    def __float__(self) -> float:
        if self.value is None:
            raise WrongValue(f"{self.name} has no value: {self.note or 'the data do not determine it'}")
        return self.value

    def __str__(self) -> str:
        if self.value is None:
            return f"not determined ({self.note})" if self.note else "not determined"
        if not self.U:
            return f"{self.value:.6g}{self.unit}" + (f" ({self.note})" if self.note else "")
        digits = decimals(self.U)
        return f"{self.value:.{digits}f} ± {self.U:.{digits}f}{self.unit} (k = {self.k or 2:.3g})"


def decimals(uncertainty: float) -> int:
    """Decimals that show two significant digits of an uncertainty."""
    exponent = int(f"{uncertainty:.1e}".split("e")[1])
    return max(0, 1 - exponent)


class Fit(Work):
    """A fit of a scan. `body` is the row of the daemon, as `ridged fit --json` prints it."""

    body: FitBody

    def __init__(self, connection: Connection, body: FitBody) -> None:
        super().__init__(connection, "fits", cast("dict[str, Any]", body))

    def __repr__(self) -> str:
        shown = str(self.theta_r) if self.state == "completed" and self.body.get("parameters") else self.state
        return f"<fit {self.id} of scan {self.scan_id}: θr {shown}>"

    def wait(self, *, timeout_s: float | None = None, progress: ShowProgress = True) -> Fit:
        """Waits until it is over. Raises WorkFailed if it gave no result, TimedOut after `timeout_s`."""
        super().wait(timeout_s=timeout_s, progress=progress)
        return self

    @property
    def scan_id(self) -> int:
        """Number of the scan."""
        return self.body["scan_id"]

    @property
    def region(self) -> str | None:
        """Region of the part; None for the whole."""
        return self.body.get("region")

    @property
    def status(self) -> str | None:
        """How the search ended: `converged`, or a word for what hindered it."""
        return self.body.get("status")

    @property
    def warnings(self) -> list[str]:
        """What one has to act on, as sentences."""
        return self.body.get("warnings", [])

    @property
    def notes(self) -> list[str]:
        """What is good to know, as sentences."""
        return self.body.get("notes", [])

    @property
    def findings(self) -> list[FitFinding]:
        """Properties of the sample or the rig that explain a residual, with what to do."""
        return self.body.get("findings", [])

    @property
    def parameters(self) -> dict[str, Quantity]:
        """All parameters by name."""
        bodies = cast("dict[str, FitParameter | None]", self.body.get("parameters") or {})
        return {name: Quantity.of(name, body) for name, body in bodies.items() if body}

    def __getitem__(self, name: str) -> Quantity:
        parameters = self.parameters
        if name not in parameters:
            has = f"it has {', '.join(parameters)}" if parameters else f"it has none yet ({self.state})"
            raise KeyError(f"fit {self.id} has no parameter {name}; {has}")
        return parameters[name]

    @property
    def theta_r(self) -> Quantity:
        """Ridge angle θr, degrees."""
        return self["theta_r_deg"]

    @property
    def alpha_u(self) -> Quantity:
        """Roughness along the ridges."""
        return self["alpha_u"]

    @property
    def alpha_v(self) -> Quantity:
        """Roughness across the ridges."""
        return self["alpha_v"]

    @property
    def rho_d(self) -> Quantity:
        """Diffuse reflectance ρd; without value if there was no white reference."""
        return self["rho_d"]

    @property
    def azimuth_offset(self) -> Quantity:
        """What to add to a recorded azimuth φs, degrees."""
        return self["azimuth_offset_deg"]

    @property
    def tilt_offset(self) -> Quantity:
        """What to add to a recorded tilt θc, degrees."""
        return self["tilt_offset_deg"]

    def table(self) -> DataFrame | list[Quantity]:
        """All parameters as a DataFrame (name, value, u, U, k, unit, identifiable, note); without pandas a list."""
        rows = list(self.parameters.values())
        columns = ("name", "value", "u", "U", "k", "unit", "identifiable", "note")
        frame = tables.frame_of([{name: getattr(row, name) for name in columns} for row in rows])
        return rows if frame is None else frame

    def points(self) -> list[PointBody]:
        """Each observation with the value that the fit predicts and the residual."""
        return self.curves()["observations"]

    def curves(self, step_deg: float | None = None) -> CurvesBody:
        """The fitted model along φs, one curve per tilt, with the observations."""
        params = None if step_deg is None else {"step_deg": step_deg}
        return cast("CurvesBody", self._connection.get(f"/fits/{self.id}/curve", params))

    def is_absolute(self) -> bool:
        """Whether a white reference defines the scale of the signals."""
        params = {"limit": 1} | ({"region": self.region} if self.region else {})
        return bool(self._connection.get(f"/scans/{self.scan_id}/observations", params)["absolute"])

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draws observations and fitted curves against φs, one colour per θc; needs matplotlib."""
        from . import plots

        return plots.fit_over_data(self, axes)

    def plot_residuals(self, axes: Axes | None = None) -> Axes:
        """Draws the residuals of the fit in percent of the largest observation; needs matplotlib."""
        from . import plots

        return plots.residuals(self, axes)


