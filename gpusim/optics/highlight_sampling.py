"""Where the kernels of highlights are sampled: finely around the chief ray, coarsely far from it.

Near its chief ray a kernel has the edges of the pixel's aperture and of the square, as sharp as the
PSF. Far from it these average over the fine structure that the PSF has there, and a few samples
tell the rest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import correlate1d, spline_filter1d

from gpusim.optics.highlight_tables import Tables
from gpusim.psf.halo import fall
from gpusim.psf.places import FieldPsfs

STEPS = (2, 3, 4, 6, 8)  # of far samples, that are tried
# Every so many samples of the bank are tried, both ways: prime to all steps, for all places between
# far samples.
STRIDE = 5
RING = 8  # samples across a ring in which it is found out what far samples err
LEAST = 0.01  # of a PSF's light: what the window holds where its weight is near to 0
ROUNDING = 1e-12  # of the brightest: what transforms leave where there is no light
BORDER = 3  # samples around what counts: a cubic's taps reach two, and a step of the bank's more


class Sampling(NamedTuple):
    """Samples of a kernel.

    Attributes
    ----------
    near, far : int
        Samples along a side, even; the chief ray is at half of them. 0: none.
    step : int
        Samples of the bank from one far sample to the next.
    radius : float
        Distance from the chief ray up to which near samples are taken, samples of the bank.
    """

    near: int
    far: int
    step: int
    radius: float

    @property
    def samples(self) -> int:
        """Samples in all."""
        return self.near**2 + self.far**2

    def of(self, table: np.ndarray) -> np.ndarray:
        """Return the spline coefficients (..., samples) of a table (..., side, side).

        Near ones first, row by row. Far ones are of the cubic spline through the table's values.
        """
        return np.concatenate(
            [
                one.reshape(*table.shape[:-2], -1)
                for one in (_every(table, self.near, 1), self.far_of(table))
            ],
            axis=-1,
        )

    def far_of(self, table: np.ndarray) -> np.ndarray:
        """Return the far samples' coefficients (..., far, far)."""
        values = table
        for axis in (-2, -1):
            values = correlate1d(values, (1 / 6, 4 / 6, 1 / 6), axis, mode="constant")
        found = _every(values, self.far, self.step)
        if self.far:
            for axis in (-2, -1):
                found = spline_filter1d(found, 3, axis)
        return np.maximum(found, 0.0)


def _every(table: np.ndarray, count: int, step: int) -> np.ndarray:
    """Return every so many of a table's samples (..., count, count); zeros beyond it."""
    side = table.shape[-1]
    at = side // 2 + step * np.arange(-(count // 2), count // 2)
    inside = np.flatnonzero((at >= 0) & (at < side))
    found = np.zeros((*table.shape[:-2], count, count))
    found[..., inside[:, None], inside] = table[..., at[inside][:, None], at[inside]]
    return found


def sampling(
    kernels: Tables, fields: Sequence[FieldPsfs], allowed: float, *, alone: bool = False
) -> Sampling:
    """Return the fewest samples of which far ones err by at most a share of the light around them.

    Root mean square over rings about the middle of a lamp of three by three squares, the largest
    ones, at the worst of some fields and channels, for light of all spectra together. A square
    alone has the PSF's rings, which far samples miss; beside each other squares have no such rings.
    ``alone``: the lamp is one square, as points of light are.
    """
    side, square = kernels.side, kernels.largest_um * np.eye(2)
    of_all = kernels.weights.sum(axis=1, keepdims=True)
    tables = np.concatenate(
        [kernels.table(field, kernels.spectra(field), of_all, 0.0, square) for field in fields]
    ).reshape(-1, side, side)
    at = np.arange(0, side, STRIDE) - side // 2
    radius = np.hypot(at, at[:, None])
    number = (radius / RING).astype(int).ravel()

    def means(values: np.ndarray) -> np.ndarray:
        sums = np.stack([np.bincount(number, one) for one in values.reshape(-1, number.size)])
        return sums / np.maximum(np.bincount(number), 1)

    apart = 0.0 if alone else kernels.largest_um / kernels.pitch_um
    exact = _spread(tables, at, 1, apart)
    # What the window lets out, other levels of the bank take over. Beyond it there is as much as
    # within its last ring.
    window = kernels.fine * kernels.bank.psf.shape[-1] / 2
    light = exact / np.maximum(fall(radius, window), LEAST)
    last = means(light)[:, : int(window / RING)][:, -1]  # a window may be wider than a table
    light = np.where(radius < window, light, last[:, None, None])
    # Tables without light err by nothing.
    light = np.maximum(light, max(ROUNDING * exact.max(), np.finfo(float).tiny))
    found = [Sampling(side, 0, 1, float(side))]
    for step in STEPS:
        far = 2 * (math.ceil(kernels.support / step) + BORDER)
        one = Sampling(0, far, step, 0.0)
        error = (_spread(one.far_of(tables), at, step, apart) - exact) / light
        wrong = np.flatnonzero((means(error**2) > allowed**2).any(axis=0))
        near = RING * (int(wrong[-1]) + 1) if len(wrong) else 0
        found.append(one._replace(near=2 * (near + BORDER), radius=float(near)))
    return min(found, key=lambda one: one.samples)


def _spread(coefficients: np.ndarray, at: np.ndarray, step: int, apart: float) -> np.ndarray:
    """Return splines (..., P, P) at samples of the bank (P,) from the middle of a lamp.

    It is of three by three squares, so many samples apart: the mean of their light.
    """
    count = coefficients.shape[-1]
    places = at[:, None] + apart * np.arange(-1, 2)
    off = np.abs(places[..., None] / step + count // 2 - np.arange(count))
    near, far = (4 - 6 * off**2 + 3 * off**3) / 6, np.maximum(2 - off, 0.0) ** 3 / 6
    weights = np.where(off < 1, near, far).mean(axis=1)
    return weights @ coefficients @ weights.T
