"""Kernels at a place of the field, on a sim grid.

All in float64 on the host. Between the bank's fields kernels are interpolated (`gpusim.psf.places`:
in radius and rotated to the azimuth of the place, or over a grid). Between their samples they are
splines.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from gpusim.optics.kernels import FieldKernels

# The splines between the bank's samples: the six quintic B-splines that are not 0 between two of
# them, as polynomials of the place there, 0 to 1; a line for each power, a column for each sample
# from two before to three after (Unser 1999, eq. 5).
# What a spline of degree d adds beyond the bank's band falls as sinc(f)^(d+1) and folds back when
# it is sampled on the sim grid: with cubic splines the sums of the demonstration camera's kernels
# change with the azimuth by 0.3, 0.6 and 1.1e-3 in red, green and blue, with quintic ones by 0.8, 3
# and 6e-5. Nodes do not help against it.
BASIS = (
    np.array(
        [
            (1, 26, 66, 26, 1, 0),
            (-5, -50, 0, 50, 5, 0),
            (10, 20, -60, 20, 10, 0),
            (-10, 20, 0, -20, 10, 0),
            (5, -20, 30, -20, 5, 0),
            (-1, 5, -10, 10, -5, 1),
        ]
    )
    / 120
)


def sampled_kernels(
    kernels: FieldKernels,
    x_um: float,
    y_um: float,
    sim_pitch_um: float,
    half_size: int,
    *,
    planes: int,
) -> np.ndarray:
    """Return the kernels of one field point on a sim grid, of the first planes only.

    They hold all of the light, also where they ring beyond what is sampled: a sharp PSF on a grid
    of 5 um lost 2.4e-3 of it within 66 um. What is cut off is added to what is there.

    Returns
    -------
    ndarray (planes, C, 2 R, 2 R)
        Index [row, column]; the source sample is at [R, R]. The first row and column are zero: to
        the other side there is none as far away.
    """
    channels, n = kernels.splines.shape[2], kernels.splines.shape[-1]
    fields, weights, cos, sin = kernels.places.at(x_um, y_um)
    dx = (np.arange(2 * half_size) - half_size) * sim_pitch_um
    dy = dx[:, None]
    tangential = (cos * dx + sin * dy) / kernels.pitch_um
    sagittal = (cos * dy - sin * dx) / kernels.pitch_um
    inside = np.maximum(np.abs(tangential), np.abs(sagittal)) < n // 2 - 2
    inside[0] = inside[:, 0] = False
    # Those of a sample side by side. Made by Fourier transforms, splines go on periodically.
    splines = np.empty((n + 1, n + 1, planes * channels))
    splines[:n, :n] = sum(
        np.float64(weight) * kernels.splines[field, :planes].transpose(2, 3, 0, 1).reshape(n, n, -1)
        for field, weight in zip(fields, weights, strict=True)
    )
    splines[n], splines[:, n] = splines[0], splines[:, 0]
    at = (part[inside] + n // 2 for part in (sagittal, tangential))
    area = (sim_pitch_um / kernels.pitch_um) ** 2
    found = _spline_weights(*at, n + 1) @ splines.reshape((n + 1) ** 2, -1)
    found *= area
    lacking = splines[:n, :n].sum(axis=(0, 1)) - found.sum(axis=0)
    # Terms of weights that go with the place may be negative, and hold nothing in sum.
    share = np.abs(found)
    found += lacking * share / np.maximum(share.sum(axis=0), np.finfo(float).tiny)
    out = np.zeros((planes * channels, 2 * half_size, 2 * half_size))
    out[:, inside] = found.T
    return out.reshape(planes, channels, *out.shape[1:])


def _spline_weights(y: np.ndarray, x: np.ndarray, n: int) -> csr_array:
    """Return splines' values at points as sums of n x n coefficients: a matrix (points, n * n).

    Made once for all planes and channels: with 9 of them and 88 x 88 points all together takes a
    third of the time of nine calls of `scipy.ndimage.map_coordinates`, which find the weights anew
    each time.
    """
    first = np.zeros(len(y), np.int32)
    along = []
    for place in (y, x):
        before = np.floor(place)
        first = first * np.int32(n) + before.astype(np.int32) - np.int32(2)
        between = place - before
        of_taps = np.empty((len(BASIS), len(place)))
        of_taps[:] = BASIS[-1][:, None]
        for terms in BASIS[-2::-1]:  # Horner's scheme
            of_taps *= between
            of_taps += terms[:, None]
        along.append(of_taps)
    weights = np.einsum("yp,xp->pyx", *along, order="C")
    taps = np.arange(len(BASIS), dtype=np.int32)
    columns = first[:, None] + (taps[:, None] * np.int32(n) + taps).ravel()
    ends = np.arange(0, columns.size + 1, columns.shape[1], dtype=np.int32)
    return csr_array((weights.ravel(), columns.ravel(), ends), shape=(len(y), n * n))


def node_kernels(
    sample: Callable[[int, int], np.ndarray],
) -> np.ndarray:
    """Return the kernels of a node that let interpolation err least in the mean square.

    Straight lines through samples of a curve err to one side, by f'' t (h - t) / 2. Lines through

        f - h^2 f'' / 12

    instead err to both, and 2.4 times less in the root mean square (the least-squares spline of
    degree 1; Unser 1999, section on approximation). f'' h^2 is taken as the second difference
    between the nodes, along x and along y.

    Parameters
    ----------
    sample : callable
        Returns the kernels dx, dy nodes away.
    """
    neighbours = sample(-1, 0) + sample(1, 0) + sample(0, -1) + sample(0, 1)
    return sample(0, 0) * (1 + 4 / 12) - neighbours / 12
