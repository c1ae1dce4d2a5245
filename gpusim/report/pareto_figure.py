"""The work-precision diagram: certified error against run time, one line for each family."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from gpusim.pareto import CHOSEN, Point
from gpusim.report.words import duration

DPI = 160
_INK, _SOFT, _GRID = "#1b1f24", "#667080", "#e3e6ea"
# ColorBrewer's Dark2: told apart by all kinds of colour vision, with a mark of its own each.
_FAMILIES = (
    ("#1b1f24", "o"),
    ("#d9730d", "s"),
    ("#6a3fa0", "^"),
    ("#1b8a6b", "D"),
    ("#c2185b", "v"),
    ("#2463ad", "P"),
)
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.edgecolor": _SOFT,
    "axes.labelcolor": _INK,
    "xtick.color": _SOFT,
    "ytick.color": _SOFT,
    "text.color": _INK,
}


def draw(points: Sequence[Point], title: str, facts: str, unit: str, tolerance: float) -> Figure:
    """Return the diagram.

    Parameters
    ----------
    points : sequence of Point
        The chosen one among them; those without a frame are left out.
    title, facts : str
        What was rendered; where, and how it was certified.
    unit : str
        "relative" or "sigma": the error's.
    tolerance : float
        That the chosen plan was made for.
    """
    shown = [point for point in points if point.wall_s is not None]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(9.6, 6.2))
        axes = figure.add_axes((0.085, 0.1, 0.885, 0.75))
        axes.set_xscale("log")
        axes.set_yscale("log")
        times = [point.wall_s for point in shown]
        errors = [max(getattr(point, f"rms_{unit}"), 1e-9) for point in shown]
        worst = [max(getattr(point, f"worst_{unit}"), 1e-9) for point in shown]
        axes.set_xlim(min(times) / 1.35, max(times) * 1.6)
        axes.set_ylim(min([*errors, tolerance]) / 2.2, max([*worst, tolerance]) * 2.2)
        axes.grid(which="major", color=_GRID, linewidth=0.8)
        axes.set_axisbelow(True)
        axes.axhspan(axes.get_ylim()[0], tolerance, color="#1b8a6b", alpha=0.06, linewidth=0)
        axes.axhline(tolerance, color="#1b8a6b", linewidth=1.0, linestyle=(0, (4, 3)))
        axes.annotate(
            "tolerance asked for",
            (1.0, tolerance),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 4),
            textcoords="offset points",
            ha="right",
            color="#1b8a6b",
            fontsize=8,
        )
        families = list(dict.fromkeys(point.family for point in points))
        chosen = next(point for point in shown if point.chosen)
        at = axes.transData.transform((chosen.wall_s, getattr(chosen, f"rms_{unit}")))
        middle = at * 72 / figure.dpi
        placed = [(middle[0] + x, middle[1] - 12) for x in (0, 50, 90)]  # of the chosen one's name
        for family, (colour, mark) in zip(families, _FAMILIES, strict=False):
            # The chosen plan belongs to every family: it is where they meet.
            line = [point for point in shown if point.family == family or point.chosen]
            line.sort(key=lambda point: point.wall_s)
            x = [point.wall_s for point in line]
            y = [max(getattr(point, f"rms_{unit}"), 1e-9) for point in line]
            top = [max(getattr(point, f"worst_{unit}"), 1e-9) for point in line]
            axes.vlines(x, y, top, color=colour, alpha=0.25, linewidth=1.2)
            axes.plot(
                x,
                y,
                color=colour,
                marker=mark,
                markersize=5.5,
                linewidth=1.8 if family == CHOSEN else 1.2,
                label="planner, by tolerance" if family == CHOSEN else family,
                zorder=4 if family == CHOSEN else 3,
            )
            for point, at_x, at_y in zip(line, x, y, strict=True):
                if point.family == family and not point.chosen:
                    name = point.name.removeprefix("tolerance ")
                    _label(figure, axes, name, at_x, at_y, colour, placed)
        for point in shown:
            if point.chosen:
                error = max(getattr(point, f"rms_{unit}"), 1e-9)
                axes.plot(
                    [point.wall_s],
                    [error],
                    marker="o",
                    markersize=14,
                    markerfacecolor="none",
                    markeredgecolor=_INK,
                    markeredgewidth=1.6,
                    linestyle="none",
                    zorder=5,
                )
                axes.annotate(
                    f"chosen: {point.name}",
                    (point.wall_s, error),
                    xytext=(11, -14),
                    textcoords="offset points",
                    fontsize=9,
                    fontweight="bold",
                    zorder=6,
                )
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
        axes.xaxis.set_minor_formatter(
            FuncFormatter(lambda value, _: duration(value) if _leads(value, (2, 5)) else "")
        )
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_xlabel("time of a frame, prepared (wall clock)")
        name = "of the local signal" if unit == "relative" else "in sigmas of the noise"
        axes.set_ylabel(f"certified error {name}: RMS, hairline up to the worst probe")
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        axes.legend(loc="upper right", frameon=False, fontsize=8.5)
        figure.text(0.085, 0.945, title, fontsize=11.5, fontweight="bold")
        figure.text(0.085, 0.9, facts, fontsize=8.5, color=_SOFT)
    return figure


def _leads(value: float, digits: tuple[int, ...]) -> bool:
    """Return whether a number's first digit is one of some, and the others are zero."""
    return f"{value:.3e}"[0] in map(str, digits)


def _label(
    figure: Figure,
    axes: matplotlib.axes.Axes,
    text: str,
    x: float,
    y: float,
    colour: str,
    placed: list[tuple[float, float]],
) -> None:
    """Write a point's name beside it, where no other name lies."""
    at = axes.transData.transform((x, y)) * 72 / figure.dpi
    for dx, dy, ha in ((7, 4, "left"), (7, -9, "left"), (-7, 4, "right"), (-7, -10, "right"),
                       (7, 15, "left"), (7, -20, "left")):  # fmt: skip
        middle = at[0] + (dx + 22 if ha == "left" else dx - 22), at[1] + dy + 3
        if all(abs(middle[0] - a) > 52 or abs(middle[1] - b) > 9 for a, b in placed):
            placed.append(middle)
            axes.annotate(
                text,
                (x, y),
                xytext=(dx, dy),
                textcoords="offset points",
                ha=ha,
                fontsize=7.2,
                color=colour,
            )
            return


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    return file.getvalue()
