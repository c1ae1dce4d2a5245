"""Demosaicing of any filter array by its most frequent colour.

Stages ``bilinear``, ``guide`` and ``regain`` of ``shaders/isp``.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.bilinear import record_bilinear

REACH = 3  # of the guide's means, pixels


def guide_of(pattern: tuple[str, ...]) -> str:
    """Return the most frequent colour of a filter pattern; of equals white, green or the first."""
    sites = "".join(pattern)
    return max("WG" + sites, key=sites.count)


def near_of(pattern: tuple[str, ...]) -> np.ndarray:
    """Return the sites of each one's colour around it: (rows, cols, most, 4), int32.

    Each has rows and columns away and the weight by a tent; what is missing to the most is zeros.
    The guide's own sites have none: there is nothing to find there.
    """
    sites, own = np.array([list(line) for line in pattern]), guide_of(pattern)
    rows, cols = sites.shape
    steps = [step for step in product(range(1 - REACH, REACH), repeat=2) if step != (0, 0)]
    found = {
        (row, col): [
            (y, x, (REACH - abs(y)) * (REACH - abs(x)), 0)
            for y, x in steps
            if sites[(row + y) % rows, (col + x) % cols] == sites[row, col] != own
        ]
        for row, col in np.ndindex(rows, cols)
    }
    near = np.zeros((rows, cols, max(1, *map(len, found.values())), 4), np.int32)
    for place, ones in found.items():
        near[place][: len(ones)] = ones or 0
    return near


def record_guided(
    rec: Recording,
    light: Array,
    pattern: tuple[str, ...],
    colours: str,
    frame: tuple[int, int, int, int],
    *,
    label: str = "planes",
) -> Array:
    """Record the interpolation of all colours: as `record_bilinear`, of their differences.

    The most frequent colour is found at all pixels, with the fine detail of the others; these are
    interpolated as what they differ from it by, which has little of that.
    """
    means = record_bilinear(rec, light, pattern, guide_of(pattern), frame, label=f"{label} means")
    guide = rec.buffer(f"{label} guide", light.shape, "f4")
    differences = rec.buffer(f"{label} differences", light.shape, "f4")
    around = near_of(pattern)
    near = rec.buffer(f"{label} near", around.shape, "i4")
    rec.upload(near, around)
    rows, cols = light.shape
    size = {"rows": rows, "cols": cols}
    rect = {"first": frame[:2], "last": (frame[0] + frame[2], frame[1] + frame[3])}
    kernel = Kernel("isp/guide", PY=around.shape[0], PX=around.shape[1], COUNT=around.shape[2])
    buffers = {"light": light, "means": means, "near": near}
    out = {"guide": guide, "differences": differences}
    kernel.record(rec, kernel.cover(cols, rows), size | rect, **buffers, **out)
    planes = record_bilinear(rec, differences, pattern, colours, frame, label=label)
    kernel = Kernel("isp/regain")
    params = size | {"colours": len(colours)}
    kernel.record(rec, kernel.cover(cols, rows), params, guide=guide, planes=planes)
    return planes
