"""How many lines a bank needs where points of light stand alone: as many as tell their fringes.

Around a lone point a pixel has its light from one place of the PSF, and that of one wavelength has
rings there: their period is lambda over the pupil's angular width 2 sin(theta'), so that at a
distance r the phase runs over 2 sin(theta') r (1 / lambda_1 - 1 / lambda_2) cycles in a band of
light, in proportion to 1 / lambda. In the lens's light of all wavelengths they average out. Lines
are evenly spaced in 1 / lambda: where they are as many as the cycles, all of them meet the same
phase, and the rings stay.

Measured before the demonstration camera (double Gauss at f/2.8, up to 1.3 mm from the axis, 23 to
54 um from a point, RMS
against PSFs traced between 34 lines): 12 lines 3.9e-2 of the light, 34 lines 2.4e-3.
"""

from __future__ import annotations

import math

import numpy as np

from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene

# Points count where in the mean over the picture they bring as much light as the median sample
# has: the chart of points brings 4500 times as much, the lamps of a still life that stand alone
# 0.05 times, those of a desk 0.004 times. Lamps of some samples average their rings themselves.
LONE = 1.0
# Lines over cycles. Lines make of a fringe of f cycles in the band one of their number less f, that
# a channel's light averages out where it is of several cycles. Airy's rings from 32 to 64 um at
# f/2.8, light of an IMX477's channels: RMS of 1.2e-2 with 1.3, 1.7e-3 with 1.8 (44 intervals).
MARGIN = 1.6
MOST_STEPS = 8  # as often as lines are doubled at most: 89 of them from 400 to 700 nm


def lone_points(scene: Scene) -> bool:
    """Return whether points of light that stand alone bring more light than what surrounds them."""
    return not isinstance(scene.source, Chart) and scene.source.split.lone > LONE


def cycles(reach_um: float, solid_angle_sr: float, first_nm: float, last_nm: float) -> float:
    """Return the fringes of a PSF at a distance from its middle that a band runs through.

    Parameters
    ----------
    reach_um : float
    solid_angle_sr : float
        Projected solid angle of the light, pi sin(theta')^2.
    first_nm, last_nm : float
        Ends of the band.
    """
    width = 2 * math.sqrt(solid_angle_sr / math.pi)
    return width * reach_um * 1e3 * (1 / first_nm - 1 / last_nm)


def steps_for_fringes(
    lines_nm: np.ndarray, reach_um: float, solid_angle_sr: float, most: int = MOST_STEPS
) -> int:
    """Return into how many parts intervals between lines are to be cut, to tell fringes apart.

    Parameters
    ----------
    lines_nm : ndarray (L,)
        Lines that are cut no further.
    reach_um, solid_angle_sr : float
        How far PSFs reach; see `cycles`.
    most : int
    """
    seen = cycles(reach_um, solid_angle_sr, *lines_nm[[0, -1]].tolist())
    return min(max(math.ceil(MARGIN * seen / (len(lines_nm) - 1)), 1), most)
