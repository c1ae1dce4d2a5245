"""The dark signal: temporal dark noise and dark current against the exposure time.

EMVA Standard 1288, release 3.1, section 7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.metrics.figure import Figure, line
from gpusim.metrics.statistics import Level

QUANTISATION_DN2 = 1 / 12  # section 2.2: variance of rounding to whole numbers
# Below it the temporal dark noise is lost in the quantisation, and the standard takes this value in
# its place (release 3.1, section 6.6: sigma_y.dark < 0.49 DN).
LEAST_DARK_VARIANCE_DN2 = 0.24
LEAST_TIMES = 6  # of exposure for the dark current (section 7.1)


@dataclass(frozen=True)
class DarkSeries:
    """Dark frames against exposure time.

    Attributes
    ----------
    exposure_s, mean, mean_u2, variance, variance_u2 : ndarray (n,)
        s; DN, DN^2, of all photosites.
    """

    exposure_s: np.ndarray
    mean: np.ndarray
    mean_u2: np.ndarray
    variance: np.ndarray
    variance_u2: np.ndarray


def dark_series(dark: Sequence[Level]) -> DarkSeries:
    """Return mean and temporal variance of all photosites, in the order of the levels."""
    every = range(len(dark[0].sites))
    rows = [[level.exposure_s, *level.mean_and_variance(every)] for level in dark]
    return DarkSeries(*np.array(rows).T)


def dark_lines(series: DarkSeries, notes: list[str]) -> tuple[Figure, Figure | None, Figure | None]:
    """Return the dark variance without dark current, and both slopes against time (section 7.1).

    The lines weigh each time by its uncertainty, since the noise rises with the time.
    """
    times = np.unique(series.exposure_s).size
    if times < 3:
        notes.append(f"exposure times in the dark: {times}; the dark current is not measured")
        first = Figure(float(series.variance[0]), math.sqrt(series.variance_u2[0]))
        return first, None, None
    if times < LEAST_TIMES:
        notes.append(f"exposure times in the dark: {times}; the standard asks for {LEAST_TIMES}")
    _, mean = line(series.exposure_s, series.mean, series.mean_u2)
    start, variance = line(series.exposure_s, series.variance, series.variance_u2)
    return start, mean, variance
