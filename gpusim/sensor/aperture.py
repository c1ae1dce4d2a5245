"""Where in a pixel light counts: rectangles, an L of them, or a measured map; and motion in a scan.

All is folded into the channel kernels' transform, as the square aperture is: shaders do not know.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from pydantic import Field, field_validator, model_validator

from gpusim.config.model import Strict, wrong

ROUNDING = 1e-9  # pixels, by which rectangles given as decimal fractions may touch or reach out
MAX_CELLS = 32  # along a side of a map
AREA_ROUNDING = 2e-3  # between an aperture's area and the fill factor of a data sheet


Cells = tuple[tuple[float, ...], ...]


class Part(Strict):
    """A rectangle within the pixel, from its upper left corner, in pixels."""

    x: float = Field(ge=0, lt=1)
    y: float = Field(ge=0, lt=1)
    width: float = Field(gt=0, le=1)
    height: float = Field(gt=0, le=1)

    @model_validator(mode="after")
    def _inside(self) -> Part:
        if max(self.x + self.width, self.y + self.height) > 1 + ROUNDING:
            raise wrong("the rectangle reaches out of the pixel", "x + width and y + height to 1")
        return self


class Aperture(Strict):
    """What of the pixel sees light: rectangles, or a map of its response.

    Attributes
    ----------
    rectangles : tuple of Part, optional
        Side by side: one, two for an L, or more.
    map : tuple of tuple of float, optional
        Response of cells of equal size, row by row, from 0 to 1: what a scan with a spot of light
        has measured.
    """

    rectangles: tuple[Part, ...] | None = None
    map: Cells | None = None

    @field_validator("rectangles")
    @classmethod
    def _apart(cls, parts: tuple[Part, ...] | None) -> tuple[Part, ...] | None:
        for one, other in combinations(parts or (), 2):
            across = min(one.x + one.width, other.x + other.width) - max(one.x, other.x)
            down = min(one.y + one.height, other.y + other.height) - max(one.y, other.y)
            if min(across, down) > ROUNDING:
                raise wrong("two rectangles overlap", "rectangles side by side")
        return parts

    @field_validator("map")
    @classmethod
    def _cells(cls, cells: Cells | None) -> Cells | None:
        if cells is None:
            return None
        if not cells or not cells[0] or any(len(row) != len(cells[0]) for row in cells):
            raise wrong("the map is no rectangle", "rows of equal length")
        if max(len(cells), len(cells[0])) > MAX_CELLS:
            raise wrong("the map has too many cells", f"{MAX_CELLS} x {MAX_CELLS} at most")
        values = np.array(cells)
        if not ((values >= 0) & (values <= 1)).all() or not values.any():
            raise wrong("the map has a response that is none", "0 to 1, some of them above 0")
        return cells

    @model_validator(mode="after")
    def _one(self) -> Aperture:
        if bool(self.rectangles) == (self.map is not None):
            raise wrong("an aperture is rectangles or a map", "one of them")
        return self

    @property
    def parts(self) -> list[tuple[float, float, float, float, float]]:
        """x, y, width and height of rectangles, pixels from the upper left; and their response."""
        if self.rectangles is not None:
            return [(one.x, one.y, one.width, one.height, 1.0) for one in self.rectangles]
        down, across = len(self.map), len(self.map[0])
        return [
            (col / across, row / down, 1 / across, 1 / down, self.map[row][col])
            for row, col in np.ndindex(down, across)
            if self.map[row][col] > 0
        ]

    @property
    def area(self) -> float:
        """Response over that of a pixel that sees light all over: its fill factor."""
        return sum(width * height * response for _, _, width, height, response in self.parts)


@dataclass(frozen=True)
class Response:
    """A pixel's response in space, over its sum.

    Attributes
    ----------
    parts : tuple of (x, y, width, height, share)
        Rectangles: their middles from the pixel's, and the share of the response; sum 1.
    motion : (float, float)
        Way of the image over the pixel while it is exposed.
    """

    parts: tuple[tuple[float, float, float, float, float], ...]
    motion: tuple[float, float]

    def __truediv__(self, unit: float) -> Response:
        """Return it in another unit of length."""
        return Response(
            tuple(
                (x / unit, y / unit, w / unit, h / unit, share) for x, y, w, h, share in self.parts
            ),
            (self.motion[0] / unit, self.motion[1] / unit),
        )

    def spectrum(self, fx: np.ndarray, fy: np.ndarray) -> np.ndarray:
        """Return what a pixel sees of exp(2 pi i (fx x + fy y)), x and y from its middle."""
        total = 0.0
        for x, y, width, height, share in self.parts:
            along_x = np.sinc(width * fx) * np.exp(2j * np.pi * fx * x)
            along_y = np.sinc(height * fy) * np.exp(2j * np.pi * fy * y)
            total = total + share * along_x * along_y
        return total * np.sinc(fx * self.motion[0] + fy * self.motion[1])

    @property
    def even(self) -> bool:
        """Whether it is its mirror image in x and in y."""
        parts = set(self.parts)
        return 0.0 in self.motion and all(
            (-x, y, *rest) in parts and (x, -y, *rest) in parts for x, y, *rest in self.parts
        )

    @property
    def reach(self) -> float:
        """Farthest that it sees from the pixel's middle along an axis."""
        ends = [
            max(abs(x) + w / 2 + abs(self.motion[0]) / 2, abs(y) + h / 2 + abs(self.motion[1]) / 2)
            for x, y, w, h, _ in self.parts
        ]
        return max(ends)

    def points(self, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Return points (P, 2) and shares (P,) of a quadrature, two nodes a step or more."""

        def line(length: float, least: int) -> tuple[np.ndarray, np.ndarray]:
            nodes, weights = np.polynomial.legendre.leggauss(
                max(least, int(np.ceil(2 * length / step)))
            )
            return nodes / 2 * length, weights / 2

        least = 4 if len(self.parts) <= 4 else 2
        way = float(np.hypot(*self.motion))
        moved, of_moved = line(way, 4) if way else (np.zeros(1), np.ones(1))
        shift = np.outer(moved, np.array(self.motion) / way) if way else np.zeros((1, 2))
        places, shares = [], []
        for x, y, width, height, share in self.parts:
            (across, of_x), (down, of_y) = line(width, least), line(height, least)
            grid = np.stack(np.meshgrid(x + across, y + down), axis=-1).reshape(-1, 2)
            places.append((grid[:, None] + shift).reshape(-1, 2))
            shares.append(share * np.outer(np.outer(of_y, of_x).ravel(), of_moved).ravel())
        return np.concatenate(places), np.concatenate(shares)


def response_of(
    aperture: Aperture | None, fill_factor: float, motion: tuple[float, float] | None
) -> Response:
    """Return a pixel's response in space, in pixels.

    Parameters
    ----------
    aperture : Aperture or None
        None: a square in the middle of the pixel.
    fill_factor : float
        Area of that square over the pixel's.
    motion : (float, float) or None
        x, y by which the image moves while the pixel is exposed, pixels.
    """
    side = math.sqrt(fill_factor)
    square = [((1 - side) / 2, (1 - side) / 2, side, side, 1.0)]
    parts = aperture.parts if aperture else square
    whole = sum(w * h * response for _, _, w, h, response in parts)
    centred = tuple(
        (x + w / 2 - 0.5, y + h / 2 - 0.5, w, h, w * h * response / whole)
        for x, y, w, h, response in parts
    )
    return Response(centred, motion or (0.0, 0.0))


def transfer_along(aperture: float | Response, frequency: np.ndarray, axis: int) -> np.ndarray:
    """Return the modulation of an aperture, or of a square's side, along x (axis 0) or y (1)."""
    if isinstance(aperture, Response):
        zero = np.zeros_like(frequency)
        return np.abs(aperture.spectrum(*((frequency, zero) if axis == 0 else (zero, frequency))))
    return np.sinc(frequency * aperture)
