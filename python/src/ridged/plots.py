"""Plots with matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .fits import Fit
    from .jobs import Map
    from .scans import Scan

#: Coverage factor of the error bars.
K = 2


def new_axes(axes: Axes | None) -> Axes:
    """Returns the given axes, or those of a new figure."""
    if axes is not None:
        return axes
    from matplotlib import pyplot

    _, made = pyplot.subplots(layout="constrained")
    return cast("Axes", made)


def tilts(rows: list[Any]) -> list[float]:
    """The tilts of rows, in order, to 0.1°: positions that are read back scatter by less."""
    return sorted({round(row["theta_c_deg"], 1) for row in rows})


def colour(index: int, count: int) -> Any:
    """A colour for one tilt of several."""
    from matplotlib import colormaps

    return colormaps["viridis"](0.9 * index / max(count - 1, 1))


def finish(axes: Axes, ylabel: str, title: str) -> Axes:
    """Labels what all curves share."""
    axes.set_xlabel("sample azimuth φs / °")
    axes.set_ylabel(ylabel)
    axes.set_title(title)
    axes.legend(title="camera tilt θc", fontsize="small")
    return axes


def signal_label(is_absolute: bool) -> str:
    """Radiance over the irradiance of a surface that faces the lamp; without a white reference its unit is arbitrary."""
    return "BRDF × cos θi / sr⁻¹" if is_absolute else "signal / arbitrary unit"


def draw_points(axes: Axes, rows: list[Any], all_tilts: list[float], label: bool) -> None:
    """Draws signals with error bars."""
    for index, tilt in enumerate(all_tilts):
        own = [row for row in rows if round(row["theta_c_deg"], 1) == tilt]
        axes.errorbar(
            [row["phi_s_deg"] for row in own],
            [row["signal"] for row in own],
            yerr=[K * row["sigma"] for row in own],
            fmt="o",
            markersize=4,
            color=colour(index, len(all_tilts)),
            label=f"{tilt:g}°" if label else None,
        )


def observations(scan: Scan, axes: Axes | None = None) -> Axes:
    """The observations of a scan."""
    axes = new_axes(axes)
    reduced = scan.reduced()
    rows: list[Any] = reduced["items"]
    draw_points(axes, rows, tilts(rows), label=True)
    title = f"scan {scan.id}, {scan.sample_name} (bars: U, k = {K}, counting noise)"
    return finish(axes, signal_label(reduced["absolute"]), title)


def fit_over_data(fit: Fit, axes: Axes | None = None) -> Axes:
    """The curves of a fit over the observations."""
    axes = new_axes(axes)
    curves = fit.curves()
    rows: list[Any] = curves["observations"]
    all_tilts = sorted({*tilts(rows), *(round(curve["theta_c_deg"], 1) for curve in curves["curves"])})
    for curve in curves["curves"]:
        tilt = round(curve["theta_c_deg"], 1)
        shade = colour(all_tilts.index(tilt), len(all_tilts))
        axes.plot(curve["phi_s_deg"], curve["signal"], color=shade, linewidth=1, label=f"{tilt:g}°")
    draw_points(axes, rows, all_tilts, label=not curves["curves"])
    return finish(axes, signal_label(fit.is_absolute()), f"fit {fit.id} of scan {fit.scan_id}: θr = {fit.theta_r}")


def residuals(fit: Fit, axes: Axes | None = None) -> Axes:
    """Residuals of a fit in percent of the largest observation."""
    axes = new_axes(axes)
    rows: list[Any] = fit.points()
    all_tilts = tilts(rows)
    for index, tilt in enumerate(all_tilts):
        own = [row for row in rows if round(row["theta_c_deg"], 1) == tilt]
        axes.plot(
            [row["phi_s_deg"] for row in own],
            [100 * row["residual"] for row in own],
            "o-",
            markersize=4,
            color=colour(index, len(all_tilts)),
            label=f"{tilt:g}°",
        )
    axes.axhline(0, color="grey", linewidth=0.5)
    return finish(axes, "residual / % of the largest observation", f"fit {fit.id} of scan {fit.scan_id}")


def map_of(of: Map, name: str, axes: Axes | None = None) -> Axes:
    """One quantity over the sample, from its 2nd to its 98th percentile."""
    import numpy

    axes = new_axes(axes)
    values = of.array(name)
    known = values[numpy.isfinite(values)]
    low, high = numpy.percentile(known, [2, 98]) if known.size else (0.0, 1.0)
    image = axes.imshow(values, vmin=low, vmax=high)
    axes.figure.colorbar(image, ax=axes, label=name)
    axes.set_xlabel("column / px")
    axes.set_ylabel("row / px")
    axes.set_title(f"map {of.id} of scan {of.body['scan_id']}")
    return axes
