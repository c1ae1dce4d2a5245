"""Exposure and highlight roll-off. Stage ``shaders/isp/roll_off.wgsl``."""

from __future__ import annotations

import math

from gpusim.gpu import Array, Kernel, Recording
from gpusim.isp.line import line


def record_roll_off(rec: Recording, light: Array, ev: float, roll_off: float = 0.0) -> None:
    """Record what shows light brighter or darker, in place.

    Parameters
    ----------
    rec : Recording
    light : Array, f32
        1 is white; a multiple of 4 samples.
    ev : float
        Stops.
    roll_off : float
        Share of the range, 0 to less than 1, into which highlights are bent where they are shown
        brighter; 0 clips them.
    """
    slope, knee = 2.0**ev, 1.0 - roll_off
    bend = 1 / (1 - knee) - 1 / (slope - knee) if roll_off and slope > 1 else 0.0
    kernel = Kernel("isp/roll_off", **({"DARKER": True} if slope < 1 else {}))
    groups, params = line(kernel, math.prod(light.shape))
    kernel.record(rec, groups, params | {"slope": slope, "knee": knee, "bend": bend}, light=light)
