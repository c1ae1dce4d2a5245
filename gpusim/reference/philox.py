"""Philox4x32-10 on NumPy integers, and the counters by which the sensor stages use it."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

SHOT, READ, PRNU, DSNU = 1, 2, 3, 4
PRNU_ROW, PRNU_COLUMN, DSNU_ROW, DSNU_COLUMN = 5, 6, 7, 8
ROW_NOISE, COLUMN_NOISE, RESET, DARK_CURRENT = 9, 10, 11, 12
COLUMN = 32
"""Purposes: upper half of the last counter word."""


def philox(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Return the four words of each counter (Salmon, Moraes, Dror & Shaw 2011, section 3.3).

    Parameters
    ----------
    counter : array of integers (..., 4)
    key : array of integers (..., 2)

    Returns
    -------
    ndarray (..., 4), uint32
    """
    c0, c1, c2, c3 = np.moveaxis(np.asarray(counter, np.uint64), -1, 0)
    k0, k1 = np.moveaxis(np.asarray(key, np.uint64), -1, 0)
    word, low = np.uint64(32), np.uint64(0xFFFFFFFF)
    for _ in range(10):
        p0, p1 = c0 * np.uint64(0xD2511F53), c2 * np.uint64(0xCD9E8D57)
        c0, c1, c2, c3 = (p1 >> word) ^ c1 ^ k0, p1 & low, (p0 >> word) ^ c3 ^ k1, p0 & low
        k0, k1 = (k0 + np.uint64(0x9E3779B9)) & low, (k1 + np.uint64(0xBB67AE85)) & low
    return np.stack(np.broadcast_arrays(c0, c1, c2, c3), axis=-1).astype(np.uint32)


def shared_word(
    row: np.ndarray, col: np.ndarray, frame: int, purpose: int, key: int, *, draw: int = 0
) -> np.ndarray:
    """Return one word for each pixel, one call serving four neighbours of a row."""
    last = np.uint64(purpose << 16 | draw)
    counter = np.stack(np.broadcast_arrays(col // 4, row, np.uint64(frame), last), axis=-1)
    words = philox(counter, (key & 0xFFFFFFFF, key >> 32))
    return np.take_along_axis(words, np.asarray(col % 4, np.intp)[..., None], axis=-1)[..., 0]


def deviate(row: np.ndarray, col: np.ndarray, frame: int, purpose: int, key: int) -> np.ndarray:
    """Return the standard normal deviate of each pixel, the quantile of its word."""
    return ndtri((shared_word(row, col, frame, purpose, key) + 0.5) / 2**32)


def row_deviate(row: np.ndarray, frame: int, purpose: int, key: int) -> np.ndarray:
    """Return the deviate of each pixel's row: that of its first pixel."""
    return deviate(row, np.zeros_like(row), frame, purpose, key)


def column_deviate(col: np.ndarray, frame: int, purpose: int, key: int) -> np.ndarray:
    """Return the deviate of each pixel's column: that of its pixel in the first row."""
    return deviate(np.zeros_like(col), col, frame, purpose, key)
