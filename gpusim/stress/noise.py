"""Cases of the noise: its laws from the smallest to the largest mean."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import norm, poisson

from gpusim.gpu import Recording, default_device
from gpusim.sensor.noise import record_noise
from gpusim.stress.made import mono
from gpusim.stress.table import LEVEL, Case

LARGEST_E = 1e7  # the largest full well of a sensor file


def noise_of(mean: np.ndarray, full_well_e: float = LARGEST_E) -> np.ndarray:
    """Return the electrons of a frame of means, without read noise and offsets."""
    device = default_device()
    quiet = {"temporal_dark_noise_e": 0.0, "dsnu_e": 0.0, "full_well_e": full_well_e}
    sensor = mono(8, 8).model_copy(update=quiet)
    frame = device.resident("mean", np.asarray(mean, np.float32))
    rec = Recording(device)
    label = rec.download(record_noise(rec, frame, sensor, seed=7))
    try:
        return rec.run()[label].astype(np.float64)
    finally:
        frame.destroy()


def even(mean: float, shape: tuple[int, int]) -> np.ndarray:
    """Return a frame of one mean."""
    return np.full(shape, mean, np.float32)


def off_by(counts: np.ndarray, mean: np.ndarray) -> tuple[float, float]:
    """Return how far mean and variance of rows of counts are off at most, in sigmas.

    A row's counts have one mean m. Their mean has the variance m / n; that of their squared
    distances from m is (m + 2 m^2) / n, from the law's fourth central moment m + 3 m^2.
    """
    n = counts.shape[1]
    first = (counts.mean(axis=1) - mean) / np.sqrt(mean / n)
    second = ((counts - mean[:, None]) ** 2).mean(axis=1) - mean
    second /= np.sqrt((mean + 2 * mean**2) / n)
    return float(np.abs(first).max()), float(np.abs(second).max())


def sigmas(tests: int) -> float:
    """Return what a normal number exceeds in one of some tests with the probability LEVEL."""
    return float(norm.isf(LEVEL / tests / 2))


def poisson_at_a_millionth() -> tuple:
    """Draw Poisson counts of a mean of 1e-6 over four million pixels."""
    total = noise_of(even(1e-6, (2048, 2048))).sum()
    low, high = poisson.interval(1 - LEVEL, 2048**2 * 1e-6)
    return f"{low:g} to {high:g} counts in all", f"{total:g}", low <= total <= high


def poisson_at_ten_million() -> tuple:
    """Draw Poisson counts of a mean of 9e6, close to where f32 has gaps."""
    counts = noise_of(even(9e6, (512, 512)))
    n = counts.size
    mean = (counts.mean() - 9e6) / np.sqrt(9e6 / n)
    spread = (counts.var() / 9e6 - 1) / np.sqrt(2 / n)
    odd = (np.mean(counts % 2) - 0.5) / np.sqrt(0.25 / n)
    got = f"mean {mean:+.1f}, variance {spread:+.1f}, odd counts {odd:+.1f} sigma off"
    return (
        "mean, variance and odd counts within 5 sigma",
        got,
        max(map(abs, (mean, spread, odd))) < 5,
    )


def poisson_over_all_means() -> tuple:
    """Draw counts of means from 1e-3 to 9.9e6, three a decade: their sums and squares."""
    mean = np.float32(np.append(np.logspace(-3, 6, 28), 9.9e6)).astype(np.float64)
    counts = noise_of(np.repeat(mean[:, None], 2**16, axis=1))
    first, _ = off_by(counts, mean)
    # The squares of few counts are far from normal: their sums are judged from 10 counts up.
    enough = mean > 1
    _, second = off_by(counts[enough], mean[enough])
    whole = bool(np.all(counts == np.floor(counts)) and counts.min() >= 0)
    bound = sigmas(2 * mean.size)
    got = f"mean {first:.1f}, variance {second:.1f} sigma off at most"
    got += "" if whole else "; not all are counts"
    expected = f"{mean.size} means and variances within {bound:.1f} sigma, whole, none negative"
    return expected, got, whole and max(first, second) < bound


def no_switch() -> tuple:
    """Let the mean rise from 2 to 50 e-, over where sums give way to the expansion, at 10."""
    mean = np.float32(np.geomspace(2.0, 50.0, 256)).astype(np.float64)
    counts = noise_of(np.repeat(mean[:, None], 2**13, axis=1))
    first, second = off_by(counts, mean)
    # A step between two methods shows in the sums on either side of it.
    split = mean < 10
    sides = [
        (counts[side] - mean[side, None]).sum() / math.sqrt(mean[side].sum() * counts.shape[1])
        for side in (split, ~split)
    ]
    worst = max(first, second, *map(abs, sides))
    bound = sigmas(2 * mean.size + 2)
    return f"mean and variance within {bound:.1f} sigma everywhere", f"{worst:.1f}", worst < bound


def full_well() -> tuple:
    """Take means around a full well of 1e7 e-: what is beyond it is lost, and no more."""
    mean = np.float32([9.99e6, 9.999e6, 1e7, 1.0001e7, 1.2e7, 1e12, 3e38])
    counts = noise_of(np.repeat(mean[:, None], 2**14, axis=1))
    share = poisson.sf(LARGEST_E - 1, np.minimum(mean, 1e8).astype(np.float64))
    found = np.mean(counts == LARGEST_E, axis=1)
    sigma = np.sqrt(np.maximum(share * (1 - share), 1e-12) / counts.shape[1])
    worst = float(np.abs((found - share) / sigma).max())
    bound, most = sigmas(mean.size), counts.max()
    got = f"{worst:.1f} sigma off, most {most:g} e-"
    return (
        f"full as often as the law says, within {bound:.1f} sigma",
        got,
        (worst < bound and most == LARGEST_E),
    )


CASES: tuple[Case, ...] = (
    ("Poisson at a mean of 1e-6", poisson_at_a_millionth, None),
    ("Poisson at a mean of 9e6", poisson_at_ten_million, None),
    ("Poisson at means of 1e-3 to 9.9e6", poisson_over_all_means, None),
    ("Poisson between its two methods", no_switch, None),
    ("full well of 1e7 electrons", full_well, None),
)
