"""Between the fields of a bank: closed forms."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from gpusim.formats.ready import load_ready
from gpusim.optics.angular import TurnedHeights
from gpusim.psf.places import FieldGrid, Heights, Places, half_turned, lagrange

RADIUS = np.array([0.0, 30.0, 70.0, 100.0, 160.0, 200.0])
GRID = FieldGrid(np.linspace(-2, 2, 7), np.linspace(-1, 1, 5), lambda x, y: (x / 100, y / 150))
TURN = np.linspace(0, 2 * np.pi, 9)
# Three terms of each of the seven fields, that at -r among them, by azimuth.
TERMS = np.random.default_rng(3).normal(size=(7, 9, 3))
TERMS[:, -1] = TERMS[:, 0]
TURNED = TurnedHeights(
    Heights(RADIUS), tuple(CubicSpline(TURN, one, bc_type="periodic") for one in TERMS)
)


def test_cubics_come_out_as_they_are_and_the_nearest_four_make_them():
    at = np.linspace(0, 200, 101)
    numbers, weights = lagrange(RADIUS, at)
    for power in range(4):
        found = np.sum(weights * (RADIUS[numbers] / 100) ** power, axis=1)
        np.testing.assert_allclose(found, (at / 100) ** power, atol=1e-12)
    inner = (at >= RADIUS[1]) & (at < RADIUS[-2])
    # Two on either side.
    assert (RADIUS[numbers[inner, 1]] <= at[inner]).all()
    assert (RADIUS[numbers[inner, 2]] > at[inner]).all()


@pytest.mark.parametrize("count", [2, 3, 6])
def test_heights_hold_what_is_even_and_what_is_odd(count: int):
    """Across the axis: even powers up to the third, and with the half-turned field odd ones."""
    heights = Heights(RADIUS[:count])
    at = np.linspace(0, RADIUS[count - 1], 57)
    even = heights.even(np.stack([RADIUS[:count] ** 2, 1 + 0 * RADIUS[:count]], axis=1), at)
    np.testing.assert_allclose(even, np.stack([at**2, 1 + 0 * at], axis=1), atol=1e-9)
    signed = np.append(RADIUS[:count], -RADIUS[1])
    for radius in at:
        blend = heights.at(0.6 * radius, -0.8 * radius)
        assert sum(blend.weights) == pytest.approx(1)
        found = np.dot(blend.weights, signed[list(blend.fields)])
        assert found == pytest.approx(radius, abs=1e-9)
    assert heights.opposite == (count,)


@pytest.mark.parametrize("places", [Heights(RADIUS), Heights(RADIUS[:2]), GRID, TURNED])
def test_many_points_at_once_are_the_same_one_by_one(places: Places):
    """The axis, the fields themselves, and points beyond the last among them."""
    rng = np.random.default_rng(2)
    x, y = np.concatenate([rng.uniform(-250, 250, (60, 2)), [[0, 0], [30, 0], [0, -70]]]).T
    found = places.blends(x, y)
    for number, point in enumerate(zip(x, y, strict=True)):
        one = places.at(*point)
        counts = dict.fromkeys(one.fields, 0.0)
        for field, weight in zip(found.fields[number], found.weights[number], strict=True):
            if weight:
                counts[field] += weight
        # The same products; a sum of four differs by its order, 4 roundings of 1e-16.
        np.testing.assert_allclose(list(counts.values()), one.weights, atol=1e-15)
        assert (found.cos[number], found.sin[number]) == (one.cos, one.sin)


def test_what_is_even_has_no_cusp_on_the_axis():
    """The cubic through r^4 at -h, 0, h, 2 h has the slope -2 h^3 there, that through r^2 none.

    Straight lines have that of the chord.
    """
    u = np.linspace(0, 1, 9)
    table = 1 - u**2 + u**4
    near = Heights(u).even(table, np.array([0.0, 1e-4]))
    assert np.diff(near)[0] / 1e-4 == pytest.approx(-2 / 8**3, abs=2e-4)  # r^2: 1e-4 of its own
    assert (table[1] - 1) / u[1] < -0.1


def test_half_a_turn_is_about_the_middle_sample():
    image = np.zeros((8, 8))
    image[4, 4], image[5, 6] = 2.0, 1.0
    expected = np.zeros((8, 8))
    expected[4, 4], expected[3, 2] = 2.0, 1.0
    np.testing.assert_array_equal(half_turned(image), expected)


def cos4_error(lens) -> np.ndarray:
    made = lens.bank()
    r = np.linspace(0, made.image_circle_um, 4001)
    found = made.illumination_at(r, 0 * r)
    return found - np.cos(np.arctan(r / (1e3 * made.efl_mm))) ** 4


def test_the_light_of_a_table_is_as_smooth_as_its_own_law(tmp_path: Path):
    """cos^4 in steps of an eighth of the focal length, exact and to the table's four digits."""
    source = Path("gpusim/data/mtf/diffraction-limited.yaml")
    text = source.read_text()
    # Rounded at 5e-5, which the spline through it doubles: measured 1.0e-4.
    assert np.abs(cos4_error(load_ready(source))).max() < 1.5e-4
    for height, printed in ((1, "0.9695"), (2, "0.8858"), (3, "0.7686"), (4, "0.6400")):
        assert printed in text
        exact = np.cos(np.arctan(height / 8)) ** 4
        text = text.replace(f"relative_illumination: {printed}", f"relative_illumination: {exact}")
    (tmp_path / "exact.yaml").write_text(text)
    error = cos4_error(load_ready(tmp_path / "exact.yaml"))
    steps = np.arange(4001) / 1000
    print("RI", np.abs(error[:, steps <= 3]).max(), np.abs(error).max())
    assert np.abs(error).max() < 1e-5
    line = np.interp(steps, np.arange(5), np.cos(np.arctan(np.arange(5) / 8)) ** 4)
    assert np.abs(line - np.cos(np.arctan(steps / 8)) ** 4).max() > 7e-3  # a control
