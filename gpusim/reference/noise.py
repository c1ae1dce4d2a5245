"""Float64 twin of the noise stage: its laws, and its numbers from the same random words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import ndtri, pdtr, pdtrc

from gpusim.reference.philox import (
    COLUMN_NOISE,
    DSNU,
    DSNU_COLUMN,
    DSNU_ROW,
    READ,
    RESET,
    ROW_NOISE,
    SHOT,
    column_deviate,
    deviate,
    row_deviate,
    shared_word,
)

SUMS_BELOW = 10.0
"""Mean from which one word is enough, as long as it lies not too far below the mean: ..."""
SUMS_BEYOND = -0.7
"""... in units of sqrt(mean) standard deviations."""
NEAR_END = 2**20
"""Distance of a word from its ends up to which a second one follows it."""


def tails(words: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return u and 1 - u of 64-bit words (..., 2), high first: u = (word + 1/2) / 2^64."""
    low_first = np.moveaxis(np.asarray(words, np.uint32)[..., ::-1], -1, 0)
    u, rest = (
        (high + (low + 0.5) / 2**32) / 2**32
        for low, high in (low_first.astype(np.float64), (~low_first).astype(np.float64))
    )
    return u, rest


def poisson_quantile(mean: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Return the count k with P(X < k) < u <= P(X <= k).

    Parameters
    ----------
    mean : ndarray (n,)
    words : ndarray (n, 2), uint32
        Words of u, high word first: see :func:`tails`.
    """
    u, rest = tails(words)
    z = np.where(u < 0.5, ndtri(u), -ndtri(rest))
    # Cornish & Fisher's first terms, and steps from there: the distribution function decides.
    count = np.floor(np.maximum(mean + z * np.sqrt(mean) + (z**2 + 2) / 6, 0))
    step = np.ones(count.shape)
    while step.any():
        step = np.zeros(count.shape)
        step[_reaches(mean, count - 1, u, rest) & (count > 0)] = -1
        step[~_reaches(mean, count, u, rest)] = 1
        count += step
    return count


def _reaches(mean: np.ndarray, count: np.ndarray, u: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return where u <= P(X <= count), compared in the smaller tail."""
    count = np.maximum(count, 0)
    return np.where(u < 0.5, u <= pdtr(count, mean), rest >= pdtrc(count, mean))


def poisson(
    mean: np.ndarray, row: np.ndarray, col: np.ndarray, frame: int, seed: int
) -> np.ndarray:
    """Return the Poisson count of each pixel, from the same words as the stage."""
    mean = np.asarray(mean, np.float64)
    high, low = (shared_word(row, col, frame, SHOT, seed, draw=draw) for draw in (0, 1))
    with np.errstate(divide="ignore"):
        sums = (mean < SUMS_BELOW) | (
            deviate(row, col, frame, SHOT, seed) / np.sqrt(mean) < SUMS_BEYOND
        )
    fine = sums & (np.minimum(high, ~high) < NEAR_END)
    words = np.stack([high, np.where(fine, low, np.uint32(2**31))], axis=-1)
    return poisson_quantile(mean.ravel(), words.reshape(-1, 2)).reshape(mean.shape)


def softened(charge: np.ndarray, full_well_e: float, knee_e: float) -> np.ndarray:
    """Return what a well holds that fills ever more slowly from the knee on."""
    room = full_well_e - knee_e
    with np.errstate(divide="ignore", over="ignore"):
        above = knee_e - room * np.expm1(-(charge - knee_e) / room)
    return np.where(charge > knee_e, above, charge)


def noise(
    mean: np.ndarray,
    *,
    full_well_e: float,
    temporal_dark_noise_e: float,
    dsnu_e: float,
    seed: int,
    frame: int,
    serial_number: int,
    origin: tuple[int, int] = (0, 0),
    shot: bool = True,
    read_out: bool = True,
    variance_per_e: float | None = None,
    knee_e: float | None = None,
    dsnu_row_e: float = 0.0,
    dsnu_column_e: float = 0.0,
    mask: np.ndarray | float = 0.0,
    reset_noise_e: float = 0.0,
    law: Callable[[np.ndarray], np.ndarray] = np.asarray,
    row_noise_e: float = 0.0,
    column_noise_e: float = 0.0,
) -> np.ndarray:
    """Return the electrons read from a rectangle of pixels (rows, cols); or half of the way.

    Without ``read_out`` it is the charge collected; without ``shot``, `mean` is the charge that is
    read. ``variance_per_e`` puts two numbers in place of Poisson's law and the read noise; ``law``
    is the read noise at a deviate of the normal law.
    """
    row, col = np.indices(mean.shape)
    row, col = row + origin[0], col + origin[1]
    charge = np.asarray(mean, np.float64)
    if shot:
        if variance_per_e is None:
            charge = poisson(mean, row, col, frame, seed)
        else:
            sigma = np.sqrt(temporal_dark_noise_e**2 + variance_per_e * charge)
            charge = charge + sigma * deviate(row, col, frame, SHOT, seed)
        if knee_e is not None:
            charge = softened(charge, full_well_e, knee_e)
        charge = np.minimum(charge, full_well_e)
    if not read_out:
        return charge
    fixed = dsnu_e * deviate(row, col, 0, DSNU, serial_number)
    fixed += dsnu_row_e * row_deviate(row, 0, DSNU_ROW, serial_number)
    fixed += dsnu_column_e * column_deviate(col, 0, DSNU_COLUMN, serial_number)
    temporal = reset_noise_e * deviate(row, col, frame, RESET, seed)
    temporal += row_noise_e * row_deviate(row, frame, ROW_NOISE, seed)
    temporal += column_noise_e * column_deviate(col, frame, COLUMN_NOISE, seed)
    if variance_per_e is None:
        temporal += temporal_dark_noise_e * law(deviate(row, col, frame, READ, seed))
    return charge + fixed + mask + temporal
