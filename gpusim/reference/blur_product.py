"""Columns of the blocks of an image, convolved with the PSFs of four nodes, by the definition.

Windows of blocks below one another overlap, and are added.
"""

from __future__ import annotations

import numpy as np


def blur_product(
    spectra: np.ndarray, psfs: np.ndarray, across: int, per_cell: int, length: int
) -> np.ndarray:
    """Convolve every column of the blocks' row spectra, and add the windows downwards.

    Parameters
    ----------
    spectra : ndarray (blocks, side, T/2 + 1, 2), complex
        Row spectra of the blocks, row by row, for the left and the right node.
    psfs : ndarray (GY, GX, T, T)
        PSF of each node, [y, x], the corner of its window first.
    across : int
        Blocks in a row.
    per_cell : int
        Blocks between two nodes, each way.
    length : int
        Length of the transform T.

    Returns
    -------
    ndarray (across, T/2 + 1, rows), complex128
        [kx, y], rows from the first window's first to the last one's last: the sum over kx of both
        signs of exp(2 pi i kx x / T) is the blur.
    """
    side = spectra.shape[1]
    k = np.arange(length)
    basis = np.exp(-2j * np.pi * np.outer(k, k) / length)
    half = length // 2 + 1
    responses = np.einsum("ky,ijyx,qx->ijqk", basis, psfs, basis[:half], optimize=True)
    down = len(spectra) // across
    out = np.zeros((across, half, (down - 1) * side + length), complex)
    for block, lines in enumerate(spectra):
        row, column = divmod(block, across)
        y = np.arange(side)
        s = (row % per_cell * side + y + 0.5) / (per_cell * side)
        for below, weight in ((0, 1 - s), (1, s)):
            for right in (0, 1):
                columns = np.einsum("y,yq,ky->qk", weight, lines[..., right], basis[:, :side])
                node = responses[row // per_cell + below, column // per_cell + right]
                window = out[column, :, row * side : row * side + length]
                window += (columns * node) @ basis.conj() / length**2
    return out
