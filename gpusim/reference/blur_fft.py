"""Row spectra of the blocks of an image, weighted for their PSF nodes, by the definition."""

from __future__ import annotations

import numpy as np


def blur_fft(image: np.ndarray, side: int, per_cell: int, length: int) -> np.ndarray:
    """Transform every row of every block, once for the left and once for the right node.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Multiples of `side`.
    side : int
        Side of a block, samples.
    per_cell : int
        Blocks between two nodes.
    length : int
        Length of the transform T; the rows are padded with zeros.

    Returns
    -------
    ndarray (blocks, side, T/2 + 1, 2), complex128
        Blocks row by row; [..., 0] for the left node.
    """
    image = np.asarray(image, np.float64)
    down, across = (count // side for count in image.shape)
    x = np.arange(side)
    basis = np.exp(-2j * np.pi * np.outer(x, np.arange(length // 2 + 1)) / length)
    out = np.empty((down * across, side, length // 2 + 1, 2), complex)
    for block in range(down * across):
        row, column = divmod(block, across)
        part = image[row * side :, column * side :][:side, :side]
        s = (column % per_cell * side + x + 0.5) / (per_cell * side)
        out[block, :, :, 0] = (part * (1 - s)) @ basis
        out[block, :, :, 1] = (part * s) @ basis
    return out
