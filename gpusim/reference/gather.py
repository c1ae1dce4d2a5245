"""Windows of the blocks of an image, back from their column frequencies, overlapped and added."""

from __future__ import annotations

import numpy as np


def gather(columns: np.ndarray, across: int, side: int) -> np.ndarray:
    """Add the windows of all blocks.

    Parameters
    ----------
    columns : ndarray (blocks, T/2 + 1, T), complex
        [kx, y] of each block, row by row.
    across : int
        Blocks in a row.
    side : int
        Samples from a block to the next, each way.

    Returns
    -------
    ndarray (rows, cols), float64
        From the first sample of the first window to the last of the last.
    """
    length = columns.shape[-1]
    down = len(columns) // across
    out = np.zeros(((down - 1) * side + length, (across - 1) * side + length))
    kx = np.arange(length // 2 + 1)
    twice = np.where((kx == 0) | (kx == length // 2), 1.0, 2.0)
    turns = np.exp(2j * np.pi * np.outer(kx, np.arange(length)) / length)
    for block, lines in enumerate(columns):
        y, x = (place * side for place in divmod(block, across))
        out[y : y + length, x : x + length] += ((lines.T * twice) @ turns).real
    return out
