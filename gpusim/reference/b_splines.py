"""B-splines between even samples: their values at points, and moved by parts of a sample."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array


def between(
    y: np.ndarray,
    x: np.ndarray,
    *,
    side: int,
    degree: int,
    count: int,
    begin: np.ndarray | int = 0,
) -> csr_array:
    """Return the matrix (P, count) by which spline coefficients become values at points (...).

    Parameters
    ----------
    y, x : ndarray (...), P in all
        Rows and columns in squares of `side` coefficients each way, which end in nothing.
    side, degree, count : int
        Coefficients along a side, degree of the splines, and coefficients in all.
    begin : ndarray (...) of int
        Number of the first coefficient of the square.
    """
    places, weights = [], []
    for at in (y, x):
        first, of_taps = _taps(at, degree)
        there = np.clip(first, 0, side - degree - 1)
        places.append(there)
        weights.append(of_taps * (there == first)[..., None])
    taps = np.arange(degree + 1, dtype=np.int32)
    first = (begin + places[0] * side + places[1]).astype(np.int32)
    number = first[..., None, None] + (taps[:, None] * np.int32(side) + taps)
    data = weights[0][..., :, None] * weights[1][..., None, :]
    ends = np.arange(0, data.size + 1, (degree + 1) ** 2, dtype=np.int32)
    return csr_array((data.ravel(), number.ravel(), ends), shape=(first.size, count))


def _taps(at: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first coefficient around places (...), and the B-splines (..., degree + 1) there.

    The degree is odd. Cox and de Boor's recursion makes the splines: where t of a cell has passed,
    the k + 1 splines of degree k are B_k,j = ((k - j + t) B_k-1,j-1 + (j + 1 - t) B_k-1,j) / k.
    """
    cell = np.floor(at)
    t = at - cell
    splines = [np.ones_like(t)]
    for k in range(1, degree + 1):
        below = [0.0, *splines, 0.0]
        splines = [((k - j + t) * below[j] + (j + 1 - t) * below[j + 1]) / k for j in range(k + 1)]
    return cell.astype(np.int32) - degree // 2, np.stack(splines, axis=-1)


def moved_by(ways: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return by what transforms (L, F) of samples become those of splines moved by so many samples.

    Frequencies in cycles a sample. The samples of a cubic spline with coefficients of transform C
    have C (4 + 2 cos w) / 6; moved, those of the B-splines around in place of 1/6, 4/6, 1/6.
    """
    turn = np.exp(-2j * np.pi * frequencies)
    of_samples = (4 + 2 * turn.real) / 6
    first, weights = _taps(-ways, 3)
    numbers = -(first[:, None] + np.arange(4))
    moved = np.einsum("lt,ltf->lf", weights, turn ** numbers[..., None])
    return np.where(ways[:, None] == 0, of_samples, moved) / of_samples**2
