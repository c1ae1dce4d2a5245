"""Float64 twin of the cross-talk stage, and the closed form of how it correlates noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence

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
        Channel of each pixel; repeats after `period`.
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


def crosstalk_at(
    row: np.ndarray,
    col: np.ndarray,
    signal: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    pattern: Sequence[Sequence[str]],
    between: Callable[[str, str], np.ndarray],
    frame: tuple[int, int, int, int],
) -> np.ndarray:
    """Spread the signal to some pixels alone: each takes its shares from those around it.

    out(p) = sum_o k[c(p - o) > c(p)](o) s(p - o), with the kernel k from the giver's channel to the
    taker's: what `crosstalk` makes of the whole sensor.

    Parameters
    ----------
    row, col : ndarray of int
        Rows and columns of the pixels, in shapes that go together.
    signal : callable
        Returns what pixels (row, col) hold.
    pattern : sequence of sequences of str
        Channels of the sites; it begins at pixel (0, 0).
    between : callable
        Returns the kernel (side, side) from a channel to another.
    frame : (row, col, rows, cols)
        All pixels; beyond them the nearest ones of the same sites count.

    Returns
    -------
    ndarray, float64
        In the unit of the signal.
    """
    names = sorted({name for line in pattern for name in line})
    channel = np.array([[names.index(name) for name in line] for line in pattern])
    kernels = np.array([[between(giver, taker) for taker in names] for giver in names])
    side = kernels.shape[-1]

    def nearest(at: np.ndarray, axis: int) -> np.ndarray:
        period, first, count = channel.shape[axis], frame[axis], frame[axis + 2]
        before = -(np.minimum(at - first, 0) // period)
        beyond = -(np.minimum(first + count - 1 - at, 0) // period)
        # A sensor of less than a pattern has no such pixel: then its last one.
        return np.clip(at + (before - beyond) * period, first, first + count - 1)

    def channel_of(at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return channel[at[0] % channel.shape[0], at[1] % channel.shape[1]]

    total = np.zeros(np.broadcast_shapes(np.shape(row), np.shape(col)))
    for i, j in np.ndindex(side, side):
        giver = row - (i - side // 2), col - (j - side // 2)
        share = kernels[channel_of(giver), channel_of((row, col)), i, j]
        total += share * signal(nearest(giver[0], 0), nearest(giver[1], 1))
    return total


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
