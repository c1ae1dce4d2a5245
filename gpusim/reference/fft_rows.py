"""Forward transform of the rows of a source block, by the definition."""

from __future__ import annotations

import numpy as np


def fft_rows(planes: np.ndarray, first_s: float, step_s: float, length: int) -> np.ndarray:
    """Transform every row of a block, weighted for its left and right PSF node.

    Parameters
    ----------
    planes : ndarray (J, B, B)
        Coefficient planes of one source block.
    first_s, step_s : float
        Position between the left node (0) and the right node (1): of sample 0, and per sample.
    length : int
        Transform length T >= B; the rows are padded with zeros.

    Returns
    -------
    ndarray (J, B, T), complex128
        The transform of the row weighted for the left node, plus i times that for the right node.
    """
    planes = np.asarray(planes, np.float64)
    x = np.arange(planes.shape[-1])
    s = first_s + step_s * x
    basis = np.exp(-2j * np.pi * np.outer(x, np.arange(length)) / length)
    return (planes * (1.0 - s)) @ basis + 1j * ((planes * s) @ basis)
