"""Float64 twin of the analogue-to-digital converter."""

from __future__ import annotations

import numpy as np


def adc(
    electrons: np.ndarray, system_gain_dn_per_e: float, black_level_dn: float, bit_depth: int
) -> np.ndarray:
    """Return the DN of each pixel: rounded halves up, clipped to the codes of the converter."""
    level = system_gain_dn_per_e * np.asarray(electrons, np.float64) + black_level_dn
    return np.clip(np.floor(level + 0.5), 0, 2**bit_depth - 1).astype(np.uint32)
