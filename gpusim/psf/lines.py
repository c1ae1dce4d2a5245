"""What lies between the wavelengths of a bank: everything that is known at its lines goes smoothly.

Glass disperses nearly evenly in 1 / lambda, in which a spline through the lines follows chief rays,
PSFs and what passes. The double Gauss has 0.4 um of lateral colour: between lines 25 nm apart
splines miss 3.5e-4 um of it, and straight lines 7.9e-3 um (tests/psf/test_lines.py).
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

CUBIC, STRAIGHT = 3, 1  # degrees
# Degree for chief rays, which are known to far less than a PSF's width. Largest miss between lines
# 25 nm apart, um: fisheye 0.06 with 3, 0.004 with 5, 0.0004 with 7; wide 0.04, 0.008, 0.0009.
CHIEF_RAYS = 7


def line_shares(
    lines_nm: np.ndarray, degree: float, wavelengths_nm: np.ndarray | float
) -> np.ndarray:
    """Return how much each line counts at wavelengths: the cardinal functions of a spline.

    Splines in 1 / lambda, not-a-knot, of few lines the polynomial through them; beyond the first
    and the last line what is known there.

    Parameters
    ----------
    lines_nm : ndarray (L,)
        Rising.
    degree : float
        `CUBIC`, `CHIEF_RAYS`, or `STRAIGHT`: straight lines in lambda.
    wavelengths_nm : array_like (...)

    Returns
    -------
    ndarray (L, ...)
        Sums 1; of splines some are below 0.
    """
    at = np.clip(wavelengths_nm, lines_nm[0], lines_nm[-1])
    one_by_one = np.eye(len(lines_nm))
    if degree == STRAIGHT:
        return np.stack([np.interp(at, lines_nm, row) for row in one_by_one])
    own = min(int(degree), len(lines_nm) - 1)
    if own == 0:
        return np.ones((1, *np.shape(at)))
    spline = make_interp_spline(1 / lines_nm[::-1], one_by_one[::-1], own)
    return np.moveaxis(spline(1 / at), -1, 0)
