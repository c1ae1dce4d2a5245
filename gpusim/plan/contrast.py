"""How much brighter than its pixels' own light a scene is around them.

Light that is left out of a PSF far from its middle is missing where the scene is dark beside what
is bright. It is planned for an edge, relative to the light beside it, and counts by the contrast.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter

from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster

CHARTS = 20.0  # of a white next to a dark neighbour
# Photographs are measured: by how much what lies within a Gaussian of this sigma is brighter than
# what is at a pixel, the RMS relative to the latter, times BESIDE. A still life with lamps at
# f/2.8, on pixels of 1.55 um, has an RMS of 3. There the tail cut off at 32 um, planned as 8.4e-6
# of an edge, brought the engine 2.0e-3: 240 times as much. Beside lamps it was 5e-3; without a cut
# 5e-4.
AROUND_UM, OWN_UM = 16.0, 1.5
BESIDE = 80.0
MOST = 500.0
DARKEST = 1e-9  # of the brightest: nothing is darker


@lru_cache(maxsize=4)
def contrast_of(placed: Chart | PlacedRaster) -> float:
    """Return by how much an edge's error beside its bright side counts more where it is dark."""
    if isinstance(placed, Chart):
        return CHARTS
    light = placed.planes.max(axis=0)
    around, own = (
        gaussian_filter(light, max(sigma_um / placed.pitch_um, 0.5), truncate=3.0)
        for sigma_um in (AROUND_UM, OWN_UM)
    )
    lit = around > 0
    if not lit.any():
        return CHARTS
    more = around[lit] / np.maximum(own[lit], DARKEST * float(light.max())) - 1
    rms = float(np.sqrt(np.mean(np.square(more, dtype=np.float64))))
    return float(np.clip(BESIDE * rms, CHARTS, MOST))
