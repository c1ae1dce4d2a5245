"""Matrices of RGB spaces and adaptation against colour-science."""

import numpy as np
import pytest
from harness import assert_close

from gpusim.scene.colorimetry import (
    REC709_CHROMATICITIES,
    adaptation,
    encode_srgb,
    rgb_to_xyz,
)

colour = pytest.importorskip("colour", reason="colour-science is the reference here")
# Well-conditioned 3 x 3 products and solutions of numbers of order 1: some tens of roundings.
ROUNDING = 1e-13


@pytest.mark.parametrize("space", ["ITU-R BT.709", "ACES2065-1", "Display P3", "ACEScg"])
def test_rgb_to_xyz_is_the_normalised_primary_matrix(space):
    published = colour.RGB_COLOURSPACES[space]
    reference = colour.models.normalised_primary_matrix(published.primaries, published.whitepoint)
    ours = rgb_to_xyz((*published.primaries.ravel(), *published.whitepoint))
    assert_close(ours, reference, atol=ROUNDING)


def test_rec709_chromaticities_are_the_standard_ones():
    published = colour.RGB_COLOURSPACES["ITU-R BT.709"]
    reference = np.concatenate([published.primaries.ravel(), published.whitepoint])
    assert_close(np.array(REC709_CHROMATICITIES), reference, atol=0)


def test_adaptation_is_bradfords():
    d50, d65 = np.array([0.9642, 1.0, 0.8251]), np.array([0.9505, 1.0, 1.089])
    reference = colour.adaptation.matrix_chromatic_adaptation_VonKries(
        d50, d65, transform="Bradford"
    )
    assert_close(adaptation(d50, d65), reference, atol=ROUNDING)
    assert_close(adaptation(d50, d65) @ d50, d65, atol=ROUNDING)


def test_encode_srgb_is_the_srgb_curve_and_clips():
    linear = np.concatenate([np.linspace(0, 1, 101), [0.0031308, 0.003, 0.0032]])
    assert_close(encode_srgb(linear), colour.models.eotf_inverse_sRGB(linear), atol=ROUNDING)
    assert_close(encode_srgb(np.array([-1.0, 2.0])), np.array([0.0, 1.0]), atol=ROUNDING)
