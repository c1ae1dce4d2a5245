"""RGB spaces and chromatic adaptation: the few matrices that scene and ISP share."""

from __future__ import annotations

import numpy as np

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of Rec.709 red, green, blue and its D65 white (ITU-R BT.709)."""

LARGEST_XY = 10.0  # of a chromaticity; those of ACES AP0, the widest in use, lie within 1
# Primaries on a line make no colours. The condition of their matrix is 3.3 for Rec.709, 1.6 for
# ACES AP0, 1 for XYZ itself.
MOST_CONDITION = 1e4

D50 = np.array([0.9642, 1.0, 0.8249])
"""XYZ of the white of ICC's profile connection space, which DNG's too is beside (ICC.1, 7.2.16)."""

# Cone-like responses of the Bradford transform (Lam 1985; ICC.1, annex E).
BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def rgb_to_xyz(chromaticities: tuple[float, ...]) -> np.ndarray:
    """Return the matrix (3, 3) from linear RGB to XYZ, with Y = 1 at RGB = (1, 1, 1).

    Parameters
    ----------
    chromaticities : tuple of 8 float
        x, y of red, green, blue and white, in this order (as in the OpenEXR attribute of that
        name). A primary may have y = 0, as X and Z of the XYZ space itself.

    Raises
    ------
    ValueError
        Numbers that are none, primaries on a line, or a white that is not between them.
    """
    xy = np.reshape(np.asarray(chromaticities, np.float64), (4, 2))
    if not (np.abs(xy) < LARGEST_XY).all():
        raise ValueError(f"a number that is none, or beyond {LARGEST_XY:g}")
    columns = np.stack([xy[:, 0], xy[:, 1], 1 - xy.sum(axis=1)])
    primaries, white = columns[:, :3], columns[:, 3]
    if np.linalg.cond(primaries) > MOST_CONDITION:
        raise ValueError("the primaries lie on a line")
    if not white[1] > 0:
        raise ValueError("the white has no luminance")
    shares = np.linalg.solve(primaries, white / white[1])
    if not (shares > 0).all():
        raise ValueError("the white does not lie between the primaries")
    return primaries * shares


def adaptation(source_xyz: np.ndarray, target_xyz: np.ndarray) -> np.ndarray:
    """Return the Bradford matrix (3, 3) that takes XYZ seen under one white to another's.

    Parameters
    ----------
    source_xyz, target_xyz : ndarray (3,)
        The two whites, at equal Y.
    """
    gain = (BRADFORD @ target_xyz) / (BRADFORD @ source_xyz)
    return np.linalg.solve(BRADFORD, gain[:, None] * BRADFORD)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB values 0..1 of linear Rec.709 values, clipped to 0..1 (IEC 61966-2-1)."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def lab(xyz: np.ndarray, white_xyz: np.ndarray) -> np.ndarray:
    """Return CIE 1976 L*, a*, b* (..., 3) of XYZ (..., 3) beside a white (CIE 015:2018, 8.2.1)."""
    share = np.asarray(xyz, np.float64) / white_xyz
    low = share * (841 / 108) + 4 / 29
    root = np.where(share > (24 / 116) ** 3, np.cbrt(share), low)
    x, y, z = np.moveaxis(root, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)
