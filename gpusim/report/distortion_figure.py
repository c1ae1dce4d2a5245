"""Distortion on one page: the marks, LGD over the radius, its map, what the models miss."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gpusim.metrics.distortion import RADII, Distortion
from gpusim.report.drawing import COLOURS, INK, SOFT, STYLE, absent, panel, titles, write

MODELS = {
    "chosen": (INK, "-"),
    "3rd order": ("#2456b8", (0, (5, 2))),
    "5th order": ("#1b8a6b", (0, (2, 1.5))),
    "tangent": ("#c0342b", (0, (6, 2, 1, 2))),
}
_FOOT = (
    "LGD = (r_d - r_u) / r_u (ISO 17850:2015); the lattice may be tilted: a homography is fitted "
    "with each model; misses are distances in the picture."
)


def draw_distortion(found: Distortion, values: np.ndarray, title: str) -> Figure:
    """Return the page.

    Parameters
    ----------
    found : Distortion
    values : ndarray (rows, cols)
        The reference channel.
    title : str
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 8.8))
        order = [f"{len(found.cell)} {found.marks.kind}", f"reference channel {found.reference}"]
        titles(figure, title, order, top=8.75)
        _picture(panel(figure, 0.6, 4.6, 5.2, 3.0), found, values)
        _curves(panel(figure, 6.8, 4.6, 5.0, 3.0), found)
        _map(figure, panel(figure, 0.6, 0.95, 4.4, 2.95), found)
        _misses(panel(figure, 6.2, 0.95, 2.5, 2.95), found)
        _lateral(panel(figure, 9.5, 0.95, 2.3, 2.95), found)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _picture(axes: Axes, found: Distortion, values: np.ndarray) -> None:
    """Show the marks, and how far each lies from its undistorted place."""
    cols, rows = found.size
    step = max(1, max(values.shape) // 1200)
    seen = np.nan_to_num(values[::step, ::step].astype(np.float64))
    low, high = np.quantile(seen, (0.005, 0.995))
    light = 0.45 + 0.5 * np.clip((seen - low) / max(high - low, 1e-30), 0, 1)
    axes.imshow(light, cmap="gray", extent=(0, cols, rows, 0), vmin=0, vmax=1)
    ideal = found.fits["chosen"].ideal * found.corner_px + found.centre
    x, y = found.marks.x, found.marks.y
    axes.plot(*ideal.T, ".", color="#2456b8", markersize=3, label="undistorted")
    axes.plot(x, y, ".", color="#d2691e", markersize=3, label="found")
    for at in range(len(x)):
        axes.plot([ideal[at, 0], x[at]], [ideal[at, 1], y[at]], color="#d2691e", linewidth=0.7)
    axes.plot(*found.centre, "+", color=INK, markersize=8)
    axes.set(title="Marks", xlabel="x [px]", ylabel="y [px]")
    low, high = np.minimum(ideal.min(axis=0), 0), np.maximum(ideal.max(axis=0), found.size)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])
    axes.grid(False)
    axes.legend(loc="lower right", frameon=True, framealpha=0.9, edgecolor="none")


def _curves(axes: Axes, found: Distortion) -> None:
    farthest = found.radius.max()
    axes.plot(found.radius, 100 * found.lgd, ".", color=SOFT, markersize=3, label="marks")
    chosen = found.fits["chosen"]
    for name, (colour, style) in MODELS.items():
        fit = found.fits[name]
        label = name if name != "chosen" else f"chosen, r^{2 * len(chosen.coefficients) + 1}"
        curve = RADII[RADII <= farthest]
        axes.plot(
            curve,
            100 * fit.lgd(curve),
            color=colour,
            linestyle=style,
            label=f"{label}: misses {fit.rms_px:.3f} px",
        )
    axes.axvline(farthest, color=SOFT, linewidth=0.7, linestyle=(0, (2, 2)))
    axes.set(
        title="Local geometric distortion",
        xlabel="r_d, share of the way from the centre to the corner",
        ylabel="LGD [%]",
    )
    axes.set_xlim(0, 1)
    axes.legend(loc="best")


def _map(figure: Figure, axes: Axes, found: Distortion) -> None:
    cols, rows = found.size
    y, x = np.mgrid[0:rows:60j, 0:cols:80j]
    r = np.hypot(x - found.centre[0], y - found.centre[1]) / found.corner_px
    lgd = 100 * found.fits["chosen"].lgd(r)
    lgd[r > found.radius.max() + 0.02] = np.nan
    most = max(float(np.nanmax(np.abs(lgd))), 1e-3)
    drawn = axes.contourf(x, y, lgd, levels=np.linspace(-most, most, 25), cmap="RdBu_r")
    figure.colorbar(drawn, ax=axes, format="%.3g")
    axes.set_aspect("equal")
    axes.invert_yaxis()
    axes.grid(False)
    axes.set(title="LGD [%], as far as there are marks", xlabel="x [px]", ylabel="y [px]")


def _misses(axes: Axes, found: Distortion) -> None:
    fit = found.fits["chosen"]
    for name, (colour, _) in list(MODELS.items())[1:]:
        far = np.hypot(*found.fits[name].miss_px.T)
        axes.plot(found.radius, far, ".", color=colour, markersize=2, label=name)
    axes.plot(found.radius, np.hypot(*fit.miss_px.T), ".", color=INK, markersize=3, label="chosen")
    axes.set(title="Misses of the models", xlabel="r_d", ylabel="[px]")
    axes.set_yscale("log")
    axes.set_xlim(0, 1)
    axes.legend(loc="lower right", handletextpad=0.2)


def _lateral(axes: Axes, found: Distortion) -> None:
    if not found.shifts:
        absent(axes, "Lateral colour", "one channel")
        return
    for one in found.shifts:
        colour = COLOURS.get(one.channel[0], INK)
        axes.plot(
            found.radius,
            one.radial_px,
            ".",
            color=colour,
            markersize=3,
            label=f"{one.channel} - {found.reference}",
        )
        r = RADII[RADII <= found.radius.max()]
        axes.plot(r, one.slope_px * r + one.cubic_px * r**3, color=colour, linewidth=0.9)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    axes.set(title="Lateral colour, outwards", xlabel="r_d", ylabel="[px]")
    axes.set_xlim(0, 1)
    axes.legend(loc="best", handletextpad=0.2)
