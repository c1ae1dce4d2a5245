"""Demosaicing of any filter array by weighted means. Stage ``shaders/isp/bilinear.wgsl``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Array, Kernel, Recording

AT_ONCE = 4  # colours of one dispatch


def reach_of(pattern: tuple[str, ...]) -> int:
    """Return how far the tent must reach for every colour to be found at every site, pixels."""
    return _reach(pattern, lambda reach: 2 * reach - 1)


def far_of(pattern: tuple[str, ...]) -> int:
    """Return the same for the corner of a frame, where one quadrant of the tent lies within."""
    return _reach(pattern, lambda reach: reach)


def _reach(pattern: tuple[str, ...], side: Callable[[int], int]) -> int:
    """Return the least reach of which each square, of a side by that reach, has all colours."""
    sites = np.array([list(row) for row in pattern])
    wanted = len(np.unique(sites))
    most = max(sites.shape)
    tiled = np.pad(sites, most, mode="wrap")
    for reach in range(1, most + 1):
        windows = np.lib.stride_tricks.sliding_window_view(tiled, (side(reach),) * 2)
        if all(len(np.unique(one)) == wanted for line in windows for one in line):
            return reach
    return most


def record_bilinear(
    rec: Recording,
    light: Array,
    pattern: tuple[str, ...],
    colours: str,
    frame: tuple[int, int, int, int],
    *,
    label: str = "planes",
) -> Array:
    """Record the interpolation of all colours.

    Parameters
    ----------
    rec : Recording
    light : Array (rows, cols), f32
    pattern : tuple of str
        Rows of letters, from the first pixel of `light`.
    colours : str
        The letters.
    frame : (row, col, rows, cols)
        Where in `light` the picture lies; what is outside does not count.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (colours, rows, cols), f32
        Undefined outside the frame.
    """
    rows, cols = light.shape
    planes = rec.buffer(label, (len(colours), rows, cols), "f4")
    sites = np.array([list(row) for row in pattern])
    for begin in range(0, len(colours), AT_ONCE):
        some = colours[begin : begin + AT_ONCE]
        own = np.zeros((*sites.shape, AT_ONCE), np.float32)
        for number, colour in enumerate(some):
            own[sites == colour, number] = 1
        owned = rec.buffer(f"{label} sites {some}", own.shape, "f4")
        rec.upload(owned, own)
        kernel = Kernel(
            "isp/bilinear",
            PY=sites.shape[0],
            PX=sites.shape[1],
            REACH=reach_of(pattern),
            FAR=far_of(pattern),
            COLOURS=len(some),
        )
        params = {
            "rows": rows,
            "cols": cols,
            "first": frame[:2],
            "last": (frame[0] + frame[2], frame[1] + frame[3]),
            "begin": begin,
        }
        kernel.record(rec, kernel.cover(cols, rows), params, light=light, own=owned, planes=planes)
    return planes
