"""Float64 twin of the merge of two reads."""

from __future__ import annotations

import numpy as np


def merge(
    high: np.ndarray,
    low: np.ndarray,
    *,
    switch_dn: int,
    black_high_dn: float,
    black_low_dn: float,
    ratio: float,
) -> np.ndarray:
    """Return the high-gain code of each pixel below the switch, the scaled low-gain one above."""
    scaled = np.floor(black_high_dn + ratio * (low.astype(np.float64) - black_low_dn) + 0.5)
    return np.where(high < switch_dn, high, np.clip(scaled, 0, None)).astype(np.uint32)
