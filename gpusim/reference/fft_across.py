"""Transform of the pupil along alpha and the intensity, by the definition."""

from __future__ import annotations

import numpy as np


def fft_across(lines: np.ndarray, length: int) -> np.ndarray:
    """Return the intensity at and above the middle row of the PSF.

    Parameters
    ----------
    lines : ndarray (P, N, A), complex
        The pupil transformed along beta: row i at alpha = (i + 1/2) cells; alpha < 0 mirrors it.
    length : int
        T: cells of a period.

    Returns
    -------
    ndarray (P, N/2 + 1, N), float64
        |sum over i of both halves, lines[n, i] exp(2 pi i alpha_i m / T)|^2, m = 0 .. N/2.
    """
    lines = np.asarray(lines, np.complex128)
    _, columns, rows = lines.shape
    m = np.arange(columns // 2 + 1)
    # A cell and its mirror image together: twice the cosine.
    both = 2 * np.cos(2 * np.pi * np.outer(m, np.arange(rows) + 0.5) / length)
    return np.abs(np.einsum("mi,pni->pmn", both, lines)) ** 2
