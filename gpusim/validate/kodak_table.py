"""Table 1 of Short, Williams & Jones (1999): where edges lie, and how well the paper met them."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """Where the image of an edge lies.

    Attributes
    ----------
    number : int
        The edge's, in table 1.
    x, y : float
        Pixels from the sensor's centre, right and down.
    """

    number: int
    x: float
    y: float


@dataclass(frozen=True)
class Row(Place):
    """A row of table 1 of the paper, pixels; the place is that of the edge's green image.

    Attributes
    ----------
    position : tuple of float
        The paper's errors of R, G and B.
    red, blue : tuple of float
        The paper's position relative to green: predicted, measured, error.
    """

    position: tuple[float, float, float]
    red: tuple[float, float, float]
    blue: tuple[float, float, float]


NONE = math.nan  # where the scan of the table is not legible
# fmt: off
TABLE_1 = tuple(
    Row(number, x, y, *(tuple(row[at : at + 3]) for at in (0, 3, 6)))
    for number, x, y, *row in (
        (1, 0.0, 0.0, -0.059, -0.068, -0.065, 0.0, 0.009, 0.009, 0.0, 0.003, 0.003),
        (2, 62.9, 0.0, 0.01, 0.029, 0.033, -0.08, -0.1, -0.02, 0.138, 0.142, 0.003),
        (3, 126.3, 0.0, 0.078, 0.111, 0.113, -0.17, -0.204, -0.034, 0.294, 0.296, 0.002),
        (4, 190.5, 0.0, -0.092, -0.103, NONE, -0.276, -0.265, 0.011, 0.485, 0.481, -0.004),
        (5, 254.9, 0.0, -0.159, -0.155, -0.181, -0.392, -0.396, -0.004, 0.7, 0.673, -0.026),
        (6, -254.9, 0.0, 0.193, 0.19, 0.2, 0.392, 0.394, 0.002, -0.7, -0.69, 0.01),
        (7, 0.0, 190.5, -0.027, -0.013, 0.019, 0.0, -0.014, -0.014, 0.0, 0.032, 0.032),
        (8, 127.3, 191.0, -0.102, -0.089, -0.04, -0.193, -0.206, -0.013, 0.339, 0.388, 0.049),
        (9, 253.5, 190.1, -0.398, -0.391, -0.346, -0.346, -0.353, -0.007, 0.614, 0.66, 0.045),
        (10, -253.5, 190.1, NONE, NONE, NONE, 0.346, 0.32, -0.025, -0.614, -0.69, -0.076),
    )
)
# fmt: on
"""The ten edges: place, then the paper's errors of R, G, B, then red and blue to green."""
