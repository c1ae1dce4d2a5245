"""Figures of the Kodak report, after the paper's own: edges, positions, transfer functions."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.drawing import COLOURS, INK, LINE, SOFT, STYLE, panel, titles, write
from gpusim.validate.edges import AXES
from gpusim.validate.kodak import (
    BANDS,
    INTER_BAND_BAR_PX,
    MTF_BAR,
    MTF_EDGES,
    POSITION_BAR_PX,
    REFERENCE,
    Edges,
)
from gpusim.validate.kodak_table import TABLE_1

MARKERS = {"vertical": "o", "horizontal": "s"}
NAMES = {"R": "Red", "G": "Green", "B": "Blue"}
SHOWN_EDGE = 5  # of the regions: the paper's figure 9 shows one near the right-hand side


def draw_positions(edges: Edges) -> Figure:
    """Return positions against prediction (table 1): absolute, and between bands."""
    numbers = np.array([place.number for place in TABLE_1])
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 5.4))
        told = "filled: ours, round near-vertical, square near-horizontal; "
        told += "crosses: the paper's, which are near-vertical"
        titles(figure, "Edge positions, measured less predicted", [edges.tracer, told], top=5.35)
        left = panel(figure, 0.75, 0.75, 4.6, 3.35)
        right = panel(figure, 6.2, 0.75, 4.6, 3.35)
        for k, band in enumerate(BANDS):
            look = {"color": COLOURS[band], "linestyle": "none"}
            at = numbers + 0.22 * (k - 1)
            paper = np.abs([place.position[k] for place in TABLE_1])
            left.plot(at, paper, marker="x", markersize=5, alpha=0.55, **look)
            for axis in AXES:
                own = [abs(edges.found[band, axis, n].error_px) for n in numbers]
                name = NAMES[band] if axis == AXES[0] else None
                left.plot(at, own, marker=MARKERS[axis], markersize=4, label=name, **look)
                if band != REFERENCE:
                    apart = [np.diff(edges.apart(band, axis, n))[0] for n in numbers]
                    shape = {"marker": MARKERS[axis], "markersize": 4}
                    right.plot(
                        at, np.abs(apart), label=name and f"{name} to green", **shape, **look
                    )
            if band != REFERENCE:
                paper = [getattr(p, NAMES[band].lower())[2] for p in TABLE_1]
                right.plot(at, np.abs(paper), marker="x", markersize=5, alpha=0.55, **look)
        bounds = {"Absolute": (left, POSITION_BAR_PX), "Between bands": (right, INTER_BAND_BAR_PX)}
        for title, (axes, bound) in bounds.items():
            axes.axhline(bound, color=INK, linewidth=0.9, linestyle=(0, (4, 2)))
            axes.annotate(
                f"bar {bound:g} px", (10.45, bound), (0, 3), textcoords="offset points", ha="right"
            )
            axes.set(title=title, xlabel="edge of table 1", ylabel="size of the error [px]")
            axes.set(yscale="log", ylim=(2e-5, 1), xlim=(0.4, 10.6), xticks=numbers)
            axes.legend(loc="lower right", ncol=3)
    return figure


def draw_mtfs(edges: Edges) -> Figure:
    """Return measured and predicted MTFs at three places (figures 10, 11 and 12)."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 9.6))
        told = f"line: predicted by {edges.tracer}; dots: measured in the render"
        titles(figure, "MTF of near-vertical edges", [told, "pixel aperture included"], top=9.55)
        for row, (number, where) in enumerate(MTF_EDGES.items()):
            for col, band in enumerate(BANDS):
                axes = panel(figure, 0.75 + 3.5 * col, 6.15 - 2.75 * row, 3.0, 2.05)
                one = edges.found[band, "vertical", number]
                axes.plot(FREQUENCIES_CY_PX, one.predicted_mtf, color=COLOURS[band])
                dots = {"marker": "o", "markersize": 3, "linestyle": "none", "color": INK}
                axes.plot(FREQUENCIES_CY_PX[::8], one.measured_mtf[::8], **dots)
                worst = f"largest difference {one.mtf_error:.4f}, bar {MTF_BAR:g}"
                axes.annotate(
                    worst, (0.98, 0.93), xycoords="axes fraction", ha="right", fontsize=7.5
                )
                axes.set(title=f"{NAMES[band]}, {where} (edge {number})", xlim=(0, 1), ylim=(0, 1))
                if row == 2:
                    axes.set_xlabel("cycles per pixel")
                if col == 0:
                    axes.set_ylabel("MTF")
    return figure


def draw_edges(edges: Edges) -> Figure:
    """Return an edge in three bands (figure 9), and its line spreads."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.2, 4.9))
        place = TABLE_1[SHOWN_EDGE - 1]
        told = f"edge {place.number}, {place.x:g} px right of the centre"
        titles(figure, "One edge in three bands", [told], top=4.85)
        spreads = panel(figure, 7.3, 0.75, 3.5, 2.95)
        for col, band in enumerate(BANDS):
            one = edges.found[band, "vertical", SHOWN_EDGE]
            axes = panel(figure, 0.55 + 2.15 * col, 0.95, 2.0, 2.6)
            top = 1.02 * float(one.picture.max())  # electrons/s
            axes.imshow(one.picture, cmap="gray", vmin=0, vmax=top, interpolation="nearest")
            axes.grid(False)
            axes.set(title=NAMES[band], xticks=[], yticks=[])
            away = one.predicted_px - edges.found[REFERENCE, "vertical", SHOWN_EDGE].predicted_px
            spreads.plot(one.distance_px + away, one.predicted_lsf, color=COLOURS[band])
            step = slice(None, None, 4)
            shown = {"linestyle": "none", "marker": "o", "markersize": 2.2, "color": COLOURS[band]}
            apart = edges.apart(band, "vertical", SHOWN_EDGE)[1]
            spreads.plot(one.distance_px[step] + apart, one.measured_lsf[step], **shown)
        spreads.set(xlim=(-6, 6), title="Line spreads: measured (dots), predicted")
        spreads.set(xlabel="distance from the green edge [px]", ylabel="per pixel")
        spreads.axhline(0, color=LINE, linewidth=0.8)
        note = "Red, green and blue lie apart: lateral colour. Coma makes the spreads lopsided."
        write(figure, 0.55, 0.3, note, fontsize=7.5, color=SOFT, va="center")
    return figure
