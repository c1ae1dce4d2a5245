"""Kernels of whole PSFs, of a lens whose images are Gaussians."""

import numpy as np
from optics.made import at_lines, bank

from gpusim.optics.images import field_images
from gpusim.optics.kernels import (
    field_kernels,
)

LENS = bank(skew_um=2.0)
WEIGHTS = np.random.default_rng(12).uniform(1, 5, (2, 3, 3))


def everything(lens=LENS, weights=WEIGHTS, pitch_um=0.5, reach_um=1e9):
    """Return kernels with the whole PSF, up to the band of a sim grid."""
    images, places = field_images(lens, at_lines(lens, weights), reach_um)
    return field_kernels(images, places, 0.5, pitch_um, np.ones(images.shape[-2:]))
