"""How much brighter a scene is around its pixels than at them."""

import numpy as np
import pytest

from gpusim.plan.contrast import BESIDE, CHARTS, MOST, contrast_of
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster

PITCH_UM = 4.0


def placed(light: np.ndarray) -> PlacedRaster:
    return PlacedRaster(light[None].astype(np.float32), PITCH_UM, 0.0, 0.0, "")


@pytest.mark.parametrize(
    "scene", [Chart(("white",), 0), placed(np.full((30, 40), 0.2)), placed(np.zeros((9, 9)))]
)
def test_charts_and_even_or_black_photographs_have_the_contrast_of_a_chart(scene):
    assert contrast_of(scene) == CHARTS


def test_a_lamps_surroundings_count_by_its_light():
    """One bright sample, and a Gaussian of 4 samples around it."""
    side, lamp = 65, 2000.0
    light = np.full((side, side), 1.0)
    light[side // 2, side // 2] += lamp
    # The square of a Gaussian of sigma s sums to 1 / (4 pi s^2). Up to two samples from the lamp
    # the own light is brighter than 1; there lie erf(2.5 / 4)^2 = 0.39 of that sum.
    rms = lamp * np.sqrt(1 / (4 * np.pi * 16.0)) / side
    assert np.sqrt(1 - 0.39) * BESIDE * rms < contrast_of(placed(light)) < BESIDE * rms
    assert contrast_of(placed(light * 3.7)) == pytest.approx(contrast_of(placed(light)), rel=1e-5)


def test_no_contrast_is_larger_than_the_largest():
    light = np.full((64, 64), 1e-7)
    light[:, 32:] = 1.0
    assert contrast_of(placed(light)) == MOST
