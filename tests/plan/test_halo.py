"""Which levels of a halo a tolerance needs, and how well: the better, the darker its shadows."""

import numpy as np
import pytest
from optics.made import FLAT

from gpusim.plan.accuracy import Accuracy
from gpusim.plan.halo import AROUND, SHARE, halo_levels, seen_shares
from gpusim.scene.make import make_scene
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

HALF_UM = (200.0, 160.0)  # photographs of 100 x 80 samples, 4 um apart


class Level:
    """What the planner asks of a level: a disc of even light."""

    def __init__(self, share: float, pitch_um: float = 4.0) -> None:
        at = np.arange(16) - 8
        disc = np.hypot(at, at[:, None]) < 6
        self.psf = np.full((1, 1, 16, 16), share / disc.sum()) * disc
        self.pitch_um = pitch_um


LEVELS = (Level(0.98, 0.5), Level(0.015), Level(0.005, 16.0))


def photograph(planes: np.ndarray) -> Scene:
    return Scene("photograph", FLAT[None], Raster(planes[None].astype(np.float32)), "D65", FLAT)


def test_before_an_even_photograph_a_level_brings_its_share():
    found = seen_shares(LEVELS, photograph(np.full((80, 100), 4.0)), HALF_UM)
    # Sums of float64 by transforms.
    np.testing.assert_allclose(found, [0.015, 0.005], rtol=1e-9)


def test_beside_a_lamp_a_level_brings_all_that_shadows_have():
    """One lamp in black: the core's light lies within it, the levels' light is a disc around."""
    planes = np.zeros((80, 100))
    planes[40, 50] = 1e6
    near, far = seen_shares(LEVELS, photograph(planes), HALF_UM)
    # The first level's disc has 24 um, the second's 96 um: nearly all that is lit by it alone.
    assert near**2 < 0.1
    assert 0.8 < far**2 < 1.0


@pytest.mark.parametrize("light", [1.0, 4e3])
def test_the_brightness_of_all_does_not_count(light: float):
    rng = np.random.default_rng(3)
    planes = rng.uniform(0, 1, (80, 100)) ** 8
    found = seen_shares(LEVELS, photograph(light * planes), HALF_UM)
    # Photographs are kept in float32, 6e-8 of each sample; transforms sum them with brighter ones.
    np.testing.assert_allclose(found, seen_shares(LEVELS, photograph(planes), HALF_UM), rtol=1e-5)
    # Beside bright samples dark ones take more than the share from the halo.
    assert (found > 1.5 * np.array([0.015, 0.005])).all()


@pytest.mark.parametrize("scene", [make_scene("demo"), photograph(np.zeros((5, 5)))])
def test_charts_have_the_contrast_of_their_edges_and_black_needs_no_more(scene: Scene):
    # The same product, in float64.
    np.testing.assert_allclose(
        seen_shares(LEVELS, scene, HALF_UM), AROUND * np.array([0.015, 0.005]), rtol=1e-9
    )


def test_levels_are_allowed_what_their_light_and_the_scene_leave():
    levels = (Level(1.0), Level(0.01), Level(1e-6))
    (level,) = halo_levels(levels, Accuracy(1e-3), np.array([0.05, 1e-5]))
    assert level.number == 1  # the other brings too little
    assert level.accuracy.tolerance == pytest.approx(SHARE * 1e-3 / 0.05)
