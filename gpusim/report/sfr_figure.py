"""Slanted edges on one page: where they lie, their profiles, their SFR with its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from gpusim.metrics.sfr import Edge
from gpusim.report.drawing import INK, LINE, SOFT, STYLE, panel, titles, write

COLOURS = {"R": "#c0342b", "G": "#1b8a6b", "B": "#2456b8", "Y": "#1b1f24", "W": "#1b1f24"}
STYLES = ("-", (0, (5, 2)), (0, (1, 1.5)), (0, (6, 2, 1, 2)), (0, (3, 1, 1, 1, 1, 1)))
LISTED = 3  # edges that are drawn as curves, the longest: more cannot be told apart
COVER = 1.96  # of the band: 95 %
_FOOT = (
    "SFR along the edge's normal, the quantity of ISO 12233:2023 e-SFR, by least squares on the "
    "pixels' own distances; bands: 95 % by the pixels' residuals."
)


def draw_sfr(
    found: Sequence[Edge], values: np.ndarray, title: str, cutoff_cy_px: float | None
) -> Figure:
    """Return the page.

    Parameters
    ----------
    found : sequence of Edge
    values : ndarray (rows, cols)
        The channel that is shown as the picture.
    title : str
    cutoff_cy_px : float, optional
        Where a diffraction-limited lens ends: its MTF is drawn too.
    """
    numbers = list(dict.fromkeys(edge.number for edge in found))[:LISTED]
    shown = [edge for edge in found if edge.number in numbers]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.2, 8.6))
        count = len({edge.number for edge in found})
        channels = ", ".join(dict.fromkeys(edge.channel for edge in found))
        how = f"{count} edge{'s' * (count != 1)}, channels {channels}"
        if count > LISTED:
            how += f"; the {LISTED} longest as curves"
        titles(figure, title, [how], top=8.55)
        _picture(panel(figure, 0.6, 4.35, 5.2, 2.95), found, values)
        _profiles(panel(figure, 6.7, 4.35, 5.0, 2.95), shown)
        _responses(panel(figure, 0.8, 0.95, 10.9, 2.75), shown, cutoff_cy_px)
        write(figure, 0.55, 0.25, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _look(edge: Edge, found: Sequence[Edge]) -> dict:
    numbers = list(dict.fromkeys(one.number for one in found))
    style = STYLES[numbers.index(edge.number) % len(STYLES)]
    return {"color": COLOURS.get(edge.channel[0], INK), "linestyle": style}


def _picture(axes: Axes, found: Sequence[Edge], values: np.ndarray) -> None:
    step = max(1, max(values.shape) // 1200)
    seen = np.nan_to_num(values[::step, ::step].astype(np.float64))
    low, high = np.quantile(seen, (0.001, 0.995))
    light = np.clip((seen - low) / max(high - low, 1e-30), 0, 1) ** (1 / 2.2)
    axes.imshow(light, cmap="gray", extent=(0, values.shape[1], values.shape[0], 0), vmin=0, vmax=1)
    for number, (x, y, width, height) in {edge.number: edge.region for edge in found}.items():
        axes.add_patch(
            Rectangle((x, y), width, height, fill=False, edgecolor="#ff8c1a", linewidth=1.2)
        )
        axes.annotate(
            str(number),
            (x, y),
            (1, 2),
            textcoords="offset points",
            color="#ff8c1a",
            fontsize=8,
            weight="bold",
        )
    axes.grid(False)
    axes.set(title="Regions", xlabel="x [px]", ylabel="y [px]")


def _profiles(axes: Axes, shown: Sequence[Edge]) -> None:
    reach = 4 + 3 * max(edge.sfr.rise_px for edge in shown)
    for edge in shown:
        sfr = edge.sfr
        axes.plot(sfr.distance_px, sfr.esf, **_look(edge, shown))
    axes.axhline(0, color=LINE, linewidth=0.8)
    axes.axhline(1, color=LINE, linewidth=0.8)
    axes.set(
        title="Edge spread functions", xlabel="distance from the edge [px]", ylabel="of the step"
    )
    axes.set_xlim(-reach, reach)


def _responses(axes: Axes, shown: Sequence[Edge], cutoff_cy_px: float | None) -> None:
    top = 1.05
    for edge in shown:
        sfr, look = edge.sfr, _look(edge, shown)
        half = sfr.falls_to(0.5)
        name = f"{edge.number} {edge.channel}"
        if half is not None:
            name += f"   MTF50 {half.value:.3f} \N{PLUS-MINUS SIGN} {half.u:.3f} c/px"
        axes.plot(sfr.frequency_cy_px, sfr.sfr, label=name, **look)
        band = COVER * sfr.u_sfr
        axes.fill_between(
            sfr.frequency_cy_px,
            np.maximum(sfr.sfr - band, 0),
            sfr.sfr + band,
            color=look["color"],
            alpha=0.14,
            linewidth=0,
        )
        top = max(top, 1.05 * sfr.sfr.max())
    if cutoff_cy_px is not None:
        f = np.linspace(0, min(2.0, cutoff_cy_px), 200)
        at = f / cutoff_cy_px
        axes.plot(
            f,
            2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2)),
            color=SOFT,
            linewidth=0.9,
            label="diffraction limit",
        )
    axes.axvline(0.5, color=SOFT, linewidth=0.7, linestyle=(0, (2, 2)))
    axes.annotate(
        "Nyquist", (0.5, top), (3, -9), textcoords="offset points", fontsize=7.5, color=SOFT
    )
    axes.set(title="Spatial frequency response", xlabel="cycles per pixel", ylabel="SFR")
    axes.set_xlim(0, 2)
    axes.set_ylim(0, top)
    axes.legend(loc="upper right", ncol=1 + (len(shown) > 8))
