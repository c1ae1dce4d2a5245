"""Where the fields of a bank lie on the image plane, and how the PSFs between them are made.

The PSFs between the fields come from the cubics through the nearest four (Lagrange). A lens that is
symmetric about its axis has heights as fields, and PSFs that are turned to their azimuth. Beyond
the axis lie the same fields again, at -r, turned by half a turn: what is even in the height has no
cusp there, and coma no jump. Any other lens has a grid of fields, and PSFs as they lie.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

NEAREST = 4  # fields of a cubic


class FieldPsfs(NamedTuple):
    """One field of a bank, in the frame of its PSFs: x is their columns.

    Attributes
    ----------
    psf : ndarray (L, n, n)
        Each centred on the chief ray of its own wavelength.
    shift_um : ndarray (L, 2)
        x, y of those chief rays from that of the reference wavelength: lateral colour.
    relative_illumination : ndarray (L,)
    """

    psf: np.ndarray
    shift_um: np.ndarray
    relative_illumination: np.ndarray


class Blend(NamedTuple):
    """How the PSF at a point is made: the sum of weighted fields, turned by an angle.

    Attributes
    ----------
    fields : tuple of int
        Indices into the list that the places go with.
    weights : tuple of float
        Sum 1.
    cos, sin : float
        Direction that the PSFs' x axis has at the point.
    """

    fields: tuple[int, ...]
    weights: tuple[float, ...]
    cos: float
    sin: float


class Blends(NamedTuple):
    """How PSFs at N points are made: see `Blend`.

    Attributes
    ----------
    fields : ndarray (N, K) of int
    weights : ndarray (N, K)
        Sum 1; 0 for fields that do not count.
    cos, sin : ndarray (N,)
    """

    fields: np.ndarray
    weights: np.ndarray
    cos: np.ndarray
    sin: np.ndarray


class Places(Protocol):
    """Where a list of fields lies.

    Attributes
    ----------
    probes : tuple of int
        Fields that stand for all where errors are predicted: the middle and the rim.
    quadrants : tuple of (int, int)
        Signs of x and y of the quadrants that differ; one where all are the mirror images of it,
        if only the PSFs are symmetric about their x axis.
    main : slice
        The fields of the list that hold the light: others only change how it is spread.
    opposite : tuple of int
        The fields of the list that stand beyond the axis: their PSFs are turned by half a turn.
    neighbours : list of (int, int, float)
        Pairs of the list that lie next to each other, and how far apart, um.
    """

    probes: tuple[int, ...]
    quadrants: tuple[tuple[int, int], ...]
    main: slice
    opposite: tuple[int, ...]
    neighbours: list[tuple[int, int, float]]

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""

    def blends(self, x_um: np.ndarray, y_um: np.ndarray) -> Blends:
        """Return the same at many points (N,)."""


def half_turned(images: np.ndarray) -> np.ndarray:
    """Return images (..., n, n) turned by half a turn about sample n / 2, n even."""
    return np.roll(images[..., ::-1, ::-1], 1, axis=(-2, -1))


def lagrange(nodes: np.ndarray, at: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Return which nodes make up a function's values at points, and how much each counts.

    The polynomial through the nearest four, two on either side; at the ends the outer four; of
    fewer nodes through all (Lagrange; Abramowitz and Stegun 1964, eq. 25.2.1).

    Parameters
    ----------
    nodes : ndarray (N,)
        Rising.
    at : array_like (...)

    Returns
    -------
    numbers : ndarray (..., min(4, N)) of int
    weights : ndarray (..., min(4, N))
        Sum 1.
    """
    at = np.asarray(at, float)
    count = min(NEAREST, len(nodes))
    first = np.clip(np.searchsorted(nodes, at, "right") - count // 2, 0, len(nodes) - count)
    numbers = first[..., None] + np.arange(count)
    own = nodes[numbers]
    weights = np.ones(numbers.shape)
    for place, other in np.ndindex(count, count):
        if place != other:
            apart = own[..., place] - own[..., other]
            weights[..., place] *= (at - own[..., other]) / apart
    return numbers, weights


@dataclass(frozen=True)
class Heights:
    """Fields at image heights, rising from 0, and last in the list the second of them at -r.

    Beyond the largest they go on along a straight line for as far as it is from the one before, and
    then stay: nothing shines there, but nodes that lie there belong to cells that reach in.
    """

    radius_um: np.ndarray
    quadrants = ((1, 1),)

    @property
    def probes(self) -> tuple[int, ...]:
        """The axis and the rim."""
        return (0, len(self.radius_um) - 1)

    @property
    def main(self) -> slice:
        """All but the one beyond the axis, which is there already."""
        return slice(len(self.radius_um))

    @property
    def opposite(self) -> tuple[int, ...]:
        """The last."""
        return (len(self.radius_um),)

    @property
    def neighbours(self) -> list[tuple[int, int, float]]:
        """Each height and the next."""
        apart = enumerate(np.diff(self.radius_um).tolist())
        return [(number, number + 1, step) for number, step in apart if step > 0]

    def blended(self, radius_um: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers in the list and weights (..., 3 or 4) at heights up to the largest."""
        nodes = np.concatenate([-self.radius_um[1:2], self.radius_um])
        numbers, weights = lagrange(nodes, radius_um)
        return (numbers - 1) % len(nodes), weights

    def even(self, table: np.ndarray, radius_um: np.ndarray) -> np.ndarray:
        """Return values that are alike on both sides of the axis at heights.

        Parameters
        ----------
        table : ndarray (F, ...)
            At the fields.
        radius_um : ndarray (P,)
            Beyond the largest height: as there.

        Returns
        -------
        ndarray (P, ...)
        """
        numbers, weights = self.blended(np.minimum(radius_um, self.radius_um[-1]))
        both = np.concatenate([table, table[1:2]])
        # One after the other, because maps are large.
        return sum(
            one.reshape(-1, *[1] * (table.ndim - 1)) * both[number]
            for number, one in zip(numbers.T, weights.T, strict=True)
        )

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""
        radius = float(np.hypot(x_um, y_um))
        cos, sin = (x_um / radius, y_um / radius) if radius > 0 else (1.0, 0.0)
        last = len(self.radius_um) - 1
        before, edge = self.radius_um[-2:]
        if radius > edge:
            t = min((radius - before) / (edge - before), 2.0)
            return Blend((last - 1, last), (1 - t, t), cos, sin)
        numbers, weights = self.blended(radius)
        return Blend(tuple(numbers.tolist()), tuple(weights.tolist()), cos, sin)

    def blends(self, x_um: np.ndarray, y_um: np.ndarray) -> Blends:
        """Return the same at many points (N,)."""
        radius = np.hypot(x_um, y_um)
        off = radius > 0
        cos, sin = np.where(off, x_um, 1.0), np.where(off, y_um, 0.0)
        cos[off] /= radius[off]
        sin[off] /= radius[off]
        last = len(self.radius_um) - 1
        before, edge = self.radius_um[-2:]
        numbers, weights = self.blended(np.minimum(radius, edge))
        beyond = radius > edge
        t = np.minimum((radius[beyond] - before) / (edge - before), 2.0)
        numbers[beyond], weights[beyond] = last, 0.0
        numbers[beyond, 0] = last - 1
        weights[beyond, 0], weights[beyond, 1] = 1 - t, t
        return Blends(numbers, weights, cos, sin)


@dataclass(frozen=True)
class FieldGrid:
    """Fields on a grid of field angles, row after row; beyond it they are those of its border.

    Attributes
    ----------
    x_deg, y_deg : ndarray (X,), (Y,)
        Rising.
    field_deg : callable
        Returns the field angles x, y at real image points.
    """

    x_deg: np.ndarray
    y_deg: np.ndarray
    field_deg: Callable[[float, float], tuple[float, float]]
    quadrants = ((1, 1), (-1, 1), (-1, -1), (1, -1))
    main = slice(None)
    opposite = ()

    @cached_property
    def probes(self) -> tuple[int, ...]:
        """The field nearest to the axis, and the corners."""
        across, down = len(self.x_deg), len(self.y_deg)
        middle = int(np.abs(self.y_deg).argmin() * across + np.abs(self.x_deg).argmin())
        return (middle, 0, across - 1, (down - 1) * across, down * across - 1)

    @property
    def neighbours(self) -> list[tuple[int, int, float]]:
        """Along rows and columns; as far apart as angles that differ as much are in the middle."""
        here, there = self.field_deg(-1.0, -1.0), self.field_deg(1.0, 1.0)
        um_per_deg = [2.0 / abs(more - less) for less, more in zip(here, there, strict=True)]
        numbers = np.arange(len(self.x_deg) * len(self.y_deg)).reshape(-1, len(self.x_deg))
        found = []
        for own, angle, scale in (
            (numbers, self.x_deg, um_per_deg[0]),
            (numbers.T, self.y_deg, um_per_deg[1]),
        ):
            for first, second, step in zip(own.T, own.T[1:], np.diff(angle) * scale, strict=False):
                found += [(int(a), int(b), float(step)) for a, b in zip(first, second, strict=True)]
        return found

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""
        numbers, weights = self.blended(x_um, y_um)
        return Blend(tuple(numbers.tolist()), tuple(weights.tolist()), 1.0, 0.0)

    def blends(self, x_um: np.ndarray, y_um: np.ndarray) -> Blends:
        """Return the same at many points (N,)."""
        return Blends(*self.blended(x_um, y_um), np.ones(len(x_um)), np.zeros(len(x_um)))

    def blended(self, x_um: np.ndarray, y_um: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return numbers and weights (..., up to 16) of the fields at real image points (...)."""
        (col, across), (row, down) = (
            lagrange(axis, np.clip(angle, axis[0], axis[-1]))
            for angle, axis in zip(
                self.field_deg(x_um, y_um), (self.x_deg, self.y_deg), strict=True
            )
        )
        numbers = row[..., :, None] * len(self.x_deg) + col[..., None, :]
        weights = down[..., :, None] * across[..., None, :]
        flat = (*numbers.shape[:-2], -1)
        return numbers.reshape(flat), weights.reshape(flat)
