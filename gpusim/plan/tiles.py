"""How a frame is cut into tiles and strips, so that what is worked on at once fits the memory."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gpusim.gpu.pool import MAX_BINDING_BYTES, size_class

Rect = tuple[int, int, int, int]  # first row and column, rows and columns

# Shares of the budget. Kernels take what is left: a pixel of a tile takes 4 bytes, but the kernels
# around a block of 88 x 88 pixels some megabytes, and the more of them are at hand the better.
TILE_SHARE = 8  # an eighth for the planes of a tile
STRIP_SHARE = 16  # a sixteenth for a strip on its way through the sensor
# Rate, framed, mean, electrons, numbers, up to four of them on their way out; and what cross-talk
# makes of the rate and of the charge.
STRIP_PLANES = 12
RESERVE_BYTES = 1 << 20  # for the parameters and the clocks of one line of blocks
SMALLEST_PX = 64  # side of the smallest tile: below it only the kernels count
WIDE_PX = 1024  # height from which tiles are as wide as the frame


def aligned(rect: Rect, period: int) -> Rect:
    """Return a rectangle, grown to whole periods of the filter pattern."""
    row, col, rows, cols = rect
    row0, col0 = row // period * period, col // period * period
    row1, col1 = (-(-end // period) * period for end in (row + rows, col + cols))
    return row0, col0, row1 - row0, col1 - col0


def enclosing(rects: Sequence[Rect]) -> Rect:
    """Return the smallest rectangle that holds others."""
    row, col = (min(rect[axis] for rect in rects) for axis in (0, 1))
    below, right = (max(rect[axis] + rect[axis + 2] for rect in rects) for axis in (0, 1))
    return row, col, below - row, right - col


def tile_bytes(rect: Rect, period: int, layers: int = 1) -> int:
    """Return the device memory that the planes of a tile take, `layers` of each pixel."""
    _, _, rows, cols = aligned(rect, period)
    return size_class(4 * layers * rows * cols)


def strip_bytes(rect: Rect, budget: int, around: int = 0) -> int:
    """Return the device memory that a strip of a tile takes, with some rows above and below it."""
    _, _, rows, cols = rect
    height = min(rows, _strip_rows(cols, budget) + 2 * around)
    return STRIP_PLANES * size_class(4 * cols * height)


def tiles_of(
    rect: Rect, period: int, budget: int, side: int | None = None, layers: int = 1
) -> list[Rect]:
    """Cut a rectangle into tiles, row by row.

    Parameters
    ----------
    rect : (row, col, rows, cols)
    period : int
        Period of the filter pattern: tiles meet between whole patterns.
    budget : int
        Device memory, bytes.
    side : int, optional
        Largest side of a tile, at least one period; without it, the memory decides.
    layers : int
        Planes of each pixel.
    """
    row, col, rows, cols = rect
    if side is not None:
        height = width = side // period * period
    else:
        pixels = min(MAX_BINDING_BYTES, budget // TILE_SHARE) // (4 * layers)
        height, width = pixels // (cols + 2 * period), cols
        if height < min(WIDE_PX, rows):
            height = width = max(math.isqrt(pixels), SMALLEST_PX)
        height, width = (
            -(-count // -(-count // side) // period) * period  # of about equal size
            for count, side in ((rows, height), (cols, width))
        )
    return [
        (top, left, bottom - top, right - left)
        for top, bottom in _cuts(row, rows, height, period)
        for left, right in _cuts(col, cols, width, period)
    ]


def halves(rect: Rect, period: int) -> list[Rect]:
    """Return a tile in two halves, cut across its longer side; none of the smallest tile."""
    row, col, rows, cols = rect
    if max(rows, cols) <= SMALLEST_PX:
        return []
    if rows >= cols:
        first = -(-(row + rows // 2) // period) * period - row
        return [(row, col, first, cols), (row + first, col, rows - first, cols)]
    first = -(-(col + cols // 2) // period) * period - col
    return [(row, col, rows, first), (row, col + first, rows, cols - first)]


def strips(rect: Rect, budget: int) -> list[Rect]:
    """Cut a tile into strips of rows."""
    row, col, rows, cols = rect
    height = _strip_rows(cols, budget)
    return [
        (first, col, min(height, row + rows - first), cols)
        for first in range(row, row + rows, height)
    ]


def _strip_rows(cols: int, budget: int) -> int:
    return max(budget // STRIP_SHARE // (STRIP_PLANES * 4 * cols), 1)


def _cuts(first: int, count: int, step: int, period: int) -> list[tuple[int, int]]:
    """Cut `count` numbers from `first` on, at multiples of the period, into steps."""
    start = first // period * period
    ends = [*range(start + step, first + count, step), first + count]
    return list(zip([first, *ends[:-1]], ends, strict=True))
