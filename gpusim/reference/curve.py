"""Float64 twin of the tone curve."""

from __future__ import annotations

import numpy as np


def curve(values: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return values through a table at equal steps from 0 to 1, straight between its entries."""
    return np.interp(values, np.linspace(0, 1, len(table)), np.asarray(table, np.float64))
