"""Float64 twin of black level and linearisation."""

from __future__ import annotations

import numpy as np


def linear(
    codes: np.ndarray, black: np.ndarray, span: float, table: np.ndarray | None = None
) -> np.ndarray:
    """Return light of codes (rows, cols): 0 at black, 1 at black + span.

    ``black`` is repeated over the frame, from its first pixel.
    """
    level = codes.astype(np.float64) if table is None else np.asarray(table, np.float64)[codes]
    times = [-(-n // period) for n, period in zip(codes.shape, black.shape, strict=True)]
    rows, cols = codes.shape
    return (level - np.tile(black, times)[:rows, :cols]) / span
