"""Transform of the pupil along beta, by the definition."""

from __future__ import annotations

import numpy as np


def fft_along(field: np.ndarray, columns: int) -> np.ndarray:
    """Return the wanted columns of the transform of every row.

    Parameters
    ----------
    field : ndarray (P, A, T), complex
        The pupil: row i at alpha = (i + 1/2) cells.
    columns : int
        N: samples of the PSF, the middle one at N/2.

    Returns
    -------
    ndarray (P, N, A), complex128
        Sum over j of field[i, j] exp(2 pi i j n / T), n = -N/2 .. N/2 - 1.
    """
    field = np.asarray(field, np.complex128)
    length = field.shape[-1]
    n = np.arange(columns) - columns // 2
    turns = np.outer(np.arange(length), n) % length / length
    return np.swapaxes(field @ np.exp(2j * np.pi * turns), 1, 2)
