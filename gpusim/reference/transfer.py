"""Float64 twin of the transfer curves."""

from __future__ import annotations

import numpy as np


def transfer(
    light: np.ndarray, slope: float, cut: float, offset: float, power: float
) -> np.ndarray:
    """Return stored values of light, clipped to 0 to 1: straight up to the cut, then a power."""
    light = np.clip(np.asarray(light, np.float64), 0, 1)
    return np.where(light <= cut, slope * light, (1 + offset) * light**power - offset)
