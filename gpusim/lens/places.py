"""Where the fields of a bank lie on the image plane, and how the PSFs between them are made.

Of a lens that is symmetric about its axis: heights, between which PSFs are linear in height and
turned to their azimuth. Of any other: a grid, between whose corners they are bilinear, as they lie.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np


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
        Of the direction that the PSFs' x axis has at the point.
    """

    fields: tuple[int, ...]
    weights: tuple[float, ...]
    cos: float
    sin: float


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
        Of the list, the fields that hold the light: others only change how it is spread.
    """

    probes: tuple[int, ...]
    quadrants: tuple[tuple[int, int], ...]
    main: slice

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""


@dataclass(frozen=True)
class Heights:
    """Fields at image heights, rising from 0.

    Beyond the last they go on along a straight line for as far as it is from the one before, and
    then stay: nothing shines there, but nodes that lie there belong to cells that reach in.
    """

    radius_um: np.ndarray
    probes = (0, -1)
    quadrants = ((1, 1),)
    main = slice(None)

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""
        radius = float(np.hypot(x_um, y_um))
        upper = int(np.clip(np.searchsorted(self.radius_um, radius), 1, len(self.radius_um) - 1))
        lower = upper - 1
        span = self.radius_um[upper] - self.radius_um[lower]
        t = min((radius - self.radius_um[lower]) / span, 2.0)
        cos, sin = (x_um / radius, y_um / radius) if radius > 0 else (1.0, 0.0)
        return Blend((lower, upper), (1 - t, t), cos, sin)


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

    @cached_property
    def probes(self) -> tuple[int, ...]:
        """The field nearest to the axis, and the corners."""
        across, down = len(self.x_deg), len(self.y_deg)
        middle = int(np.abs(self.y_deg).argmin() * across + np.abs(self.x_deg).argmin())
        return (middle, 0, across - 1, (down - 1) * across, down * across - 1)

    def at(self, x_um: float, y_um: float) -> Blend:
        """Return how the PSF at a real image point is made."""
        parts = []
        for angle, axis in zip(self.field_deg(x_um, y_um), (self.x_deg, self.y_deg), strict=True):
            place = float(np.interp(angle, axis, np.arange(len(axis))))
            first = min(int(place), len(axis) - 2)
            parts.append(((first, 1 - (place - first)), (first + 1, place - first)))
        corners = [
            (row * len(self.x_deg) + col, down * across)
            for row, down in parts[1]
            for col, across in parts[0]
        ]
        fields, weights = zip(*corners, strict=True)
        return Blend(fields, weights, 1.0, 0.0)
