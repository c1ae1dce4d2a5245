"""What notebooks show of values: a picture or curves beside a few facts.

Texts have the notebook's own colour, and lines colours between light and dark: both themes do.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from PIL import Image

from gpusim.report.template import macros

TEMPLATE = "library/notebook.html"
SHOWN_PX = 960  # longest side of a frame's picture
CURVES_PX = 480, 80  # of a figure of curves
# Legible on white and on black, 4 : 1 or nearly; W: a photosite without a filter.
COLOURS = {
    "R": "#d0443a",
    "G": "#2f9a55",
    "B": "#4a7fd6",
    "C": "#1592a0",
    "M": "#c2458a",
    "Y": "#a8891c",
    "W": "#888",
}


def picture(image: Image.Image, longest_px: int = SHOWN_PX) -> str:
    """Return an image element, scaled down to a longest side; the image given is scaled too."""
    image.thumbnail((longest_px, longest_px))
    return macros(TEMPLATE).picture(image)


def curves(of_letter: Iterable[tuple[str, Sequence[float] | np.ndarray]]) -> str:
    """Return curves from 0 to their common top, evenly spaced, by letter of a filter's colour."""
    width, height = CURVES_PX
    given = [(letter, np.asarray(values, float)) for letter, values in of_letter]
    top = max((float(values.max()) for _, values in given), default=0.0) or 1.0
    lines = [
        (
            COLOURS.get(letter, "#888"),
            " ".join(
                f"{k * width / len(values):.1f},{height - 2 - (height - 4) * one / top:.1f}"
                for k, one in enumerate(values)
            ),
        )
        for letter, values in given
    ]
    return macros(TEMPLATE).curves(lines, width, height)


def facts(title: str, of_name: Mapping[str, object]) -> str:
    """Return a title and a line of facts."""
    told = [f"{name} {one}" for name, one in of_name.items()]
    return macros(TEMPLATE).facts(title, told)


def figure(*parts: str) -> str:
    """Return one element of several."""
    return macros(TEMPLATE).figure(parts)


def abreast(*figures: str) -> str:
    """Return figures side by side."""
    return macros(TEMPLATE).abreast(figures)
