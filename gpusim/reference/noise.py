"""Float64 twin of the noise stage: its laws, and its numbers from the same random words."""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln, ndtri, pdtrc, xlogy

from gpusim.reference.philox import DSNU, READ, SHOT, pixel_words, shared_word

INVERSION_BELOW = 10.0
DRAWS = 16


def normal(word: np.ndarray) -> np.ndarray:
    """Return the standard normal deviate of each 32-bit word, the middle of its cell."""
    return ndtri((np.asarray(word, np.float64) + 0.5) / 2**32)


def poisson_log_probability(count: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Return log P(X = count) of the Poisson law."""
    return xlogy(count, mean) - mean - gammaln(count + 1)


def poisson_quantile(mean: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Return the count that P(X > k) <= V < P(X >= k) gives for V = (words + 1/2) / 2^64.

    Parameters
    ----------
    mean : ndarray (...)
        Below :data:`INVERSION_BELOW`.
    words : ndarray (..., 2), uint32
        High word first.
    """
    high, low = np.moveaxis(np.asarray(words, np.float64), -1, 0)
    upper = (high + (low + 0.5) / 2**32) / 2**32
    return np.sum([upper < pdtrc(k, mean) for k in range(64)], axis=0)


def poisson_trial(mean: np.ndarray, word: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return proposal and acceptance probability of the transformed rejection method.

    Hoermann 1993, "The transformed rejection method for generating Poisson random variables",
    algorithm PTRS without its squeezes; 1/alpha raised from 1.1239 to 1.1315, so that the ratio
    never exceeds 1 and the law is exact.
    """
    u = (np.asarray(word, np.float64) + 0.5) / 2**32 - 0.5
    b = 0.931 + 2.53 * np.sqrt(mean)
    a = -0.059 + 0.02483 * b
    inverse_alpha = 1.1315 + 1.1328 / (b - 3.4)
    us = 0.5 - np.abs(u)
    count = np.floor((2 * a / us + b) * u + mean + 0.43)
    probability = np.exp(poisson_log_probability(np.maximum(count, 0), mean))
    ratio = np.where(count < 0, 0.0, probability * (a / us**2 + b) / inverse_alpha)
    return count, ratio


def poisson(
    mean: np.ndarray, row: np.ndarray, col: np.ndarray, frame: int, seed: int, first_draw: int = 0
) -> np.ndarray:
    """Return the Poisson count of each pixel, from the same words as the stage."""
    mean = np.asarray(mean, np.float64)
    count = np.floor(mean)
    pending = np.ones(mean.shape, bool)
    for draw in range(first_draw, DRAWS):
        words = pixel_words(row, col, frame, SHOT, draw, seed)
        small = pending & (mean < INVERSION_BELOW)
        count[small] = poisson_quantile(mean[small], words[small][:, :2])
        pending &= ~small
        for trial in (words[..., :2], words[..., 2:]):
            proposal, ratio = poisson_trial(mean, trial[..., 0])
            taken = pending & ((trial[..., 1] + 0.5) / 2**32 <= ratio)
            count[taken] = proposal[taken]
            pending &= ~taken
    return count


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
) -> np.ndarray:
    """Return the electrons read from a rectangle of pixels (rows, cols); or half of the way.

    Without ``read_out`` it is the charge collected; without ``shot``, `mean` is the charge that is
    read.
    """
    row, col = np.indices(mean.shape)
    row, col = row + origin[0], col + origin[1]
    charge = np.minimum(poisson(mean, row, col, frame, seed), full_well_e) if shot else mean
    if not read_out:
        return charge
    offset = dsnu_e * normal(shared_word(row, col, 0, DSNU, serial_number))
    read = temporal_dark_noise_e * normal(shared_word(row, col, frame, READ, seed))
    return charge + offset + read
