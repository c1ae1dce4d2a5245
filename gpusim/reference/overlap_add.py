"""Windows of the columns of blocks of an image, back from their frequencies, and added."""

from __future__ import annotations

import numpy as np


def overlap_add(columns: np.ndarray, side: int, length: int) -> np.ndarray:
    """Transform the windows of all columns of blocks back, and add them.

    Parameters
    ----------
    columns : ndarray (across, T/2 + 1, rows), complex
        [kx, y] of each column of blocks.
    side : int
        Samples from a block to the next.
    length : int
        Length of the transform T.

    Returns
    -------
    ndarray (rows, cols), float64
        From the first sample of the first window to the last of the last.
    """
    across, _, rows = columns.shape
    out = np.zeros((rows, (across - 1) * side + length))
    kx = np.arange(length // 2 + 1)
    twice = np.where((kx == 0) | (kx == length // 2), 1.0, 2.0)
    turns = np.exp(2j * np.pi * np.outer(kx, np.arange(length)) / length)
    for column, lines in enumerate(columns):
        out[:, column * side : column * side + length] += ((lines.T * twice) @ turns).real
    return out
