"""Correction of a lens's shading. Stage ``shaders/isp/shading.wgsl``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Kernel, Recording


@dataclass(frozen=True)
class Shading:
    """The gain that undoes a lens's shading, as DNG's FixVignetteRadial gives it.

    Attributes
    ----------
    k : tuple of 5 float
        Gain 1 + k0 r^2 + ... + k4 r^10, with r relative to the farthest corner of the picture.
    axis : (float, float)
        x, y of the optical axis, 0 to 1 over the picture.
    """

    k: tuple[float, ...]
    axis: tuple[float, float]


def record_shading(
    rec: Recording, light: Array, shading: Shading, frame: tuple[int, int], first: tuple[int, int]
) -> None:
    """Record the gain that undoes the shading, in place.

    Parameters
    ----------
    rec : Recording
    light : Array (rows, cols), f32
        The columns a multiple of 4.
    shading : Shading
    frame : (int, int)
        Rows and columns of the whole picture.
    first : (int, int)
        Row and column of the first pixel in it; may be negative.
    """
    rows, cols = light.shape
    x, y = shading.axis
    height, width = frame
    farthest = np.hypot(max(x, 1 - x) * width, max(y, 1 - y) * height)
    kernel = Kernel("isp/shading")
    params = {
        "rows": rows,
        "fours": cols // 4,
        "axis": (x * width - first[1] - 0.5, y * height - first[0] - 0.5),
        "per_pixel": 1 / farthest,
        **{f"k{n}": value for n, value in enumerate(shading.k)},
    }
    kernel.record(rec, kernel.cover(cols // 4, rows), params, light=light)
