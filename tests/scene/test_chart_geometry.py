"""Shapes, their distances, and what a chart accepts, against outlines sampled densely."""

import math
from itertools import pairwise

import numpy as np
import pytest
from harness import assert_close
from scipy.spatial import cKDTree

from gpusim.scene import Chart, Disc, Polygon, Rect
from gpusim.scene.charts import load_chart

RECT = Rect(0.3, -0.2, 0.5, 0.15, math.radians(25), 1)
DISC = Disc(-0.4, 0.1, 0.35, 1)
KITE = Polygon(((-0.5, -0.1), (0.2, -0.6), (0.7, 0.1), (0.1, 0.4)), 1)


def outline(shape: Rect | Disc | Polygon, spacing: float) -> np.ndarray:
    """Return points (n, 2) on the outline, at most `spacing` apart, by complex numbers."""
    if isinstance(shape, Disc):
        turns = np.arange(0, 1, spacing / (2 * np.pi * shape.radius))
        z = shape.radius * np.exp(2j * np.pi * turns)
    else:
        if isinstance(shape, Polygon):
            corners = np.array(shape.points) @ [1, 1j] - shape.cx - 1j * shape.cy
            corners = np.append(corners, corners[0])
        else:
            w, h = shape.half_w, shape.half_h
            corners = np.array([-w - 1j * h, w - 1j * h, w + 1j * h, -w + 1j * h, -w - 1j * h])
        sides = [
            a + (b - a) * np.linspace(0, 1, math.ceil(abs(b - a) / spacing) + 1)
            for a, b in pairwise(corners)
        ]
        z = np.concatenate(sides) * np.exp(1j * getattr(shape, "angle_rad", 0.0))
    z = z + shape.cx + 1j * shape.cy
    return np.stack([z.real, z.imag], axis=1)


def winding_inside(shape: Rect | Disc, points: np.ndarray) -> np.ndarray:
    """Return which points the outline goes around, by its winding number."""
    z = outline(shape, 0.002) @ [1, 1j]
    steps = np.append(z, z[0])[None, :] - (points @ [1, 1j])[:, None]
    turned = np.angle(steps[:, 1:] / steps[:, :-1]).sum(axis=1)
    return np.abs(turned) > np.pi


@pytest.mark.parametrize("shape", [RECT, DISC, KITE], ids=["rect", "disc", "polygon"])
def test_distance_is_that_from_the_outline_and_negative_inside(shape):
    points = np.random.default_rng(1).uniform(-1, 1, (400, 2))
    spacing = 1e-3
    away = cKDTree(outline(shape, spacing)).query(points)[0]
    signed = np.where(winding_inside(shape, points), -away, away)
    # The nearest sample of the outline is at most half a spacing from the nearest point of it.
    assert_close(shape.distance(*points.T), signed, atol=spacing / 2)


def test_a_positive_angle_turns_from_x_towards_y():
    shape = Rect(0, 0, 1.0, 0.1, math.radians(10), 0)
    end = 0.95 * np.array([math.cos(math.radians(10)), math.sin(math.radians(10))])
    assert shape.distance(*end) < 0 < shape.distance(end[0], -end[1])


def test_corners_are_where_the_outline_turns():
    shape = RECT
    corners = shape.corners()
    assert_close(shape.distance(*corners.T), np.zeros(4), atol=1e-15)  # numbers below 1
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    assert_close(sides, np.array([1.0, 0.3, 1.0, 0.3]), atol=1e-15)


@pytest.mark.parametrize("shape", [RECT, DISC, KITE], ids=["rect", "disc", "polygon"])
def test_material_is_painted_later_over_earlier(shape):
    inner = Disc(shape.cx, shape.cy, 0.05, 2)
    chart = Chart(("paper", "ink", "core"), 0, (shape, inner))
    points = np.random.default_rng(2).uniform(-1, 1, (2000, 2))
    expected = np.where(winding_inside(shape, points), 1, 0)
    expected[np.hypot(points[:, 0] - shape.cx, points[:, 1] - shape.cy) <= 0.05] = 2
    assert set(expected) == {0, 1, 2}
    assert_close(chart.material_at(*points.T), expected, atol=0)


def test_material_at_broadcasts():
    chart = Chart(("paper", "ink"), 0, (DISC,))
    x, y = np.linspace(-1, 1, 7), np.linspace(-1, 1, 5)
    grid = chart.material_at(x[None, :], y[:, None])
    assert grid.shape == (5, 7)
    assert_close(grid, chart.material_at(*np.meshgrid(x, y)), atol=0)


def test_placed_scales_everything():
    chart = Chart(("paper", "ink"), 0, (RECT, Disc(-0.6, 0.5, 0.2, 1)))
    half_height_um = 1178.0
    placed = chart.placed(half_height_um)
    points = np.random.default_rng(3).uniform(-1, 1, (2000, 2))
    assert_close(
        placed.material_at(*(points * half_height_um).T), chart.material_at(*points.T), atol=0
    )
    assert placed.gap == pytest.approx(chart.gap * half_height_um, rel=1e-12)


CROSSING = {
    "plus": (Rect(0, 0, 1, 0.1, 0, 1), Rect(0, 0, 0.1, 1, 0, 1)),
    "corner": (Rect(0, 0, 1, 1, 0, 1), Rect(1.2, 1.2, 0.5, 0.5, math.pi / 4 + 0.01, 1)),
    "discs": (Disc(0, 0, 1, 1), Disc(1.5, 0, 0.6, 1)),
    "disc over a side": (Rect(0, 0, 1, 1, 0.3, 1), Disc(1.1, 0, 0.3, 1)),
    "overlapping by 1e-6": (Rect(0, 0, 1, 1, 0, 1), Rect(2 - 1e-6, 0, 1, 1, 0, 1)),
    "out by 1e-6": (Disc(0, 0, 1, 1), Disc(0.5 + 1e-6, 0, 0.5, 1)),
    "kites": (KITE, Polygon(((0.5, 0.0), (1.2, -0.5), (1.2, 0.5)), 1)),
    "hidden": (Disc(0, 0, 0.5, 1), Rect(0, 0, 1, 1, 0, 1)),
    "same": (RECT, RECT),
}


@pytest.mark.parametrize("shapes", CROSSING.values(), ids=CROSSING.keys())
def test_shapes_that_cross_or_hide_are_refused(shapes):
    with pytest.raises(ValueError, match="primitives 0 and 1"):
        Chart(("paper", "ink"), 0, shapes)


HALF = math.radians(15)  # of a sector
TOUCHING = {
    "sides": (Rect(0, 0, 1, 1, 0.3, 1), Rect(2 * math.cos(0.3), 2 * math.sin(0.3), 1, 1, 0.3, 1)),
    "corners": (Rect(0, 0, 0.1, 0.3, 0, 1), Rect(0.2, 0.6, 0.1, 0.3, 0, 1)),
    "discs": (Disc(0, 0, 1, 1), Disc(1.8, 2.4, 2, 1)),
    "disc in a disc": (Disc(0, 0, 1, 1), Disc(0.5, 0, 0.5, 1)),
    "side by side in a rect": (Rect(0, 0, 2, 1, 0, 1), Rect(-1, 0, 1, 1, 0, 0)),
    "sectors": tuple(
        Polygon(((0, 0), *((math.cos(at + t), math.sin(at + t)) for t in (-HALF, HALF))), 1)
        for at in (0.7, 0.7 + 2 * HALF)
    ),
}


@pytest.mark.parametrize("shapes", TOUCHING.values(), ids=TOUCHING.keys())
def test_shapes_that_touch_are_no_distance_apart(shapes):
    assert Chart(("paper", "ink"), 0, shapes).gap == 0


def test_a_checkerboard_is_accepted():
    """At 7 degrees, where corners meet to a rounding only."""
    c, s = math.cos(math.radians(7)), math.sin(math.radians(7))
    squares = tuple(
        Rect(0.1 * (c * x - s * y), 0.1 * (s * x + c * y), 0.05, 0.05, math.radians(7), 1)
        for x in range(-9, 10)
        for y in range(-9, 10)
        if (x + y) % 2
    )
    chart = Chart(("paper", "ink"), 0, squares)
    assert chart.gap == 0
    assert set(chart.under) == {0}


APART = {
    "discs": ((Disc(0, 0, 1, 1), Disc(3, 4, 1.5, 1)), 2.5),
    "nested discs": ((Disc(0, 0, 1, 1), Disc(0.3, 0.4, 0.2, 1)), 0.3),
    "disc beside a corner": ((Rect(0, 0, 1, 1, 0, 1), Disc(4, 5, 1, 1)), 4.0),
    "disc in a rect": ((Rect(0, 0, 2, 1, 0.3, 1), Disc(0, 0, 0.4, 1)), 0.6),
    "rect in a disc": ((Disc(0, 0, 6, 1), Rect(0, 0, 3, 4, 0.5, 1)), 1.0),
    "nested rects": ((Rect(0, 0, 3, 3, 0.2, 1), Rect(0, 0, 1, 2, 0.2, 1)), 1.0),
    "corner before a side": (
        (Rect(0, 0, 1, 1, 0, 1), Rect(3, 0, 0.5, 0.5, math.pi / 4, 1)),
        2 - math.sqrt(0.5),
    ),
    # Their boxes overlap along both of the first one's axes: only the second one's part them.
    "diagonal": (
        (Rect(0, 0, 1, 1, 0, 1), Rect(1.5, 1.5, 2, 0.2, -math.pi / 4, 1)),
        1.5 * math.sqrt(2) - 0.2 - math.sqrt(2),
    ),
}


@pytest.mark.parametrize(("shapes", "gap"), APART.values(), ids=APART.keys())
def test_gap_is_the_least_distance_between_outlines(shapes, gap):
    assert Chart(("paper", "ink"), 0, shapes).gap == pytest.approx(gap, rel=1e-12)


def test_gap_of_a_chart_with_many_shapes_agrees_with_sampled_outlines():
    chart = load_chart("demo").source
    spacing = 1e-3
    points = [outline(p, spacing) for p in chart.primitives]
    owner = np.repeat(np.arange(len(points)), [len(p) for p in points])
    tree = cKDTree(np.concatenate(points))
    pairs = tree.query_pairs(1.2 * chart.gap, output_type="ndarray")
    pairs = pairs[owner[pairs[:, 0]] != owner[pairs[:, 1]]]
    nearest = np.linalg.norm(tree.data[pairs[:, 0]] - tree.data[pairs[:, 1]], axis=1).min()
    # Each end is within half a spacing of a sample of its outline.
    assert chart.gap <= nearest + 1e-12
    assert nearest - chart.gap <= spacing


def test_a_chart_of_one_shape_or_none_has_no_gap():
    assert Chart(("paper", "ink"), 0, (RECT,)).gap == math.inf
    assert Chart(("paper",), 0).gap == math.inf


@pytest.mark.parametrize("material", [-1, 2])
def test_an_unknown_material_is_refused(material):
    with pytest.raises(ValueError, match=f"material {material}"):
        Chart(("paper", "ink"), 0, (Disc(0, 0, 1, material),))
    with pytest.raises(ValueError, match=f"background: material {material}"):
        Chart(("paper", "ink"), material)


@pytest.mark.parametrize(
    "shape",
    [
        *(Disc(0, 0, 0, 1), Disc(0, 0, math.nan, 1), Rect(0, 0, 1, -1, 0, 1)),
        *(Rect(0, 0, 0, 1, 0, 1), Polygon(((0, 0), (1, 0), (2, 0)), 1)),
        Polygon(KITE.points[::-1], 1),  # the other way round
        Polygon(((0, 0), (2, 0), (0.5, 0.5), (0, 2)), 1),  # not convex
        Polygon(
            tuple(
                (math.cos(2.4 * k * math.pi / 3), math.sin(2.4 * k * math.pi / 3)) for k in range(5)
            ),
            1,
        ),
    ],
)
def test_an_extent_that_is_not_positive_is_refused(shape):
    with pytest.raises(ValueError, match="is not positive"):
        Chart(("paper", "ink"), 0, (shape,))
