"""Which levels of a halo a tolerance needs, and how well: the better, the darker its shadows."""

import numpy as np
import pytest
from optics.made import FLAT

from gpusim.plan.accuracy import Accuracy
from gpusim.plan.halo import AROUND, MOST_AROUND, halo_levels, surroundings
from gpusim.scene.make import make_scene
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene


class Level:
    """What the planner asks of a level."""

    def __init__(self, share: float) -> None:
        self.psf = np.full((1, 1, 8, 8), share / 64)


def photograph(dark: float) -> Scene:
    planes = np.full((1, 10, 10), 4.0, np.float32)
    planes[0, 0] = dark  # a tenth of it
    return Scene("photograph", FLAT[None], Raster(planes), "D65", FLAT)


@pytest.mark.parametrize(("dark", "ratio"), [(4.0, AROUND), (0.5, 3.65 / 0.5), (1e-3, MOST_AROUND)])
def test_a_photographs_shadows_say_how_well_the_halo_must_be_known(dark: float, ratio: float):
    assert surroundings(photograph(dark)) == pytest.approx(ratio, rel=1e-6)


def test_charts_have_the_contrast_of_their_edges():
    assert surroundings(make_scene("demo")) == AROUND


def test_a_scene_without_light_needs_no_more_than_a_chart():
    black = Scene("black", FLAT[None], Raster(np.zeros((1, 5, 5), np.float32)), "D65", FLAT)
    assert surroundings(black) == AROUND


def test_levels_are_allowed_what_their_light_and_the_scene_leave():
    levels = (Level(1.0), Level(0.01), Level(1e-6))
    (dim,) = halo_levels(levels, Accuracy(1e-3), 50.0)
    (plain,) = halo_levels(levels, Accuracy(1e-3))
    assert dim.number == plain.number == 1  # the other brings too little
    assert plain.accuracy.tolerance == pytest.approx(0.3 * 1e-3 / (AROUND * 0.01))
    assert plain.accuracy.tolerance / dim.accuracy.tolerance == pytest.approx(50 / AROUND)
