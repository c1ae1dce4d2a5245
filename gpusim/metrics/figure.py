"""Figures of a data sheet with their standard uncertainties, and reckoning with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Figure:
    """A figure of the data sheet with its standard uncertainty.

    Attributes
    ----------
    value : float
    u : float
        Standard uncertainty.
    square, square_u : float or None
        The variance whose root the figure is, and its uncertainty; None for other figures. The
        variance may have come out negative where there is nothing to be found. It is distributed
        normally; its root is not.
    """

    value: float
    u: float
    square: float | None = None
    square_u: float | None = None

    @classmethod
    def root(cls, square: float, square_u: float) -> Figure:
        """Return the root of a variance, 0 of a negative one."""
        value = math.sqrt(max(square, 0.0))
        return cls(value, math.sqrt(max(square, 0.0) + square_u) - value, square, square_u)

    def over(self, other: Figure, power: int = 1) -> Figure:
        """Return the quotient of this figure and an independent one to a power."""
        divisor = other.value**power
        value = self.value / divisor
        return Figure(value, math.hypot(self.u / divisor, power * value * other.u / other.value))


def root_in(square: float, square_u: float, unit: Figure, factor: float) -> Figure:
    """Return the root of a variance in DN^2 as `factor` times a multiple of `unit`.

    Parameters
    ----------
    square, square_u : float
        The variance and its standard uncertainty, DN^2.
    unit : Figure
        DN for one: K for electrons, the signal for shares of it.
    factor : float
        1, or 100 for per cent.
    """
    scale = (factor / unit.value) ** 2
    of_unit = 2 * abs(square) * scale * unit.u / unit.value
    return Figure.root(scale * square, math.hypot(scale * square_u, of_unit))


def weighted(figures: Sequence[Figure]) -> Figure:
    """Return the mean of independent figures, weighted by their uncertainties."""
    weights = np.array([1 / max(one.u, 1e-30) ** 2 for one in figures])
    values = np.array([one.value for one in figures])
    return Figure(float(weights @ values / weights.sum()), float(weights.sum() ** -0.5))


def line(x: np.ndarray, y: np.ndarray, u2: np.ndarray) -> tuple[Figure, Figure]:
    """Return offset and slope of the line through points, weighted by their uncertainties."""
    weight = 1 / np.maximum(u2, 1e-30)
    total = weight.sum()
    middle = weight @ x / total
    square = weight @ (x - middle) ** 2
    slope = weight @ ((x - middle) * y) / square
    offset = weight @ y / total - slope * middle
    return (
        Figure(float(offset), math.sqrt(1 / total + middle**2 / square)),
        Figure(float(slope), 1 / math.sqrt(square)),
    )
