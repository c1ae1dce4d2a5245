"""What figures say, and where: for tests that letters can be read."""

from __future__ import annotations

import itertools

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text


def words(figure: Figure) -> list[tuple[str, object]]:
    """Return every text that a figure shows, with its box in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = list(figure.texts)
    texts += [text for legend in figure.legends for text in legend.get_texts()]
    for axes in figure.axes:
        texts += [child for child in axes.get_children() if isinstance(child, Text)]
        if axes.get_legend() is not None:
            texts += axes.get_legend().get_texts()
        for axis in (axes.xaxis, axes.yaxis) if axes.axison else ():
            low, high = sorted(axis.get_view_interval())
            texts.append(axis.label)
            # Beyond the limits matplotlib keeps ticks that it does not draw.
            texts += [t.label1 for t in axis.get_major_ticks() if low <= t.get_loc() <= high]
    renderer = canvas.get_renderer()
    return [(t.get_text(), t.get_window_extent(renderer)) for t in texts if t.get_text().strip()]


def overlaps(shown) -> list[tuple[str, str]]:
    return [
        (a, b)
        for (a, box), (b, other) in itertools.combinations(shown, 2)
        # A pixel of slack: boxes are wider than letters.
        if min(box.x1, other.x1) - max(box.x0, other.x0) > 1
        and min(box.y1, other.y1) - max(box.y0, other.y0) > 1
    ]
