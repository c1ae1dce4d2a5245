"""Float64 twin of the cross-talk stage, and the closed form of how it correlates noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def crosstalk(
    signal: np.ndarray,
    channels: np.ndarray,
    between: Callable[[str, str], np.ndarray],
    period: tuple[int, int],
) -> np.ndarray:
    """Spread the signal of a whole sensor: every pixel gives its neighbours their shares.

    Parameters
    ----------
    signal : ndarray (rows, cols)
    channels : ndarray (rows, cols) of str
        Of each pixel; repeats after `period`.
    between : callable
        Returns the kernel (side, side) from a channel to another.
    period : (int, int)

    Returns
    -------
    ndarray (rows, cols), float64
        Beyond the sensor the pattern goes on with what the nearest pixels of the same sites hold.
    """
    rows, cols = signal.shape
    half = len(between(channels[0, 0], channels[0, 0])) // 2
    nearest = []
    for count, step in zip((rows, cols), period, strict=True):
        line = []
        for at in range(-half, count + half):
            alike = [k for k in range(count) if (k - at) % step == 0]
            line.append(min(alike, key=lambda k: abs(k - at)))
        nearest.append(np.array(line))
    grid = np.ix_(*nearest)
    wide, names = np.asarray(signal, np.float64)[grid], channels[grid]
    total = np.zeros((rows + 2 * half, cols + 2 * half))
    # Each pair of channels is a convolution of the one's pixels, seen by the other's.
    for giver in np.unique(names):
        light = np.where(names == giver, wide, 0.0)
        for taker in np.unique(names):
            kernel = between(giver, taker)
            given = np.zeros(total.shape)
            for i, j in np.ndindex(kernel.shape):
                moved = np.roll(light, (i - half, j - half), (0, 1))
                given += kernel[i, j] * moved
            total += np.where(names == taker, given, 0.0)
    return total[half : rows + half, half : cols + half]


def autocorrelation(kernel: np.ndarray) -> np.ndarray:
    """Return the correlation of a flat field's white noise after one kernel for all pixels.

    R[d] = sum_o k[o] k[o + d], over the variance before (Moore, Ninkov and Forrest 2004, "Quantum
    efficiency overestimation and deterministic cross talk resulting from interpixel capacitance",
    section 3; 2006, Optical Engineering 45).

    Parameters
    ----------
    kernel : ndarray (K, K)

    Returns
    -------
    ndarray (2 K - 1, 2 K - 1)
        By distance in rows and columns from -(K - 1) on.
    """
    size = len(kernel)
    found = np.zeros((2 * size - 1, 2 * size - 1))
    for (i, j), (k, m) in (
        (a, b) for a in np.ndindex(kernel.shape) for b in np.ndindex(kernel.shape)
    ):
        found[k - i + size - 1, m - j + size - 1] += kernel[i, j] * kernel[k, m]
    return found
