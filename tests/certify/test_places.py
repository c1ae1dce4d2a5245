"""Pixels that judge a bank: half of them on the steepest edges, half anywhere."""

import numpy as np
import pytest

from gpusim.certify.places import EACH, pixels_near, pixels_on_rings
from gpusim.sensor.load import load_sensor

SENSOR = load_sensor("imx249-mono").model_copy(update={"rows": 400, "cols": 400})
STEP = 230  # the first white column
PLACES = 4


def on_rings(rate: np.ndarray) -> np.ndarray:
    radii = np.array([60.0, 90.0, 120.0, 150.0]) * SENSOR.pixel_pitch_um
    return pixels_on_rings(SENSOR, rate, (0, 0), radii)[0]


def near_points(rate: np.ndarray) -> np.ndarray:
    points = np.array([[-40.0, -30.0], [50.0, 0.0], [0.0, 70.0], [30.0, 60.0]])
    return pixels_near(SENSOR, rate, (0, 0), points * SENSOR.pixel_pitch_um)[0]


@pytest.mark.parametrize("pixels_of", [on_rings, near_points])
def test_half_of_the_pixels_lie_on_edges_and_half_anywhere(pixels_of):
    """An edge between two columns: rings cross it in two of four quarters, strips all do."""
    rate = np.full((400, 400), 5.0)
    rate[:, STEP:] = 80.0
    pixels = pixels_of(rate)
    assert len(pixels) == PLACES * EACH
    on_edge = np.isin(pixels[:, 1], (STEP - 1, STEP))
    assert 0.2 <= on_edge.mean() <= 0.5
    dark = rate[tuple(pixels[~on_edge].T)] == 5.0
    assert dark.any()
    np.testing.assert_array_equal(pixels, pixels_of(rate))
