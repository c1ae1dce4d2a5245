"""Cases of the noise: its laws from the smallest to the largest mean."""

from __future__ import annotations

import numpy as np
from scipy.stats import poisson

from gpusim.gpu import Recording, default_device
from gpusim.sensor.noise import record_noise
from gpusim.stress.made import mono
from gpusim.stress.table import LEVEL, Case


def noise_of(mean: float, shape: tuple[int, int]) -> np.ndarray:
    """Return electrons of an even frame, without read noise and offsets."""
    device = default_device()
    sensor = mono(8, 8).model_copy(update={"temporal_dark_noise_e": 0.0, "dsnu_e": 0.0})
    even = device.resident("mean", np.full(shape, mean, np.float32))
    rec = Recording(device)
    label = rec.download(record_noise(rec, even, sensor, seed=7))
    try:
        return rec.run()[label].astype(np.float64)
    finally:
        even.destroy()


def poisson_at_a_millionth() -> tuple:
    """Draw Poisson counts of a mean of 1e-6 over four million pixels."""
    total = noise_of(1e-6, (2048, 2048)).sum()
    low, high = poisson.interval(1 - LEVEL, 2048**2 * 1e-6)
    return f"{low:g} to {high:g} counts in all", f"{total:g}", low <= total <= high


def poisson_at_ten_million() -> tuple:
    """Draw Poisson counts of a mean of 9e6, close to where f32 has gaps."""
    counts = noise_of(9e6, (512, 512))
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


CASES: tuple[Case, ...] = (
    ("Poisson at a mean of 1e-6", poisson_at_a_millionth, None),
    ("Poisson at a mean of 9e6", poisson_at_ten_million, None),
)
