"""Rows as a DataFrame where pandas is installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import DataFrame


def frame_of(rows: Sequence[Any], attributes: dict[str, object] | None = None) -> DataFrame | None:
    """Returns rows as a DataFrame, with facts about them in its `attrs`; None without pandas."""
    try:
        import pandas
    except ImportError:
        return None
    frame = pandas.DataFrame(list(rows))
    frame.attrs.update(attributes or {})
    return frame
