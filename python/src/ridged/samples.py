"""Parts, which are samples in the names of the interface."""

from __future__ import annotations

from ._api import MaterialBody, SampleBody
from ._connection import Connection
from .errors import WrongValue


class Sample:
    """A part. `body` is the row of the daemon."""

    def __init__(self, connection: Connection, body: SampleBody) -> None:
        self._connection = connection
        self.body = body

    def __repr__(self) -> str:
        return f"<sample {self.id} {self.name!r}>"

    @property
    def id(self) -> int:
        """Number of the part."""
        return self.body["id"]

    @property
    def name(self) -> str:
        """Its name."""
        return self.body["name"]

    @property
    def material(self) -> MaterialBody:
        """Complex index with standard uncertainties."""
        return self.body["material"]

    @property
    def note(self) -> str | None:
        """A note; None if there is none."""
        return self.body.get("note")

    def rename(self, name: str) -> None:
        """Gives it another name. The earlier one stays on record (`body["earlier_names"]`)."""
        self.body = self._connection.patch(f"/samples/{self.id}", {"name": name})


def request_of(
    name: str, index: float | complex | None, index_std: float | None, metal: str | None, note: str | None
) -> dict[str, object]:
    """Returns the body that adds a part.

    Raises WrongValue unless exactly one of `index` and `metal` is given.
    """
    if (index is None) == (metal is None):
        raise WrongValue(
            "give the material: index=1.54 (or a complex index n + 1jk), or metal= a name (Ag, Al, Au, Cr, Cu, W)"
        )
    body: dict[str, object] = {"name": name}
    if note is not None:
        body["note"] = note
    if metal is not None:
        body["metal"] = {"name": metal}
        return body
    number = complex(index or 0.0)
    material: dict[str, object] = {"kind": "dielectric", "eta": number.real}
    if number.imag:
        material |= {"kind": "conductor", "k": abs(number.imag)}
    if index_std is not None:
        material["eta_std"] = index_std
        if number.imag:
            material["k_std"] = index_std
    body["material"] = material
    return body
