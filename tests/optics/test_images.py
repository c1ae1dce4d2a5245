"""Images at the bank's fields: their light, and where lateral colour moves it."""

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines
from optics.whole import LENS, WEIGHTS

from gpusim.optics.images import field_images


def test_images_hold_the_energy_of_their_weights():
    images, places = field_images(LENS, at_lines(LENS, WEIGHTS), 1e9)
    light = LENS.relative_illumination[[0, 1, 2, 3, 1]]
    expected = np.einsum("jcl,fl->fjc", WEIGHTS, light)
    assert_close(images.sum(axis=(3, 4)), expected, rtol=1e-6)  # PSFs sum to 1 in f32
    assert_close(places.radius_um, LENS.real_height_um[:, 1].copy(), atol=0)


def test_images_stop_at_the_second_field_beyond_the_reach():
    radius_um = LENS.real_height_um[:, 1]
    for reach, fields in ((1.0, 3), (radius_um[1] + 1, 4), (radius_um[1] - 1, 3), (1e9, 4)):
        images, places = field_images(LENS, at_lines(LENS, WEIGHTS[:1, :1]), reach)
        found = places.radius_um
        assert len(images) == fields + 1  # and one beyond the axis
        assert len(found) == fields and (found[-2] >= reach or fields == 4)


@pytest.mark.parametrize("place", [0, 1, 2])
def test_lateral_colour_moves_the_psf_along_the_radius(place: int):
    weights = np.zeros((1, 1, 3))
    weights[..., place] = 1.0
    images, _ = field_images(LENS, at_lines(LENS, weights), 1e9)
    for field in range(4):
        at = np.arange(128) - 64
        moved = images[field, 0, 0]
        centre = np.array([(moved.sum(axis=0) * at).sum(), (moved.sum(axis=1) * at).sum()]) * 0.5
        centre /= moved.sum()
        shift = LENS.real_height_um[field, place] - LENS.real_height_um[field, 1]
        share = field / 3
        # A quarter of the light lies 3 um outwards and 2 um along the tangent at the rim; what the
        # window cuts off, 14 standard deviations away, and the f32 of the PSF are below 1e-5 um.
        assert_close(centre, np.array([0.75 * share + shift, 0.5 * share]), atol=1e-5)
