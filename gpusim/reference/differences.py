"""Float64 twin of directional demosaicing's first stage."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate1d

FILTER = np.array([-0.25, 0.5, 0.5, 0.5, -0.25])


def differences(light: np.ndarray) -> np.ndarray:
    """Return what light differs by from green along row and column: (rows, cols, 2).

    The frame is mirrored at its border, and all its pixels get a value. Those of red and blue sites
    count (Menon, Andriani and Calvagno 2007, section II-A).
    """
    light = np.asarray(light, np.float64)
    greens = [correlate1d(light, FILTER, axis=axis, mode="mirror") for axis in (1, 0)]
    return light[..., None] - np.stack(greens, axis=-1)
