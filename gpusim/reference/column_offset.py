"""Float64 twin of the column offsets."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from gpusim.reference.philox import COLUMN, shared_word


def column_offset(col: np.ndarray, serial_number: int, sigma_dn: float) -> np.ndarray:
    """Return the offset of each column's converter, DN."""
    word = shared_word(np.zeros_like(col), col, 0, COLUMN, serial_number)
    return sigma_dn * ndtri((word + 0.5) / 2**32)
