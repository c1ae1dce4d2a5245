"""What every figure shares: style, places in inches, names at curves, files."""

from __future__ import annotations

import io

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

DPI = 160


INK, SOFT, LINE = "#1b1f24", "#5d6773", "#c9ced6"


COLOURS = {"R": "#c0342b", "G": "#1b8a6b", "B": "#2456b8"}  # of channels, by their first letter
STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 7,
    "axes.labelsize": 8.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LINE,
    "grid.linewidth": 0.5,
    "grid.alpha": 0.7,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "text.color": INK,
    "mathtext.default": "regular",
}


def png(figure: Figure) -> bytes:
    """Return a page as a PNG file."""
    return _rendered(figure, "png")


def svg(figure: Figure) -> str:
    """Return a page as SVG, letters as outlines: it looks the same anywhere."""
    metadata = {"Date": None, "Creator": None}
    return _rendered(figure, "svg", metadata=metadata).decode()


def _rendered(figure: Figure, form: str, **options: object) -> bytes:
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "gpusim", "svg.fonttype": "path"}):
        figure.savefig(file, format=form, dpi=DPI, **options)
    return file.getvalue()


def panel(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Return axes at a place in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def write(figure: Figure, left: float, bottom: float, text: str, **style: object) -> None:
    """Write a text at a place in inches."""
    across, up = figure.get_size_inches()
    figure.text(left / across, bottom / up, text, **style)


def absent(axes: Axes, title: str, why: str) -> None:
    """Say in a panel what it would show, and why it does not."""
    axes.set(title=title, xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_color(LINE)
    axes.text(0.5, 0.5, why, color=SOFT, ha="center", va="center", transform=axes.transAxes)


def titles(figure: Figure, title: str, order: list[str], top: float) -> None:
    """Write the title of a page, and the line below it."""
    write(figure, 0.55, top - 0.42, title, fontsize=15, fontweight="bold", va="center")
    line = "   \N{MIDDLE DOT}   ".join(order)
    write(figure, 0.55, top - 0.74, line, fontsize=9, color=SOFT, va="center")


def facts(
    figure: Figure, rows: list[tuple[str, str]], left: float, top: float, width: float
) -> None:
    """Write names and texts as a table."""
    step = 2.75 / len(rows)
    for row, (name, text) in enumerate(rows):
        up = top - row * step
        write(figure, left, up, name, fontsize=7.8, color=SOFT, va="center")
        write(figure, left + width, up, text, fontsize=7.8, va="center", ha="right")
        if row:
            across, tall = figure.get_size_inches()
            figure.add_artist(
                Line2D(
                    [left / across, (left + width) / across],
                    [(up + step / 2) / tall] * 2,
                    color=LINE,
                    linewidth=0.4,
                )
            )


def roomy(axes: Axes) -> None:
    """Give curves that end at a border some room, and flat ones a scale."""
    low, high = axes.dataLim.intervaly
    low, high = min(low, 0.0), max(high, 0.0)
    pad = 0.08 * (high - low) if high - low > 1e-4 else 0.5
    axes.set_ylim(low - pad, high + pad)


def end_labels(axes: Axes, ends: list[tuple[float, str, object]]) -> None:
    """Write names beside the right ends of curves, apart from one another."""
    low, high = axes.get_ylim()
    height = axes.get_position().height * axes.figure.get_size_inches()[1] * 72  # points
    need = 10.0 / height * (high - low)
    ends = sorted(ends, key=lambda end: end[0])
    at = np.array([end[0] for end in ends])
    for _ in range(100):  # push neighbours apart until all have room
        close = np.maximum(need - np.diff(at), 0)
        if close.max(initial=0) < 1e-3 * need:
            break
        at[:-1] -= close / 2
        at[1:] += close / 2
        at += max(low - at[0], 0) - max(at[-1] - high, 0)
    for y, (_, name, colour) in zip(at, ends, strict=True):
        axes.annotate(
            name,
            (1, (y - low) / (high - low)),
            (4, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            va="center",
            fontsize=7.5,
            color=colour,
            annotation_clip=False,
        )
