"""Bright outliers of a photograph: the sun, lamps, glints, held apart from its samples.

A cubic spline through a sample 1e9 times as bright as its neighbours swings below zero around it, a
spline with non-negative coefficients makes it wider than it is, and in transforms of float32 its
rounding errors drown the shadows. So the excess of such samples is no part of the spline: each is a
square of even radiance, as large as the sample's cell, added to what is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Samples brighter than so many times the median of those that are lit are outliers. The block-wise
# path plans its error for edges: around one bright sample it errs by 2e-2 of the tolerance times
# that sample (double Gauss at f/2.8, five pixels away: 2e-5 of it at a tolerance of 1e-3), and by
# its rounding, 4e-9 of it, as far as a block reaches. At 500 these are 10 tolerances of the
# surroundings, what a certificate allows its worst probe, and 2e-6.
OUTLIER = 500.0
# Each outlier takes the time of some 6000 pixels' sums. A lit room may have thousands: where there
# are more than FEW, the brightest are taken, and at 1e5 times the median, where even the rounding
# counts, as many as MOST.
FEW = 1024
DAZZLING = 1e5
MOST = 65536
SIDE_BY_SIDE = 1.5  # samples: as far are those that share a side or a corner


@dataclass(frozen=True, eq=False)
class Highlights:
    """Squares of even radiance on the ideal image plane, sides along x and y.

    Attributes
    ----------
    centre_um : ndarray (N, 2)
        x, y; origin on the axis.
    size_um : float
        Side of all of them.
    excess : ndarray (N, M)
        Coefficients of the scene's spectra, none negative, to be added to the raster's.
    """

    centre_um: np.ndarray
    size_um: float
    excess: np.ndarray

    def __len__(self) -> int:
        return len(self.centre_um)

    @cached_property
    def alone(self) -> bool:
        """Whether most of their light is of those that have none next to them."""
        light = self.excess.max(axis=1, initial=0.0)
        return bool(light[_lone(self.centre_um / self.size_um)].sum() > light.sum() / 2)


@dataclass(frozen=True, eq=False)
class Split:
    """Coefficient planes without their outliers, and these.

    Attributes
    ----------
    planes : ndarray (M, rows, cols), float32
    rows, cols : ndarray (N,) of int
        Samples that were outliers; they hold what their nearest neighbours hold.
    excess : ndarray (N, M)
        What was taken from them.
    limit : float
        Coefficient above which a sample was taken.
    """

    planes: np.ndarray
    rows: np.ndarray
    cols: np.ndarray
    excess: np.ndarray
    limit: float

    @cached_property
    def lone(self) -> float:
        """Mean light of outliers that have none next to them, over the median of the rest."""
        if len(self.rows) == 0:
            return 0.0
        lone = _lone(np.stack([self.rows, self.cols], axis=1))
        light = self.excess.max(axis=1)[lone].sum()
        rest = self.planes.max(axis=0)
        return float(light / rest.size / np.median(rest[rest > 0]))


def _lone(at: np.ndarray) -> np.ndarray:
    """Return which of samples (N, 2) have no other of them next to them."""
    from scipy.spatial import KDTree

    if len(at) < 2:
        return np.ones(len(at), bool)
    return KDTree(at).query(at, k=2)[0][:, 1] > SIDE_BY_SIDE


def split_outliers(planes: np.ndarray) -> Split:
    """Take the outliers from coefficient planes (M, rows, cols), none negative.

    A sample counts by its largest coefficient, and is measured by the median of the lit samples.
    """
    from scipy.ndimage import binary_dilation
    from scipy.spatial import KDTree

    brightness = planes.max(axis=0)
    lit = brightness[brightness > 0]
    median = float(np.median(lit)) if lit.size else 0.0
    limit = OUTLIER * median
    bright = np.sort(lit[lit > limit])
    if len(bright) > FEW:
        limit = float(min(bright[-FEW - 1], DAZZLING * median))
    if np.count_nonzero(bright > limit) > MOST:
        limit = float(bright[-MOST - 1])
    outliers = brightness > limit
    rows, cols = np.nonzero(outliers)
    if not len(rows):
        return Split(planes, rows, cols, np.zeros((0, len(planes))), limit)
    # The nearest sample that is none lies next to one that is.
    around = np.argwhere(binary_dilation(outliers, np.ones((3, 3), bool)) & ~outliers)
    _, nearest = KDTree(around).query(np.stack([rows, cols], axis=1))
    fill = planes[:, *around[nearest].T]
    rest = planes.copy()
    rest[:, rows, cols] = np.minimum(fill, planes[:, rows, cols])
    excess = planes[:, rows, cols].astype(np.float64) - rest[:, rows, cols]
    return Split(rest, rows, cols, excess.T, limit)
