"""Transform of the pupil along alpha and the intensity, by the definition."""

from __future__ import annotations

import numpy as np


def fft_across(lines: np.ndarray, length: int, mirrored: bool = True) -> np.ndarray:
    """Return the intensity of the PSF: at and above the middle row where the pupil is mirrored.

    Parameters
    ----------
    lines : ndarray (P, N, A), complex
        The pupil transformed along beta: row i at alpha = (i + 1/2) cells from where they begin.
    length : int
        T: cells of a period.
    mirrored : bool
        Whether rows begin at alpha = 0, and alpha < 0 mirrors them.

    Returns
    -------
    ndarray (P, M, N), float64
        |sum over i, lines[n, i] exp(2 pi i alpha_i m / T)|^2, m = 0 .. N/2 of both halves, or else
        m = -N/2 .. N/2 - 1.
    """
    lines = np.asarray(lines, np.complex128)
    _, columns, rows = lines.shape
    m = np.arange(columns // 2 + 1) if mirrored else np.arange(columns) - columns // 2
    turn = np.exp(2j * np.pi * np.outer(m, np.arange(rows) + 0.5) / length)
    if mirrored:  # a cell and its mirror image together
        turn = 2 * turn.real
    return np.abs(np.einsum("mi,pni->pmn", turn, lines)) ** 2
