"""The halo at photosites, from samples on a coarse grid."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline


def halo(coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Evaluate cubic splines at points.

    Parameters
    ----------
    coefficients : ndarray (C, rows, cols)
        Coefficients of the B-splines centred on the samples.
    x, y : ndarray (P,)
        Points, in samples from the first one's centre; two samples and more within the border.

    Returns
    -------
    ndarray (C, P), float64
    """
    bump = BSpline.basis_element([-2, -1, 0, 1, 2], extrapolate=False)
    rows, cols = coefficients.shape[1:]
    down = np.nan_to_num(bump(y[:, None] - np.arange(rows)))
    across = np.nan_to_num(bump(x[:, None] - np.arange(cols)))
    return np.einsum("pr,crk,pk->cp", down, coefficients.astype(np.float64), across)
