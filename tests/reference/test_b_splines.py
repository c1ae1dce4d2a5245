"""B-splines between even samples, against SciPy's own evaluation of them.

Tolerance: rounding of sums of some hundred products of numbers about one.
"""

import numpy as np
import pytest
from harness import assert_close
from scipy.ndimage import map_coordinates, shift

from gpusim.reference.b_splines import moved, values

ROUNDING = 1e-13


@pytest.mark.parametrize("degree", [1, 3, 5])
@pytest.mark.parametrize("shape", [(20, 31), (31, 20), (6, 6)])
def test_values_are_those_of_splines_that_mirror_their_ends(degree: int, shape: tuple[int, int]):
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=(3, *shape))
    last = np.array(shape) - 1
    y, x = (rng.uniform(0, 1, (40, 5)) * end for end in last)
    y[:4, 0], x[:4, 0] = [0, 0, last[0], last[0]], [0, last[1], 0, last[1]]
    found = values(coefficients, y, x, degree=degree)
    given = {"order": degree, "prefilter": False, "mode": "mirror"}
    expected = [map_coordinates(one, [y, x], **given) for one in coefficients]
    assert_close(found, np.stack(expected, axis=-1), atol=ROUNDING)


def test_many_points_at_once_are_the_points_alone(monkeypatch):
    rng = np.random.default_rng(2)
    coefficients, at = rng.normal(size=(2, 9, 9)), rng.uniform(0, 8, (2, 50))
    whole = values(coefficients, *at)
    monkeypatch.setattr("gpusim.reference.b_splines.TOGETHER", 7)
    assert_close(values(coefficients, *at), whole, atol=0)


@pytest.mark.parametrize("way", [(0.3, -1.7), (0.0, 2.25), (-3.25, 0.0), (1.0, 1.0), (0.0, 0.0)])
@pytest.mark.parametrize("degree", [3, 5])
def test_moved_samples_are_those_of_the_moved_spline(way: tuple[float, float], degree: int):
    """The spot is 1e-20 of its peak at the margins, which bend the spline to its own ends."""
    y, x = np.mgrid[-40:40, -40:40]
    spot = np.exp(-(x**2 + y**2) / 18) * (1 + 0.1 * np.cos(x))
    assert_close(moved(spot, way, degree), shift(spot, way, order=degree), atol=ROUNDING)
