"""The convex shapes of a chart, and how two of them lie to one another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Rect:
    """A rectangle.

    Attributes
    ----------
    cx, cy : float
        Centre, x right, y down.
    half_w, half_h : float
        Half the extent along its own axes.
    angle_rad : float
        Direction of its width, from x towards y (clockwise as seen).
    material : int
        Index of the material that fills it.
    """

    cx: float
    cy: float
    half_w: float
    half_h: float
    angle_rad: float
    material: int

    @property
    def reach(self) -> float:
        """Radius of the circle about the centre that holds it."""
        return math.hypot(self.half_w, self.half_h)

    @property
    def least_extent(self) -> float:
        """Half the width of its narrower side; not positive, it is no rectangle."""
        return min(self.half_w, self.half_h)

    def corners(self) -> np.ndarray:
        """Return the corners, ndarray (4, 2)."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        local = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (self.half_w, self.half_h)
        return local @ np.array([[c, s], [-s, c]]) + (self.cx, self.cy)

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance from the outline, negative inside."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        dx, dy = x - self.cx, y - self.cy
        across = np.abs(c * dx + s * dy) - self.half_w
        along = np.abs(c * dy - s * dx) - self.half_h
        outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
        return outside + np.minimum(np.maximum(across, along), 0.0)

    def scaled(self, factor: float) -> Rect:
        """Return it so many times as large, about the origin."""
        ends = (factor * one for one in (self.cx, self.cy, self.half_w, self.half_h))
        return Rect(*ends, self.angle_rad, self.material)


@dataclass(frozen=True)
class Disc:
    """A disc: centre (cx, cy), radius, and index of the material that fills it."""

    cx: float
    cy: float
    radius: float
    material: int

    @property
    def reach(self) -> float:
        """Radius of the circle about the centre that holds it."""
        return self.radius

    @property
    def least_extent(self) -> float:
        """Its radius; not positive, it is no disc."""
        return self.radius

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance from the outline, negative inside."""
        return np.hypot(x - self.cx, y - self.cy) - self.radius

    def scaled(self, factor: float) -> Disc:
        """Return it so many times as large, about the origin."""
        return Disc(factor * self.cx, factor * self.cy, factor * self.radius, self.material)


@dataclass(frozen=True)
class Polygon:
    """A convex polygon.

    Attributes
    ----------
    points : tuple of (float, float)
        Corners in turn, clockwise as seen (from x towards y).
    material : int
        Index of the material that fills it.
    """

    points: tuple[tuple[float, float], ...]
    material: int

    @cached_property
    def _sides(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners (N, 2), unit vectors (N, 2) from each to the next, and lengths (N,)."""
        corners = np.array(self.points, np.float64)
        way = np.roll(corners, -1, axis=0) - corners
        length = np.hypot(*way.T)
        return corners, way / np.maximum(length, 1e-300)[:, None], length

    @cached_property
    def cx(self) -> float:
        """Middle of the corners, x: a point inside."""
        return float(self._sides[0][:, 0].mean())

    @cached_property
    def cy(self) -> float:
        """Middle of the corners, y."""
        return float(self._sides[0][:, 1].mean())

    @cached_property
    def reach(self) -> float:
        """Radius of the circle about that middle that holds it."""
        return float(np.hypot(*(self._sides[0] - (self.cx, self.cy)).T).max())

    @cached_property
    def least_extent(self) -> float:
        """Least depth of the middle below a side; negative where it is not convex or turns back."""
        corners, way, length = self._sides
        turns = _cross(way, np.roll(way, -1, axis=0))
        around = np.arctan2(turns, np.sum(way * np.roll(way, -1, axis=0), axis=1)).sum()
        if not (length.min() > 0 and turns.min() > 0 and around < 3 * np.pi):
            return -1.0
        return float(_cross(way, (self.cx, self.cy) - corners).min())

    def corners(self) -> np.ndarray:
        """Return the corners, ndarray (N, 2)."""
        return self._sides[0].copy()

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance from the outline, negative inside."""
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        within, nearest = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
        for (px, py), (ex, ey), length in zip(*self._sides, strict=True):
            dx, dy = x - px, y - py
            within = np.maximum(within, ey * dx - ex * dy)  # beyond the side's line
            along = np.clip(ex * dx + ey * dy, 0.0, length)
            nearest = np.minimum(nearest, np.hypot(dx - along * ex, dy - along * ey))
        return np.where(within <= 0, within, nearest)

    def within(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return whether points lie inside or on the outline; by less work than the distance."""
        found = True
        for (px, py), (ex, ey), _ in zip(*self._sides, strict=True):
            found = found & (ey * (x - px) <= ex * (y - py))
        return found

    def scaled(self, factor: float) -> Polygon:
        """Return it so many times as large, about the origin."""
        return Polygon(tuple((factor * x, factor * y) for x, y in self.points), self.material)


Primitive = Rect | Disc | Polygon


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def depth(outer: Primitive, inner: Primitive) -> float:
    """Return how deep the inner's outline stays inside the outer's; negative if it sticks out."""
    if isinstance(inner, Disc):
        return -float(outer.distance(inner.cx, inner.cy)) - inner.radius
    # All kinds are convex, so the corners are what comes nearest to the outline.
    return -float(np.max(outer.distance(*inner.corners().T)))


def clearance(a: Primitive, b: Primitive) -> float:
    """Return the distance between two disjoint primitives; negative if they meet."""
    if isinstance(b, Disc):
        return float(a.distance(b.cx, b.cy)) - b.radius
    if isinstance(a, Disc):
        return clearance(b, a)
    # Separating axes: two convex polygons meet unless they part along the normal of some side.
    of_a, of_b = a.corners(), b.corners()
    ways = np.concatenate([np.roll(one, -1, axis=0) - one for one in (of_a, of_b)])
    normals = np.stack([ways[:, 1], -ways[:, 0]]) / np.hypot(*ways.T)
    a_on, b_on = of_a @ normals, of_b @ normals
    apart = np.maximum(b_on.min(axis=0) - a_on.max(axis=0), a_on.min(axis=0) - b_on.max(axis=0))
    if apart.max() <= 0:
        return float(apart.max())
    return float(min(a.distance(*of_b.T).min(), b.distance(*of_a.T).min()))
