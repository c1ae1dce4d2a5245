"""How much brighter a scene is around its pixels than at them."""

import numpy as np
import pytest

from gpusim.plan.contrast import (
    BESIDE,
    CHARTS,
    MOST,
    PHOTOGRAPH,
    STEEPEST,
    contrast_of,
    edge_contrast,
)
from gpusim.scene.chart import Chart, Disc, Polygon, Rect
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


HALF_UM = (600.0, 500.0)
LIGHT = np.array([1.0, 0.25, 0.0625, 0.9])


def chart(*shapes) -> Chart:
    return Chart(("white", "grey", "dark", "pale"), 0, shapes)


@pytest.mark.parametrize(
    "shape",
    [
        Rect(0.0, 0.0, 40.0, 30.0, 0.3, 1),
        Disc(210.0, -90.0, 50.0, 1),
        Polygon(((-400.0, -400.0), (-300.0, -380.0), (-350.0, -300.0)), 1),
    ],
)
def test_one_outline_has_its_own_contrast(shape):
    assert edge_contrast(chart(shape), LIGHT, HALF_UM, np.copy) == pytest.approx(4.0)


def test_each_part_of_the_sensor_counts_by_its_steepest_edge():
    """Parts are 200 um wide: one has an edge of 4:1, another one of 16:1 and a faint one."""
    grey, dark = Rect(-500.0, -400.0, 40.0, 40.0, 0.0, 1), Rect(500.0, 400.0, 40.0, 40.0, 0.0, 2)
    pale = Rect(440.0, 440.0, 9.0, 9.0, 0.0, 3)
    found = edge_contrast(chart(grey, dark, pale), LIGHT, HALF_UM, np.copy)
    assert np.log(found) == pytest.approx(np.sqrt((np.log(4) ** 2 + np.log(16) ** 2) / 2))
    # What lies beyond the sensor is not seen.
    beyond = Rect(900.0, 0.0, 40.0, 40.0, 0.0, 2)
    assert edge_contrast(chart(grey, beyond), LIGHT, HALF_UM, np.copy) == pytest.approx(4.0)


def test_edges_count_where_distortion_brings_them():
    """Half as far from the middle as on the ideal plane: what is far out there is seen."""
    far = Rect(900.0, 0.0, 40.0, 40.0, 0.0, 2)
    given = chart(far), LIGHT, HALF_UM
    assert edge_contrast(*given, np.copy) == 1.0
    assert edge_contrast(*given, lambda ideal: ideal / 2) == pytest.approx(16.0)


def test_black_counts_as_what_is_seen_of_it_and_an_even_chart_as_nothing():
    hole = chart(Disc(0.0, 0.0, 50.0, 2))
    assert edge_contrast(hole, np.array([1.0, 1.0, 0.0, 1.0]), HALF_UM, np.copy) == pytest.approx(
        STEEPEST
    )
    assert edge_contrast(chart(), LIGHT, HALF_UM, np.copy) == 1.0
    assert edge_contrast(placed(np.full((9, 9), 0.2)), LIGHT, HALF_UM, np.copy) == PHOTOGRAPH
