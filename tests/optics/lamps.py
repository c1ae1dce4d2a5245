"""Lamps before a lens: what the tests of highlights share."""

import numpy as np
from optics.made import BLUE, FLAT, RED, bank

PITCH = 1.55
SPECTRA = np.stack([FLAT, RED, BLUE])
LENS = bank(coma_um=2.0, halo=0.02, falloff=0.3, distortion=-0.04, lateral=(-0.01, 0.0, 0.006))
PLACES = np.array([[40.3, 21.0], [-60.1, 30.7], [-9.4, -55.0], [31.0, -62.3], [0.9, 0.4]])
