"""B-splines between even samples: their values at points, and moved by parts of a sample."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.ndimage import correlate1d, spline_filter1d
from scipy.sparse import csr_array

TOGETHER = 8192  # points of a sparse matrix: some MiB, which stay in the processor's cache


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


def values(
    coefficients: np.ndarray, y: np.ndarray, x: np.ndarray, *, degree: int = 3
) -> np.ndarray:
    """Return values (..., M) of splines (M, rows, cols) at points (...), which mirror their ends.

    Parameters
    ----------
    coefficients : ndarray (M, rows, cols)
    y, x : ndarray (...)
        Rows and columns, between the first coefficient and the last.
    degree : int
        Odd.
    """
    around = degree // 2 + 1
    whole = np.pad(coefficients, ((0, 0), (around, around), (around, around)), "reflect")
    side = max(whole.shape[1:])
    table = np.zeros((side, side, len(whole)))
    table[: whole.shape[1], : whole.shape[2]] = np.moveaxis(whole, 0, -1)
    table = table.reshape(side**2, -1)
    at = [np.ravel(one) + around for one in (y, x)]
    found = np.empty((y.size, len(whole)))
    for first in range(0, y.size, TOGETHER):
        part = slice(first, first + TOGETHER)
        found[part] = (
            between(*(one[part] for one in at), side=side, degree=degree, count=side**2) @ table
        )
    return found.reshape(*y.shape, -1)


def moved(samples: np.ndarray, way: tuple[float, float], degree: int) -> np.ndarray:
    """Return samples (n, n) that their splines have, moved by so many samples down and across.

    What leaves on one side comes in on the other: both margins hold nothing.
    """
    for axis, by in enumerate(way):
        if not by:
            continue
        (first,), (weights,) = _taps(np.array([-by]), degree)
        # A correlation counts from the middle of its weights: with one more they have a middle.
        line = np.append(weights, 0.0)
        splines = spline_filter1d(samples, degree, axis, mode="grid-wrap")
        splines = np.roll(splines, -first - len(line) // 2, axis)
        samples = correlate1d(splines, line, axis, mode="wrap")
    return samples


def _taps(at: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first coefficient around places (...), and the B-splines (..., degree + 1) there.

    The degree is odd.
    """
    cell = np.floor(at)
    t = at - cell
    powers = np.ones((degree + 1, *t.shape))
    for k in range(degree):
        np.multiply(powers[k], t, out=powers[k + 1])
    return cell.astype(np.int32) - degree // 2, np.moveaxis(powers, 0, -1) @ _polynomials(degree)


@cache
def _polynomials(degree: int) -> np.ndarray:
    """Return the coefficients of t^i (i, j) in the B-splines j of a cell, of which t has passed.

    By Cox and de Boor's recursion: the k + 1 splines of degree k are
    B_k,j = ((k - j + t) B_k-1,j-1 + (j + 1 - t) B_k-1,j) / k.
    """
    splines = [np.ones(1)]
    for k in range(1, degree + 1):
        below = [np.zeros(k), *splines, np.zeros(k)]
        splines = [
            (np.convolve(below[j], [k - j, 1]) + np.convolve(below[j + 1], [j + 1, -1])) / k
            for j in range(k + 1)
        ]
    return np.stack(splines, axis=-1)


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
