"""Areas of shapes inside quadrilaterals: exact where geometry gives them, else sampled."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.reference.coverage import area, clip, disc_area, part_of
from gpusim.scene.chart import Disc, Polygon, Rect

RNG = np.random.default_rng(77)
SIDE = 400  # midpoints along each side of a quadrilateral


def rectangle_area(some: np.ndarray, centre, half_size, angle: float) -> np.ndarray:
    """Return the area of each quadrilateral inside a turned rectangle."""
    return part_of(some, Rect(*centre, *half_size, angle, 0))[0] * area(some)


def quads(count: int, size: float, spread: float) -> np.ndarray:
    """Return apertures as a distorting lens shows them: squares, turned, sheared and displaced."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * size
    bend = RNG.uniform(-0.1, 0.1, (count, 4, 2)) * size
    angle = RNG.uniform(0, 2 * np.pi, count)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    middle = RNG.uniform(-spread, spread, (count, 1, 2))
    return np.einsum("nvi,ijn->nvj", square + bend, turn) + middle


def sampled(quad: np.ndarray, inside) -> float:
    """Return the area inside by midpoints in the quadrilateral's own coordinates."""
    s = (np.arange(SIDE) + 0.5) / SIDE
    u, v = s[:, None], s
    a, b, c, d = quad
    points = np.stack(
        [(1 - u) * ((1 - v) * a[i] + v * b[i]) + u * ((1 - v) * d[i] + v * c[i]) for i in (0, 1)],
        -1,
    )
    across = (1 - u)[..., None] * (b - a) + u[..., None] * (c - d)
    down = (1 - v[:, None]) * (d - a) + v[:, None] * (c - b)
    jacobian = across[..., 0] * down[None, :, 1] - across[..., 1] * down[None, :, 0]
    return float(np.sum(np.abs(jacobian) * inside(points)) / SIDE**2)


# A midpoint on the wrong side of an edge: the edges cross at most 4 SIDE cells, half of which are
# off by half a cell each way, at random; a tenth of the worst case.
SAMPLING = 0.1 * 4 / SIDE


def test_areas_of_polygons():
    square = np.array([[[0, 0], [2, 0], [2, 3], [0, 3]]], float)
    assert_close(area(square), np.array([6.0]), atol=1e-12)
    assert_close(area(square[:, ::-1]), np.array([6.0]), atol=1e-12)
    triangle = np.array([[[1, 1], [5, 1], [1, 4]]], float)
    assert_close(area(triangle), np.array([6.0]), atol=1e-12)


@pytest.mark.parametrize("limit", [-0.8, -0.3, 0.0, 0.2, 0.49, 0.8])
def test_clipping_a_square(limit: float):
    square = np.array([[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]])
    for normal in ([1.0, 0.0], [0.0, -1.0]):
        kept = area(clip(square, np.array(normal), limit))
        assert_close(kept, np.array([np.clip(limit + 0.5, 0, 1)]), atol=1e-12)
    # Along the diagonal: a triangle of legs (limit sqrt 2 + 1) to begin with.
    diagonal = area(clip(square, np.array([1.0, 1.0]) / np.sqrt(2), limit))
    reach = np.clip(limit * np.sqrt(2) + 1, 0, 2)
    exact = reach**2 / 2 if reach <= 1 else 1 - (2 - reach) ** 2 / 2
    assert_close(diagonal, np.array([exact]), atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, 1.4, -2.0])
def test_rectangles_against_sampling(angle: float):
    shape = (0.3, -0.2), (0.9, 0.4), angle

    def inside(p: np.ndarray) -> np.ndarray:
        d = p - np.array(shape[0])
        c, s = np.cos(angle), np.sin(angle)
        return (abs(d @ [c, s]) <= 0.9) & (abs(d @ [-s, c]) <= 0.4)

    some = quads(25, 0.7, 1.0)
    expected = np.array([sampled(quad, inside) for quad in some])
    assert_close(rectangle_area(some, *shape), expected, atol=SAMPLING * 0.7**2)
    assert np.ptp(expected) > 0.1


def test_discs_against_sampling():
    def inside(p: np.ndarray) -> np.ndarray:
        return np.hypot(p[..., 0] - 0.2, p[..., 1] + 0.1) <= 0.8

    for size in (0.5, 2.5):
        some = quads(25, size, 0.9)
        expected = np.array([sampled(quad, inside) for quad in some])
        assert_close(disc_area(some, (0.2, -0.1), 0.8), expected, atol=SAMPLING * size**2)
        assert np.ptp(expected) > 0.1


def test_pieces_make_the_whole():
    """A lattice of bent quadrilaterals without gaps: the areas add up to those of the shapes."""
    at = np.linspace(-3, 3, 14)
    x, y = np.meshgrid(at, at)
    bent = np.stack([x + 0.07 * np.sin(3 * y), y + 0.05 * np.cos(2 * x)], axis=-1)
    corners = [bent[:-1, :-1], bent[:-1, 1:], bent[1:, 1:], bent[1:, :-1]]
    pieces = np.stack(corners, axis=2).reshape(-1, 4, 2)
    rectangle = rectangle_area(pieces, (0.1, 0.2), (1.3, 0.7), 0.4).sum()
    assert rectangle == pytest.approx(4 * 1.3 * 0.7, rel=1e-12)
    assert disc_area(pieces, (-0.3, 0.4), 1.7).sum() == pytest.approx(np.pi * 1.7**2, rel=1e-12)


def test_inside_outside_and_around():
    square = np.array([[[-1, -1], [1, -1], [1, 1], [-1, 1]]], float)
    assert_close(disc_area(square, (0, 0), 5.0), np.array([4.0]), atol=1e-12)
    assert_close(disc_area(square, (0, 0), 0.5), np.array([np.pi / 4]), atol=1e-12)
    assert_close(disc_area(square, (9, 0), 0.5), np.array([0.0]), atol=1e-12)
    assert_close(disc_area(square, (1.0, 0), 0.5), np.array([np.pi / 8]), atol=1e-12)
    assert_close(disc_area(square, (1.0, 1.0), 0.5), np.array([np.pi / 16]), atol=1e-12)
    assert_close(rectangle_area(square, (0, 0), (5, 5), 0.3), np.array([4.0]), atol=1e-12)
    assert_close(rectangle_area(square, (0, 0), (0.2, 0.3), 0.3), np.array([0.24]), atol=1e-12)
    assert_close(rectangle_area(square, (9, 0), (0.2, 0.3), 0.3), np.array([0.0]), atol=1e-12)


def test_a_polygon_of_four_right_angles_is_a_rectangle():
    rect = Rect(0.3, -0.2, 0.9, 0.4, 0.3, 0)
    polygon = Polygon(tuple(map(tuple, rect.corners())), 0)
    corners = np.array([[-0.5, -0.5], [0.5, -0.4], [0.6, 0.5], [-0.4, 0.4]])
    some = RNG.uniform(-1.5, 1.5, (200, 1, 2)) + corners * RNG.uniform(0.05, 2, (200, 1, 1))
    (share, mass), (expected, middle) = part_of(some, polygon), part_of(some, rect)
    assert ((share > 0.01) & (share < 0.99)).sum() > 50
    # The numbers are near 1 and come about in other ways; nothing has no middle.
    assert_close(share, expected, atol=1e-12)
    assert_close(share[:, None] * mass, expected[:, None] * middle, atol=1e-12)


def middles(some: np.ndarray, inside) -> np.ndarray:
    """Return the centre of mass of each parallelogram's part that is inside, by midpoints."""
    s = (np.arange(SIDE) + 0.5) / SIDE
    u, v = np.meshgrid(s, s)
    found = []
    for a, b, _, d in some:
        points = a + u[..., None] * (b - a) + v[..., None] * (d - a)
        found.append(points[inside(points)].mean(axis=0))
    return np.array(found)


@pytest.mark.parametrize("shape", [Rect(0.3, -0.2, 0.9, 0.4, 0.3, 0), Disc(0.2, -0.1, 30.0, 0)])
def test_centres_of_mass_against_sampling(shape):
    """Parallelograms about the outline; the disc's is all but straight over one of them."""
    c, s = np.cos(0.3), np.sin(0.3)
    if isinstance(shape, Disc):
        angle = RNG.uniform(0, 2 * np.pi, 9)
        near = np.array([0.2, -0.1]) + 30.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    else:
        along = RNG.uniform(-0.7, 0.7, 9)  # the lower side and a corner
        near = np.array([0.3, -0.2]) + along[:, None] * [c, s] + 0.4 * np.array([-s, c])
        near[0] = shape.corners()[2]
    corners = np.array([[-0.5, -0.5], [0.5, -0.4], [0.6, 0.5], [-0.4, 0.4]]) * 0.2
    some = near[:, None] + RNG.uniform(-0.05, 0.05, (9, 1, 2)) + corners
    share, mass = part_of(some, shape)
    assert (share > 0.01).all() and (share < 0.999).all()
    expected = middles(some, lambda p: shape.distance(p[..., 0], p[..., 1]) < 0)
    # Midpoints: half a step of 0.2 / 400 along the outline; a disc's sagitta: 0.2^2 / (8 x 30).
    assert_close(mass, expected, atol=0.2 / SIDE + 0.2**2 / 240)
    assert np.abs(expected - some.mean(axis=1)).max() > 0.03  # a control: they are not the middles


def test_what_is_not_cut_keeps_its_middle():
    square = np.array([[[-1, -1], [1, -1], [1, 1], [-1, 1]]], float)
    for shape in (Rect(0, 0, 5, 5, 0.3, 0), Disc(0.3, 0, 9.0, 0)):
        share, mass = part_of(square, shape)
        assert_close(share, np.ones(1), atol=1e-12)
        assert_close(mass, np.zeros((1, 2)), atol=1e-12)
    for shape in (Rect(9, 0, 0.2, 0.3, 0.3, 0), Disc(9.0, 0, 0.5, 0)):
        share, mass = part_of(square, shape)
        assert_close(share, np.zeros(1), atol=1e-12)
        assert np.isfinite(mass).all()
