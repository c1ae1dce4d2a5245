"""Charts: flat materials bounded by exact rectangles and discs on the ideal image plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
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

    def distance(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the distance from the outline, negative inside."""
        return np.hypot(x - self.cx, y - self.cy) - self.radius


Primitive = Rect | Disc


def _depth(outer: Primitive, inner: Primitive) -> float:
    """Return how deep the inner's outline stays inside the outer's; negative if it sticks out."""
    if isinstance(inner, Disc):
        return -float(outer.distance(inner.cx, inner.cy)) - inner.radius
    # Both kinds are convex, so the corners are what comes nearest to the outline.
    return -float(np.max(outer.distance(*inner.corners().T)))


def _clearance(a: Primitive, b: Primitive) -> float:
    """Return the distance between two disjoint primitives; negative if they meet."""
    if isinstance(b, Disc):
        return float(a.distance(b.cx, b.cy)) - b.radius
    if isinstance(a, Disc):
        return _clearance(b, a)
    # Separating axes: two convex polygons meet unless they part along the normal of some side.
    parting = -math.inf
    for angle in (a.angle_rad, b.angle_rad):
        axes = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        of_a, of_b = a.corners() @ axes.T, b.corners() @ axes.T
        apart = np.maximum(of_b.min(axis=0) - of_a.max(axis=0), of_a.min(axis=0) - of_b.max(axis=0))
        parting = max(parting, float(apart.max()))
    if parting <= 0:
        return parting
    return float(min(a.distance(*b.corners().T).min(), b.distance(*a.corners().T).min()))


def materials_under(primitives: Sequence[Primitive], background: int) -> np.ndarray:
    """Return the index (P,) of the material all around each primitive, in painter's order."""
    under = np.full(len(primitives), background)
    x, y = np.array([(shape.cx, shape.cy) for shape in primitives]).reshape(-1, 2).T
    for number, shape in enumerate(primitives, start=1):
        under[number:][shape.distance(x[number:], y[number:]) <= 0] = shape.material
    return under


@dataclass(frozen=True)
class Chart:
    """Materials painted over a background, in painter's order.

    Any two primitives are disjoint or one lies within an earlier one, and no two outlines touch; so
    each has one material all around it.

    Attributes
    ----------
    materials : tuple of str
        Names; `background` and the primitives give indices into them.
    background : int
        Material under all primitives, without bounds.
    primitives : tuple of Rect or Disc
        Lengths in half-heights of the sensor, or in um once `placed`; origin on the optical axis.

    Raises
    ------
    ValueError
        If a material is unknown, an extent is not positive or primitives cross, touch or hide one
        another.
    """

    materials: tuple[str, ...]
    background: int
    primitives: tuple[Primitive, ...] = ()

    def __post_init__(self) -> None:
        for label, material in [
            ("background", self.background),
            *((f"primitive {i}", p.material) for i, p in enumerate(self.primitives)),
        ]:
            if not 0 <= material < len(self.materials):
                raise ValueError(
                    f"{label}: material {material} is not one of {len(self.materials)}"
                )
        for i, p in enumerate(self.primitives):
            extents = (p.radius,) if isinstance(p, Disc) else (p.half_w, p.half_h)
            if not min(extents) > 0:
                raise ValueError(f"primitive {i}: extent {min(extents)} is not positive")
        _ = self.gap  # computing it finds what crosses, touches or hides

    def __hash__(self) -> int:
        # Caches ask often; by all primitives it takes a millisecond.
        return hash((self.materials, self.background, len(self.primitives)))

    @cached_property
    def gap(self) -> float:
        """Least distance between any two outlines, in the primitives' unit; infinite below two."""
        shapes = self.primitives
        if len(shapes) < 2:
            return math.inf
        centre = np.array([[p.cx, p.cy] for p in shapes])
        reach = np.array([p.reach for p in shapes])
        earlier, later = np.triu_indices(len(shapes), k=1)
        between = np.hypot(*(centre[earlier] - centre[later]).T) - reach[earlier] - reach[later]
        gap = math.inf
        # Two primitives are at least as far apart as the circles around them: nearest first, until
        # no pair can be nearer than the nearest so far.
        for k in np.argsort(between, kind="stable"):
            if between[k] > 0 and between[k] >= gap:
                break
            a, b = shapes[earlier[k]], shapes[later[k]]
            distance = _clearance(a, b)
            if distance <= 0:
                distance = _depth(a, b)
            if distance <= 0:
                raise ValueError(
                    f"primitives {earlier[k]} and {later[k]} cross, touch, or the later hides the "
                    f"earlier: {a}, {b}"
                )
            gap = min(gap, distance)
        return gap

    @cached_property
    def under(self) -> np.ndarray:
        """Index of the material around each primitive."""
        return materials_under(self.primitives, self.background)

    def placed(self, half_height_um: float) -> Chart:
        """Return the chart in um on a sensor of that half-height."""
        scaled = []
        for p in self.primitives:
            extents = ("radius",) if isinstance(p, Disc) else ("half_w", "half_h")
            changed = {name: getattr(p, name) * half_height_um for name in ("cx", "cy", *extents)}
            scaled.append(replace(p, **changed))
        # Nothing crosses now that did not before: the gap is as much larger, and not sought anew.
        placed = object.__new__(Chart)
        placed.__dict__.update(vars(self), primitives=tuple(scaled), gap=self.gap * half_height_um)
        return placed

    def material_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the index of the material at each point; an outline belongs to its primitive.

        Parameters
        ----------
        x, y : ndarray, broadcastable
            In the unit of the primitives.
        """
        x, y = np.broadcast_arrays(x, y)
        material = np.full(x.shape, self.background)
        for p in self.primitives:
            material[p.distance(x, y) <= 0] = p.material
        return material
