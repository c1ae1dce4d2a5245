"""Cross-talk: what pixels take from those around them. Stage ``shaders/sensor/crosstalk.wgsl``."""

from __future__ import annotations

import math

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.sensor import Sensor

ROWS = 16  # of an invocation, as in the shader
FOUR = 4  # columns

Rect = tuple[int, int, int, int]  # first row and column, rows and columns


def reach(kernels: Kernels, period: tuple[int, int]) -> int:
    """Return how many pixels around a rectangle its cross-talk needs, as far as the sensor goes.

    At the edge of the sensor the nearest pixels of the same sites stand for those beyond.
    """
    return max(kernels.side // 2, max(period) - 1)


def grown(rect: Rect, reach: int, frame: Rect) -> Rect:
    """Return a rectangle with the pixels around it, within a frame."""
    first = [max(rect[axis] - reach, frame[axis]) for axis in (0, 1)]
    last = [
        min(rect[axis] + rect[axis + 2] + reach, frame[axis] + frame[axis + 2]) for axis in (0, 1)
    ]
    return first[0], first[1], last[0] - first[0], last[1] - first[1]


def share_table(kernels: Kernels, sensor: Sensor, origin: tuple[int, int]) -> np.ndarray:
    """Return the shares (py, quads, K, K, 4), float32, from a pixel on: see the shader."""
    taken = kernels.shares(sensor.cfa.pattern)
    narrow = max(3 - kernels.side, 0) // 2  # a pixel alone, in the smallest kernel of the shader
    taken = np.pad(taken, [(0, 0), (0, 0), (narrow, narrow), (narrow, narrow)])
    py, px = sensor.period
    wide = math.lcm(px, FOUR)
    rows = (np.arange(py) + origin[0]) % py
    cols = (np.arange(wide) + origin[1]) % px
    table = taken[rows[:, None], cols].reshape(py, wide // FOUR, FOUR, *taken.shape[2:])
    return np.ascontiguousarray(np.moveaxis(table, 2, -1), np.float32)


def record_crosstalk(
    rec: Recording,
    signal: Array,
    kernels: Kernels,
    sensor: Sensor,
    *,
    given: Rect,
    wanted: Rect,
    frame: Rect | None = None,
    label: str = "spread",
) -> Array:
    """Record the cross-talk of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    signal : Array (rows, cols), f32
        Electrons/s, or electrons, of the pixels of `given`.
    kernels : Kernels
    sensor : Sensor
        Gives the filter pattern.
    given : (row, col, rows, cols)
        At least `wanted` with its `reach`: see `grown`.
    wanted : (row, col, rows, cols)
        The rectangle.
    frame : (row, col, rows, cols), optional
        All pixels between which there is cross-talk; by default those of the sensor, with its
        optical black.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        In the unit of the signal.

    Raises
    ------
    ValueError
        The signal is not that of `given`, or `given` does not suffice.
    """
    frame = frame or sensor.frame.pixels
    needed = grown(wanted, reach(kernels, sensor.period), frame)
    if signal.shape[-2:] != given[2:] or grown(given, 0, needed) != needed:
        raise ValueError(f"{signal} of {given} does not give the cross-talk of {wanted}")
    table = share_table(kernels, sensor, wanted[:2])
    py, quads, side = table.shape[:3]
    shares = rec.buffer(f"{label} shares", table.shape, np.float32)
    rec.upload(shares, table)
    spread = rec.buffer(label, wanted[2:], np.float32)
    kernel = Kernel("sensor/crosstalk", K=side, PY=py, PX=sensor.period[1], QUADS=quads)
    _, _, rows, cols = wanted
    low = [first - origin for first, origin in zip(frame[:2], wanted[:2], strict=True)]
    params = {
        "rows": rows,
        "cols": cols,
        "from_rows": given[2],
        "from_cols": given[3],
        "from_first": [g - w for g, w in zip(given[:2], wanted[:2], strict=True)],
        "low": low,
        "high": [first + count - 1 for first, count in zip(low, frame[2:], strict=True)],
    }
    across = quads * -(-cols // (2 * FOUR * quads))
    groups = (-(-across // 64), -(-rows // ROWS), 1)
    kernel.record(rec, groups, params, shares=shares, signal=signal, spread=spread)
    return spread
