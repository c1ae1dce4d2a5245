"""Inverse transform in x at the photosites and overlap-add, by the definitions."""

from __future__ import annotations

import numpy as np


def inverse_fft(
    folded: np.ndarray,
    rates: np.ndarray,
    origin_xy: tuple[int, int],
    step_xy: tuple[int, int],
    seen_xy: tuple[int, int],
) -> np.ndarray:
    """Add one block's window to the planes of the CFA sites.

    Parameters
    ----------
    folded : ndarray (S, T/2+1, M), complex
        Half spectra in x at every row of photosites, as
        `gpusim.reference.fft_columns.fft_columns` returns them.
    rates : ndarray (S, rows, cols)
        Planes of the CFA sites, electrons/s.
    origin_xy : (int, int)
        Column and row of the window's first photosite in the planes; what falls outside is dropped.
    step_xy : (int, int)
        From a photosite of the window to the next, in the planes: 1, or -1 for a mirror image.
    seen_xy : (int, int)
        Photosites of the window that are added, across and down.

    Returns
    -------
    ndarray (S, rows, cols), float64
    """
    folded = np.asarray(folded, np.complex128)
    _, half, count = folded.shape
    length = 2 * (half - 1)
    stride = length // count
    # A real signal from its half spectrum: the inner frequencies stand for themselves and their
    # mirror.
    weight = np.full(half, 2.0)
    weight[[0, -1]] = 1.0
    basis = np.exp(2j * np.pi * np.outer(np.arange(half), stride * np.arange(count)) / length)
    window = np.einsum("skm,k,kn->smn", folded, weight, basis).real
    out = np.array(rates, np.float64)
    _, rows, cols = out.shape
    for m in range(seen_xy[1]):
        for n in range(seen_xy[0]):
            y, x = origin_xy[1] + step_xy[1] * m, origin_xy[0] + step_xy[0] * n
            if 0 <= y < rows and 0 <= x < cols:
                out[:, y, x] += window[:, m, n]
    return out
