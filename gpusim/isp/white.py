"""Whites and colour matrices of a camera: what a neutral looks like to it, and the way back.

By the DNG specification 1.4, chapter 6, "Mapping Camera Color Space to CIE XYZ Space": a camera has
a matrix from XYZ to its colours for each of one or two lights, and between the two they are mixed
by the reciprocal of the correlated colour temperature.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gpusim.scene.colorimetry import adaptation, rgb_to_xyz

# Correlated colour temperature of the light sources that Exif 2.31 numbers (tag LightSource).
LIGHT_KELVIN = {
    1: 5500.0,  # daylight, fine weather, flash: as D55
    3: 2856.0,  # tungsten, as A
    4: 5500.0,
    9: 5500.0,
    10: 6504.0,  # cloudy, as D65
    11: 7504.0,  # shade, as D75
    17: 2856.0,
    18: 4874.0,
    19: 6774.0,
    20: 5503.0,
    21: 6504.0,
    22: 7504.0,
    23: 5003.0,
    24: 3200.0,
}
D65_KELVIN = 6504.0
TURNS = 30  # of the iteration from neutral to white, which halves its error in each or better
# Least share of the largest channel that a white has: beyond, a picture has no such colour.
LEAST_NEUTRAL = 1e-3

Matrices = Mapping[float, np.ndarray]
"""Matrices (colours, 3) from XYZ to the camera's colours, by the temperature of their light, K."""


def kelvin_of(xyz: np.ndarray) -> float:
    """Return the correlated colour temperature of a white (McCamy 1992), K.

    Within 2 K of Robertson's from 2856 K to 6504 K; from 1500 K to 50 000 K of use.
    """
    x, y = xyz[:2] / np.sum(xyz)
    n = (x - 0.3320) / (0.1858 - y)
    return float(np.clip(((449.0 * n + 3525.0) * n + 6823.3) * n + 5520.33, 1500.0, 50_000.0))


def matrix_at(matrices: Matrices, kelvin: float) -> np.ndarray:
    """Return the matrix for a light: of the two mixed by 1/K, of the nearer one beyond them."""
    warm, cold = min(matrices), max(matrices)
    if warm == cold:
        return matrices[warm]
    share = (1 / np.clip(kelvin, warm, cold) - 1 / cold) / (1 / warm - 1 / cold)
    return share * matrices[warm] + (1 - share) * matrices[cold]


def neutral_of(xyz: np.ndarray, matrices: Matrices) -> np.ndarray:
    """Return what the camera sees of a white: (colours,), the largest 1."""
    seen = np.maximum(matrix_at(matrices, kelvin_of(xyz)) @ xyz, 0)
    return np.maximum(seen / seen.max(), LEAST_NEUTRAL)


def white_of(neutral: np.ndarray, matrices: Matrices) -> np.ndarray:
    """Return XYZ, at Y = 1, of the white that the camera sees as a neutral.

    By turns: the matrix of a white, and the white of a matrix.
    """
    kelvin = D65_KELVIN
    for _ in range(TURNS):
        xyz = np.linalg.pinv(matrix_at(matrices, kelvin)) @ neutral
        kelvin = kelvin_of(xyz)
    return xyz / xyz[1]


def to_picture(
    neutral: np.ndarray,
    matrices: Matrices,
    chromaticities: tuple[float, ...],
    forward: Matrices | None = None,
) -> np.ndarray:
    """Return the matrix (3, colours) from balanced colours to linear RGB of a space.

    The white that the camera sees as the neutral becomes the white of the space, by the Bradford
    transform; equal balanced colours become equal RGB.

    Parameters
    ----------
    neutral : ndarray (colours,)
        Values by which the colours were divided.
    matrices : mapping of float to ndarray (colours, 3)
    chromaticities : tuple of 8 float
        As `rgb_to_xyz` takes them.
    forward : mapping of float to ndarray (3, colours), optional
        Matrices from balanced colours to XYZ beside D50, by the temperature of their light, K, in
        place of the others' inverse.
    """
    space = rgb_to_xyz(chromaticities)
    white = white_of(neutral, matrices)
    if forward is None:
        back = np.linalg.pinv(matrix_at(matrices, kelvin_of(white))) * neutral
    else:
        back = matrix_at(forward, kelvin_of(white))
        white = back.sum(axis=1)
    rgb = np.linalg.solve(space, adaptation(white, space.sum(axis=1)) @ back)
    return rgb / rgb.sum(axis=1, keepdims=True)
