"""Space-variant convolution at the photosites by the definition: every source, every tap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def direct(
    planes: np.ndarray,
    taps: Sequence[np.ndarray],
    *,
    low: int,
    first: tuple[float, float],
    step: tuple[float, float],
    sites: Sequence[tuple[int, int]],
    stride: int,
    reach: int,
) -> np.ndarray:
    """Spread every source sample of a block by the mixture of its four nodes' taps.

    Parameters
    ----------
    planes : ndarray (J, BY, BX)
        Coefficient planes of one source block.
    taps : four ndarrays (J, S, n, n)
        Kernels [plane, site, d_y, d_x] of the nodes (left, upper), (right, upper), (left, lower),
        (right, lower): what a source sample gives to the photosite d samples from it.
    low : int
        The first d.
    first, step : (float, float)
        Position between the nodes (0 left or upper, 1 right or lower) in x and in y: of the
        block's first sample, and per sample.
    sites : sequence of (o_x, o_y)
        Samples of each site's first photosite from the first of the block's window.
    stride : int
        Samples D from a photosite to the next of the same site.
    reach : int
        Samples R by which the window extends beyond the block.

    Returns
    -------
    ndarray (S, rows, cols), float64
        Values of the window's photosites.
    """
    planes = np.asarray(planes, np.float64)
    _, height, width = planes.shape
    rows, cols = ((side + 2 * reach) // stride for side in (height, width))
    result = np.zeros((len(sites), rows, cols))
    s, t = (f + h * np.arange(n) for f, h, n in zip(first, step, (width, height), strict=True))
    shares = [np.outer(v, u) for v in (1 - t, t) for u in (1 - s, s)]
    for kernel, share in zip(np.asarray(taps, np.float64), shares, strict=True):
        for site, (o_x, o_y) in enumerate(sites):
            # Everything that the sources give, where it lies in the window; then the photosites.
            window = np.zeros((height + 2 * reach + 1, width + 2 * reach + 1))
            for (j, line, column), plane in (
                (index, planes[index[0]]) for index in np.ndindex(len(planes), *kernel.shape[2:])
            ):
                y, x = reach + low + line, reach + low + column
                weight = kernel[j, site, line, column]
                window[y : y + height, x : x + width] += weight * share * plane
            at = window[o_y::stride, o_x::stride]
            result[site] += at[:rows, :cols]
    return result
