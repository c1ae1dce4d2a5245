"""Checkerboards and dots in closed form, seen through a distortion that is known exactly.

The distortion is given from the picture to the chart, r_u = r_d (1 + k_1 r_d^2 + k_2 r_d^4), so
that every pixel's light is the chart's at known places: its mean over Gauss' points of the square.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf

SIZE = (420, 320)  # columns and rows
PITCH_PX = 26.0  # of the chart at the middle of the picture
SOFT = 0.035  # standard deviation of the chart's blur, of its pitch: 0.9 px
OFF = (0.31, -0.17)  # of the chart's middle from the picture's, pitches
TURN_DEG = 4.0
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)


def ratio(r: np.ndarray, k: tuple[float, ...]) -> np.ndarray:
    """Return r_u / r_d."""
    return 1 + sum(one * r ** (2 * at + 2) for at, one in enumerate(k))


def to_chart(x: np.ndarray, y: np.ndarray, k: tuple[float, ...], grow: float = 1.0):
    """Return a point of the chart, pitches, of a point of the picture, px."""
    corner = np.hypot(*SIZE) / 2
    u, v = (x - SIZE[0] / 2) / corner, (y - SIZE[1] / 2) / corner
    bent = ratio(np.hypot(u, v), k) * corner / PITCH_PX / grow
    turn = np.radians(TURN_DEG)
    u, v = u * bent, v * bent
    return u * np.cos(turn) + v * np.sin(turn) + OFF[0], v * np.cos(turn) - u * np.sin(turn) + OFF[
        1
    ]


def true_place(cell: tuple[float, float], k: tuple[float, ...], grow: float = 1.0):
    """Return where a point of the chart lies in the picture, px: r_d by bisection."""
    turn, corner = np.radians(TURN_DEG), np.hypot(*SIZE) / 2
    a, b = cell[0] - OFF[0], cell[1] - OFF[1]
    u, v = a * np.cos(turn) - b * np.sin(turn), a * np.sin(turn) + b * np.cos(turn)
    far = np.hypot(u, v) * PITCH_PX * grow / corner
    if far == 0:
        return SIZE[0] / 2, SIZE[1] / 2
    r = brentq(lambda r: r * ratio(r, k) - far, 0, 2.0)
    out = r * corner / np.hypot(u, v)
    return SIZE[0] / 2 + u * out, SIZE[1] / 2 + v * out


def checks(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a checkerboard of corners at whole numbers, from 0.1 to 0.9."""

    def square(at: np.ndarray) -> np.ndarray:
        near = at - np.rint(at)  # the next edge; those beyond are 28 deviations away
        return np.where(np.rint(at) % 2 == 0, 1, -1) * erf(near / (SOFT * np.sqrt(2)))

    return 0.5 + 0.4 * square(a) * square(b)


def dots(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return dark dots of radius 0.2 about whole numbers."""
    away = np.hypot(a - np.rint(a), b - np.rint(b))
    return 0.9 - 0.4 * (1 - erf((away - 0.2) / (SOFT * np.sqrt(2))))


def picture(
    chart: Callable[[np.ndarray, np.ndarray], np.ndarray],
    k: tuple[float, ...] = (),
    grow: float = 1.0,
) -> np.ndarray:
    """Return the picture (rows, cols)."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    total = np.zeros(x.shape)
    for dy, wy in zip(POINTS / 2, WEIGHTS / 2, strict=True):
        for dx, wx in zip(POINTS / 2, WEIGHTS / 2, strict=True):
            total += wx * wy * chart(*to_chart(x + dx, y + dy, k, grow))
    return total
