"""The work-precision diagram: certified error against run time, of prepared and of first frames."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from itertools import count

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from gpusim.pareto import CHOSEN, Point
from gpusim.report.words import duration, error, sigmas

DPI = 120
SIZE_IN = (13.0, 6.6)
_INK, _SOFT, _GRID, _GOOD = "#1b1f24", "#667080", "#e3e6ea", "#1b8a6b"
# ColorBrewer's Dark2: told apart by all kinds of colour vision, with a mark of its own each.
_FAMILIES = (
    ("#1b1f24", "o"),
    ("#7a5c00", "X"),
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
_PANELS = (("frame", "a prepared frame"), ("first", "a first frame: planning, scene, kernels"))
_MARK_PT, _RING_PT, _TAG_PT = 5.5, 14.0, 7.0
_LINE = 0.0262  # of the list, of the figure's height


def draw(points: Sequence[Point], title: str, facts: str, unit: str) -> Figure:
    """Return the diagram.

    Each point has a number beside its mark, where nothing else lies, and a line in the list.

    Parameters
    ----------
    points : sequence of Point
        The chosen one first; those without a frame are left out.
    title, facts : str
        What was rendered; where, and how it was certified.
    unit : str
        "relative" or "sigma": the errors'.
    """
    shown = [point for point in points if point.frame_s is not None]
    families = list(dict.fromkeys(point.family for point in shown))
    styles = dict(zip(families, _FAMILIES, strict=False))
    chosen = shown[0]
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=SIZE_IN, dpi=DPI)
        for left, (kind, what) in zip((0.06, 0.395), _PANELS, strict=True):
            axes = figure.add_axes((left, 0.09, 0.315, 0.76))
            _panel(axes, shown, styles, kind, chosen)
            axes.set_xlabel(f"time of {what}", fontsize=8.5)
            if kind == "frame":
                name = "of the local signal" if unit == "relative" else "in sigmas of the noise"
                label = f"certified total error {name}: RMS, hairline up to the worst probe"
                axes.set_ylabel(label)
            else:
                axes.tick_params(labelleft=False)
        _list(figure, shown, styles, unit)
        figure.text(0.06, 0.955, title, fontsize=11.5, fontweight="bold")
        figure.text(0.06, 0.922, facts, fontsize=8, color=_SOFT)
        figure.text(0.06, 0.889, _regrets(chosen), fontsize=8.5)
    return figure


def _regrets(chosen: Point) -> str:
    """Say the planner's regret in a line."""
    if chosen.regret is None:
        return "The chosen plan does not meet the tolerance."
    return (
        f"Planner's regret, time of the chosen plan over that of the fastest known that meets the "
        f"tolerance: {chosen.regret:.2f} prepared, {chosen.first_regret:.2f} first frame"
    )


def _panel(
    axes: Axes,
    shown: Sequence[Point],
    styles: dict[str, tuple[str, str]],
    kind: str,
    chosen: Point,
) -> None:
    """Draw all points by one of the two times."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    times = [getattr(point, f"{kind}_s") for point in shown]
    errors = [max(point.total_rms, 1e-9) for point in shown]
    worst = [max(point.total_worst, 1e-9) for point in shown]
    tolerance = chosen.tolerance
    axes.set_xlim(min(times) / 1.35, max(times) * 1.35)
    axes.set_ylim(min([*errors, tolerance]) / 2, max([*worst, tolerance]) * 1.7)
    axes.grid(which="major", color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.axhspan(axes.get_ylim()[0], tolerance, color=_GOOD, alpha=0.06, linewidth=0)
    axes.axhline(tolerance, color=_GOOD, linewidth=1.0, linestyle=(0, (4, 3)))
    planned = [point for point in shown if point.family == CHOSEN]
    planned.sort(key=lambda point: point.tolerance)
    line = [(getattr(point, f"{kind}_s"), max(point.total_rms, 1e-9)) for point in planned]
    axes.plot(*zip(*line, strict=True), color=_INK, linewidth=1.6, alpha=0.5, zorder=2)
    for point, x, y, top in zip(shown, times, errors, worst, strict=True):
        colour, mark = styles[point.family]
        axes.vlines(x, y, top, color=colour, alpha=0.22, linewidth=1.0)
        low, high = (getattr(point, f"{kind}_{end}_s") for end in ("low", "high"))
        axes.hlines(y, low, high, color=colour, alpha=0.6, linewidth=1.6)
        axes.plot([x], [y], color=colour, marker=mark, markersize=_MARK_PT, zorder=4)
    fastest = {"frame": chosen.fastest, "first": chosen.first_fastest}[kind]
    for point, x, y in zip(shown, times, errors, strict=True):
        if point is chosen or point.name == fastest:
            axes.plot(
                [x],
                [y],
                marker="o" if point is chosen else "h",
                markersize=_RING_PT,
                markerfacecolor="none",
                markeredgecolor=_INK if point is chosen else _GOOD,
                markeredgewidth=1.5,
                linestyle="none",
                zorder=5,
            )
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 5.0)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: duration(value)))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="x", labelsize=7.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    ringed = [point is chosen or point.name == fastest for point in shown]
    _tags(axes, shown, styles, list(zip(times, errors, strict=True)), ringed)


def _tags(
    axes: Axes,
    shown: Sequence[Point],
    styles: dict[str, tuple[str, str]],
    at: Sequence[tuple[float, float]],
    ringed: Sequence[bool],
) -> None:
    """Write each point's number beside its mark; with a line to it where there was no room."""
    per_point = axes.figure.dpi / 72
    anchors = (axes.transData.transform(at) / per_point).tolist()
    frame = axes.get_window_extent()
    bounds = [side / per_point for side in (frame.x0, frame.y0, frame.x1, frame.y1)]
    texts = [str(number) for number in range(1, len(shown) + 1)]
    # A digit of DejaVu Sans is 0.64 em wide, in bold 0.70, and a line of it 1.17 em high.
    sizes = [(0.70 * _TAG_PT * len(text), 1.2 * _TAG_PT) for text in texts]
    marks = [_RING_PT if ring else _MARK_PT for ring in ringed]
    for point, text, anchor, mark, centre in zip(
        shown, texts, anchors, marks, placed(anchors, marks, sizes, bounds), strict=True
    ):
        away = math.dist(anchor, centre) > mark / 2 + 9
        axes.annotate(
            text,
            anchor,
            xycoords="figure points",
            xytext=centre,
            textcoords="figure points",
            ha="center",
            va="center",
            fontsize=_TAG_PT,
            fontweight="bold" if point.chosen else "normal",
            color=styles[point.family][0],
            arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": _SOFT, "shrinkA": 1}
            if away
            else None,
            zorder=6,
        )


def placed(
    anchors: Sequence[tuple[float, float]],
    marks: Sequence[float],
    sizes: Sequence[tuple[float, float]],
    bounds: Sequence[float],
) -> list[tuple[float, float]]:
    """Return where texts go beside marks: the nearest places at which nothing else lies.

    Parameters
    ----------
    anchors : sequence of (x, y)
        Middles of the marks.
    marks : sequence of float
        Their sides.
    sizes : sequence of (width, height)
        Sizes of the texts.
    bounds : (left, bottom, right, top)
        Within which they go.

    Returns
    -------
    list of (x, y)
        Middles of the texts, in the order of the marks. They overlap neither one another nor a
        mark; all in the same unit.
    """
    taken = [(x, y, mark, mark) for (x, y), mark in zip(anchors, marks, strict=True)]
    found = []
    left, bottom, right, top = bounds
    for (x, y), mark, (width, height) in zip(anchors, marks, sizes, strict=True):
        # Rings around the mark, further and further: the marks are few and the bounds are wide.
        for step in count(0):
            distance = mark / 2 + 5 + 3 * step
            ring = [2 * math.pi * (k + 0.5) / 16 for k in range(16)]
            tries = ((x + distance * math.cos(a), y + distance * math.sin(a)) for a in ring)
            free = [
                (cx, cy)
                for cx, cy in tries
                if left <= cx - width / 2
                and cx + width / 2 <= right
                and bottom <= cy - height / 2
                and cy + height / 2 <= top
                and all(
                    abs(cx - ox) >= (width + w) / 2 or abs(cy - oy) >= (height + h) / 2
                    for ox, oy, w, h in taken
                )
            ]
            if free:
                break
        found.append(free[0])
        taken.append((*free[0], width, height))
    return found


def _list(
    figure: Figure, shown: Sequence[Point], styles: dict[str, tuple[str, str]], unit: str
) -> None:
    """Write the list of all points: number, name, time of a prepared frame, error."""
    say = sigmas if unit == "sigma" else error
    columns = (0.742, 0.757, 0.918, 0.985)
    y = 0.845

    def line(texts: tuple[str, str, str, str], **style: object) -> None:
        for x, text, align in zip(columns, texts, ("right", "left", "right", "right"), strict=True):
            figure.text(x, y, text, ha=align, va="center", fontsize=7.4, **style)

    line(("", "", "prepared", "total RMS"), color=_SOFT)
    family = None
    for number, point in enumerate(shown, start=1):
        colour, mark = styles[point.family]
        if point.family != family:
            family = point.family
            y -= 1.15 * _LINE
            line(("", "planner, by tolerance" if family == CHOSEN else family, "", ""), color=_SOFT)
            spot = figure.add_axes((columns[0] - 0.012, y - 0.012, 0.012, 0.024))
            spot.axis("off")
            spot.plot([0], [0], color=colour, marker=mark, markersize=_MARK_PT)
        y -= _LINE
        name = f"{point.name}, chosen" if point.chosen else point.name
        weight = "bold" if point.chosen else "normal"
        texts = (str(number), name, duration(point.frame_s), say(point.total_rms))
        line(texts, color=colour, fontweight=weight)


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    drawn, file = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    # The picture has a dozen colours and their blends. A palette takes a third of the bytes of true
    # colour, and nobody sees a difference.
    with Image.open(drawn) as image:
        image.convert("RGB").quantize(256).save(file, "PNG", optimize=True)
    return file.getvalue()
