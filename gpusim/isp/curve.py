"""The tone curve of a picture. Stage ``shaders/isp/curve.wgsl``."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.line import line

# Straight pieces: a curve of second derivative 4 is off by 4/8/1024^2, 5e-7, between them.
STEPS = 1024


def record_curve(rec: Recording, values: Array, points: Sequence[tuple[float, float]]) -> None:
    """Record a tone curve on stored values, in place.

    A monotone cubic through the points (Fritsch and Butland 1984): it overshoots none of them.

    Parameters
    ----------
    rec : Recording
    values : Array, f32
        1 is white; a multiple of 4 samples.
    points : sequence of (float, float)
        Given and shown value, both 0 to 1; the given ones rise from 0 to 1.
    """
    from scipy.interpolate import PchipInterpolator

    at, shown = np.transpose(points)
    entries = PchipInterpolator(at, shown)(np.linspace(0, 1, STEPS + 1))
    table = rec.buffer(f"{values.label} curve", STEPS + 1, "f4")
    rec.upload(table, entries.astype(np.float32))
    kernel = Kernel("isp/curve", STEPS=STEPS)
    groups, params = line(kernel, math.prod(values.shape))
    kernel.record(rec, groups, params, table=table, values=values)
