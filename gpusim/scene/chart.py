"""Charts: flat materials bounded by exact outlines on the ideal image plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.scene.shapes import Disc, Polygon, Primitive, Rect, clearance, depth

__all__ = ["Chart", "Disc", "Polygon", "Primitive", "Rect", "materials_under"]

# By how much two outlines may overlap, over the larger one's reach: what corners of a grid round
# to. What is painted twice there, or not at all, is as much too bright or dark.
ROUNDING = 1e-9


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

    Any two primitives are disjoint or one lies within an earlier one; outlines may touch. So each
    has one material all around it, but for what it touches, and the chart is the sum of steps from
    that material to its own.

    Attributes
    ----------
    materials : tuple of str
        Names; `background` and the primitives give indices into them.
    background : int
        Material under all primitives, without bounds.
    primitives : tuple of Rect, Disc or Polygon
        Lengths in half-heights of the sensor, or in um once `placed`; origin on the optical axis.

    Raises
    ------
    ValueError
        If a material is unknown, an extent is not positive, a polygon is not convex, or primitives
        cross or hide one another.
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
            if not p.least_extent > 0:
                raise ValueError(f"primitive {i}: extent {p.least_extent} is not positive")
        _ = self.gap  # computing it finds what crosses or hides

    def __hash__(self) -> int:
        # Caches ask often; by all primitives it takes a millisecond.
        return hash((self.materials, self.background, len(self.primitives)))

    @cached_property
    def gap(self) -> float:
        """Least distance between any two outlines, in the primitives' unit: 0 where two touch.

        Infinite below two.
        """
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
            touch = ROUNDING * max(a.reach, b.reach)
            distance = clearance(a, b)
            nested = distance < -touch
            if nested:
                distance = depth(a, b)
            if nested and (distance < -touch or depth(b, a) >= -touch):
                raise ValueError(
                    f"primitives {earlier[k]} and {later[k]} cross, or the later hides the "
                    f"earlier: {a}, {b}"
                )
            gap = min(gap, distance if distance > touch else 0.0)
        return gap

    @cached_property
    def under(self) -> np.ndarray:
        """Index of the material around each primitive."""
        return materials_under(self.primitives, self.background)

    def placed(self, half_height_um: float) -> Chart:
        """Return the chart in um on a sensor of that half-height."""
        scaled = [p.scaled(half_height_um) for p in self.primitives]
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
