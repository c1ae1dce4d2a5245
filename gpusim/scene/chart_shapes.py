"""What a chart's file may hold: shapes, and groups of them, as fields with values.

Lengths are in the file's unit, x to the right and y down from the middle; angles in degrees, from
x towards y (clockwise as seen).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import product
from typing import Annotated, Any

import numpy as np
from pydantic import Field, PrivateAttr

from gpusim.config.model import Strict
from gpusim.scene.shapes import Disc, Polygon, Primitive, Rect

Length = Annotated[float, Field(ge=-1e6, le=1e6)]
Size = Annotated[float, Field(gt=0, le=1e6)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Count = Annotated[int, Field(ge=1, le=2000, strict=True)]
Point = tuple[Length, Length]
ARC_DEG = 2.0  # of a circle that a straight side stands for: it is 1.5e-4 of the radius too low
MOST_SHAPES = 6000  # pairs of them are looked at: 6000 take a second

FillOf = Callable[[object, str], int]  # what a file says and the field, to a material


class Shape(Strict):
    """A shape in a chart's file."""

    shape: str
    at: Point = (0.0, 0.0)

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield its primitives in the file's unit; `seen` are those before it."""
        raise NotImplementedError


class Rectangle(Shape):
    """A rectangle."""

    size: tuple[Size, Size]
    angle_deg: Angle = 0.0
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield it."""
        half = (side / 2 for side in self.size)
        yield Rect(*self.at, *half, math.radians(self.angle_deg), fill(self.fill, "fill"))


class Circle(Shape):
    """A disc."""

    diameter: Size
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield it."""
        yield Disc(*self.at, self.diameter / 2, fill(self.fill, "fill"))


class Corners(Shape):
    """A polygon by its corners in turn, either way round, that does not cross itself."""

    corners: Annotated[tuple[Point, ...], Field(min_length=3, max_length=200)]
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield it, or triangles that make it up where it is not convex."""
        material = fill(self.fill, "fill")
        points = [(x + self.at[0], y + self.at[1]) for x, y in self.corners]
        if _turn(points) < 0:
            points = points[::-1]
        whole = Polygon(tuple(points), material)
        if whole.least_extent > 0:
            yield whole
        else:
            yield from (Polygon(part, material) for part in _triangles(points))


class Edge(Shape):
    """An upright rectangle in two halves: `fills` left and right of a straight edge.

    The edge passes its middle; at 0 degrees it stands upright.
    """

    size: tuple[Size, Size]
    angle_deg: Annotated[float, Field(ge=-90, le=90)] = 5.0
    fills: tuple[Any, Any]

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield both halves."""
        half_w, half_h = (side / 2 for side in self.size)
        box = [(-half_w, -half_h), (half_w, -half_h), (half_w, half_h), (-half_w, half_h)]
        angle = math.radians(self.angle_deg)
        right = math.cos(angle), math.sin(angle)
        for number, sign in enumerate((-1.0, 1.0)):
            material = fill(self.fills[number], f"fills.{number + 1}")
            part = _beyond(box, (sign * right[0], sign * right[1]))
            yield Polygon(tuple((x + self.at[0], y + self.at[1]) for x, y in part), material)


class Grating(Shape):
    """Bars side by side, `period` apart along their normal; as many as the size holds whole."""

    size: tuple[Size, Size]
    period: Size
    duty: Annotated[float, Field(gt=0, lt=1)] = 0.5
    angle_deg: Angle = 0.0
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield the bars."""
        material, angle = fill(self.fill, "fill"), math.radians(self.angle_deg)
        count = int((self.size[0] / self.period - self.duty) * (1 + 1e-9)) + 1
        _few(count, "bars")
        for k in range(count):
            off = (k - (count - 1) / 2) * self.period
            x, y = self.at[0] + off * math.cos(angle), self.at[1] + off * math.sin(angle)
            yield Rect(x, y, self.duty * self.period / 2, self.size[1] / 2, angle, material)


class Checkerboard(Shape):
    """Every other square of a board; the one at the top left is filled."""

    squares: tuple[Count, Count]
    side: Size
    angle_deg: Angle = 0.0
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield the squares."""
        material, angle = fill(self.fill, "fill"), math.radians(self.angle_deg)
        across, down = self.squares
        _few(across * down / 2, "squares")
        c, s = math.cos(angle), math.sin(angle)
        for row, col in product(range(down), range(across)):
            if (row + col) % 2 == 0:
                x = (col - (across - 1) / 2) * self.side
                y = (row - (down - 1) / 2) * self.side
                middle = self.at[0] + c * x - s * y, self.at[1] + s * x + c * y
                yield Rect(*middle, self.side / 2, self.side / 2, angle, material)


class Star(Shape):
    """A Siemens star of so many dark sectors, as many bright ones between; it is open within."""

    sectors: Annotated[int, Field(ge=2, le=720, strict=True)]
    diameter: Size
    inner_diameter: Size
    angle_deg: Angle = 0.0
    fill: Any

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield the sectors."""
        material, width = fill(self.fill, "fill"), 180 / self.sectors
        if self.inner_diameter >= self.diameter:
            raise ValueError(f"inner_diameter {self.inner_diameter:g} is not below the diameter")
        count = max(1, math.ceil(width / ARC_DEG))
        for k in range(self.sectors):
            start = self.angle_deg + 2 * k * width
            outer = [start + width * part / count for part in range(count + 1)]
            rim = [(self.diameter / 2, turn) for turn in outer]
            rim += [(self.inner_diameter / 2, turn) for turn in (outer[-1], outer[0])]
            points = (
                (
                    self.at[0] + r * math.cos(math.radians(turn)),
                    self.at[1] + r * math.sin(math.radians(turn)),
                )
                for r, turn in rim
            )
            yield Polygon(tuple(points), material)


class Patches(Shape):
    """Rows of square patches, `pitch` apart, on a carrier half a gap larger on each side."""

    pitch: Size
    patch: Size
    rows: Annotated[list[Annotated[list[Any], Field(min_length=1)]], Field(min_length=1)]
    carrier: Any = None

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield the carrier, if there is one, and the patches."""
        across, down = max(map(len, self.rows)), len(self.rows)
        _few(across * down, "patches")
        if self.patch > self.pitch:
            raise ValueError(f"patch {self.patch:g} is larger than the pitch")
        gap = self.pitch - self.patch
        half_w, half_h = across * self.pitch / 2, down * self.pitch / 2
        if self.carrier is not None:
            size = half_w + gap / 2, half_h + gap / 2
            yield Rect(*self.at, *size, 0.0, fill(self.carrier, "carrier"))
        for r, row in enumerate(self.rows):
            for c, one in enumerate(row):
                x = self.at[0] - half_w + (c + 0.5) * self.pitch
                y = self.at[1] - half_h + (r + 0.5) * self.pitch
                material = fill(one, f"rows.{r + 1}.{c + 1}")
                yield Rect(x, y, self.patch / 2, self.patch / 2, 0.0, material)


class Grid(Shape):
    """The same shape many times, `pitch` apart in columns and rows about `at`.

    With `clear`, only where it stays so far from all that came before it.
    """

    pitch: tuple[Size, Size]
    count: tuple[Count, Count]
    clear: Annotated[float, Field(ge=0)] | None = None
    of: dict[str, Any]
    _one: Shape = PrivateAttr()

    def of_shape(self, one: Shape) -> Grid:
        """Return it with the shape that `of` describes."""
        self._one = one
        return self

    def laid(self, fill: FillOf, seen: list[Primitive]) -> Iterator[Primitive]:
        """Yield all copies, row by row."""
        _few(self.count[0] * self.count[1], "copies")
        before = list(seen)
        columns, rows = (
            step * (np.arange(count) - (count - 1) / 2)
            for step, count in zip(self.pitch, self.count, strict=True)
        )
        for y, x in product(rows, columns):
            place = (
                float(self.at[0] + x + self._one.at[0]),
                float(self.at[1] + y + self._one.at[1]),
            )
            copy = list(self._one.model_copy(update={"at": place}).laid(fill, before))
            if self.clear is None or _free(copy, before, self.clear):
                yield from copy


SHAPES: dict[str, type[Shape]] = {
    "rectangle": Rectangle,
    "disc": Circle,
    "polygon": Corners,
    "edge": Edge,
    "grating": Grating,
    "checkerboard": Checkerboard,
    "star": Star,
    "patches": Patches,
    "grid": Grid,
}


def _few(count: float, what: str) -> None:
    if count > MOST_SHAPES:
        raise ValueError(f"{int(count):,} {what}: up to {MOST_SHAPES:,} shapes in a chart")


def _free(copy: list[Primitive], before: list[Primitive], clear: float) -> bool:
    """Return whether a copy stays clear of shapes, by the circles around its parts."""
    return all(
        float(other.distance(one.cx, one.cy)) >= one.reach + clear
        for one in copy
        for other in before
    )


def _turn(points: list[tuple[float, float]]) -> float:
    """Return twice the area of a polygon, positive for clockwise as seen."""
    x, y = np.array(points).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _beyond(
    points: list[tuple[float, float]], normal: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return the part of a convex polygon on one side of a line through the origin."""
    found = []
    for a, b in zip(points, points[1:] + points[:1], strict=True):
        high, low = (x * normal[0] + y * normal[1] for x, y in (a, b))
        if high >= 0:
            found.append(a)
        if high * low < 0:
            share = high / (high - low)
            found.append((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
    return found


def _triangles(points: list[tuple[float, float]]) -> list[tuple[tuple[float, float], ...]]:
    """Return triangles that make up a simple polygon, by cutting ears (Meisters 1975).

    Raises
    ------
    ValueError
        Where there is no ear: the outline crosses itself.
    """
    left, found, area = list(points), [], _turn(points)
    while len(left) > 3:
        for k in range(len(left)):
            ear = (left[k - 1], left[k], left[(k + 1) % len(left)])
            triangle = Polygon(ear, 0)
            others = [one for one in left if one not in ear]
            # An ear that is flatter than this share of its reach counts as a straight line.
            if triangle.least_extent > 1e-9 * triangle.reach and not any(
                triangle.distance(*one) < 0 for one in others
            ):
                found.append(ear)
                del left[k]
                break
        else:
            raise ValueError("the outline crosses itself, or turns back on itself")
    found.append(tuple(left))
    if abs(sum(map(_turn, found)) - area) > 1e-9 * area or Polygon(found[-1], 0).least_extent <= 0:
        raise ValueError("the outline crosses itself, or turns back on itself")
    return found
