"""The colour data of a camera, from its own spectra, in the terms of the DNG specification."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gpusim.scene.colorimetry import D50, adaptation, lab
from gpusim.scene.spectra import (
    QUADRATURE_NM,
    WAVELENGTHS_NM,
    colorchecker,
    white_radiance,
    xyz,
)
from gpusim.sensor.cfa import CFA_LETTERS

CHANNELS = ("R", "G", "B")

# LightSource of Exif 2.3, which DNG's CalibrationIlluminant uses.
LIGHT_SOURCE = {"A": 17, "D65": 21}

# Of the fit in Lab: for the IMX477-like sensor its squares are the least to 1e-9 after 6 turns.
# Steps that would make them more are halved down to a thousandth.
LAB_TURNS, HALVINGS = 12, 10
# From cube roots of white-relative X, Y, Z to L*, a*, b* (CIE 015:2018, 8.2.1).
LAB_OF_ROOTS = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


def response(qe: dict[str, np.ndarray], transmission: np.ndarray | None = None) -> np.ndarray:
    """Return what radiance counts for in each colour channel, to a common factor.

    Electrons are counted from photons: QE(lambda) T(lambda) lambda dlambda (EMVA 1288, linear
    signal model).

    Parameters
    ----------
    qe : dict of str to ndarray (61,)
        Quantum efficiency by filter colour, electrons per photon.
    transmission : ndarray (61,), optional
        Transmission of the lens, to a common factor; 1 if not given.

    Returns
    -------
    ndarray (colours, 61)
        In the order of `CFA_LETTERS`, for radiance per nm on `WAVELENGTHS_NM`.
    """
    curves = np.stack([qe[colour] for colour in sorted(qe, key=CFA_LETTERS.index)])
    return curves * (1.0 if transmission is None else transmission) * WAVELENGTHS_NM * QUADRATURE_NM


def colour_matrix(camera_response: np.ndarray, illuminant: str) -> np.ndarray:
    """Return the matrix from XYZ to the camera's own colours under an illuminant: ColorMatrix.

    Least squares over the 24 ColorChecker patches, with the white kept exactly (Finlayson and Drew
    1997, "Constrained least-squares regression in color spaces").

    Parameters
    ----------
    camera_response : ndarray (colours, 61)
        As `response` returns it.
    illuminant : str
        CIE name of the calibration illuminant.

    Returns
    -------
    ndarray (colours, 3)
        Scaled so that the white, at Y = 1, has 1 as its largest component.
    """
    return _fitted(np.asarray(camera_response, np.float64).tobytes(), illuminant).copy()


@lru_cache(maxsize=32)  # every frame of a camera asks for the same two
def _fitted(camera_response: bytes, illuminant: str) -> np.ndarray:
    seen, counted, white_xyz, white_camera = _patches(camera_response, illuminant)
    # With white at (1, 1, 1) on both sides each row sums to 1: two unknowns are left in each.
    free, *_ = np.linalg.lstsq(seen[:, :2] - seen[:, 2:], counted - seen[:, 2:], rcond=None)
    rows = np.vstack([free, 1.0 - free.sum(axis=0)]).T
    return rows * (white_camera / white_camera.max())[:, None] / white_xyz


def forward_matrix(camera_response: np.ndarray, illuminant: str) -> np.ndarray:
    """Return the matrix from balanced colours to XYZ beside D50: ForwardMatrix.

    Least squares of the 24 ColorChecker patches' CIE 1976 L*, a*, b*, with the white kept exactly:
    the least mean square of the colour difference dE*ab. The Bradford transform takes the patches
    to D50, beside which the matrix's colours are (DNG specification 1.4, chapter 6). It begins at
    the inverse of `colour_matrix`, and goes by Gauss and Newton.

    Parameters
    ----------
    camera_response : ndarray (colours, 61)
        As `response` returns it; three colours or more.
    illuminant : str
        CIE name of the calibration illuminant.

    Returns
    -------
    ndarray (3, colours)
        Colours that are all 1 become D50's white, at Y = 1.
    """
    return _fitted_in_lab(np.asarray(camera_response, np.float64).tobytes(), illuminant).copy()


@lru_cache(maxsize=32)
def _fitted_in_lab(camera_response: bytes, illuminant: str) -> np.ndarray:
    seen, counted, white_xyz, white_camera = _patches(camera_response, illuminant)
    to_d50 = adaptation(white_xyz, D50) * white_xyz / D50[:, None]
    balanced = white_camera / white_camera.max()
    own = _fitted(camera_response, illuminant) * white_xyz / balanced[:, None]
    back = to_d50 @ np.linalg.pinv(own)
    wanted = lab(seen @ to_d50.T, np.ones(3))
    free = counted[:, :-1] - counted[:, -1:]

    def off(matrix: np.ndarray) -> np.ndarray:
        return lab(counted @ matrix.T, np.ones(3)) - wanted

    error = off(back)
    for _ in range(LAB_TURNS):
        slope = _root_slope(counted @ back.T)
        # Of each difference, by each free part of each row.
        by = LAB_OF_ROOTS[None, :, :, None] * slope[:, None, :, None] * free[:, None, None, :]
        step, *_ = np.linalg.lstsq(by.reshape(error.size, -1), -error.ravel(), rcond=None)
        step = step.reshape(3, -1)
        for halving in range(HALVINGS):
            parts = back[:, :-1] + step / 2**halving
            tried = np.column_stack([parts, 1.0 - parts.sum(axis=1)])
            if np.sum(off(tried) ** 2) < np.sum(error**2):
                break
        else:
            break
        back, error = tried, off(tried)
    return D50[:, None] * back


def _root_slope(share: np.ndarray) -> np.ndarray:
    """Return the slope of the cube root of CIE L*a*b*, which is straight below (24/116)^3."""
    above = np.maximum(share, (24 / 116) ** 3)
    return np.where(share < above, 841 / 108, np.cbrt(above) / (3 * above))


def _patches(camera_response: bytes, illuminant: str) -> tuple[np.ndarray, ...]:
    """Return XYZ and counts of the patches, each over the white's; XYZ and counts of the white."""
    response = np.frombuffer(camera_response).reshape(-1, WAVELENGTHS_NM.size)
    white = white_radiance(illuminant, 1.0)
    patches = np.stack(list(colorchecker().values())) * white
    white_xyz, white_camera = xyz(white), response @ white
    return xyz(patches) / white_xyz, patches @ response.T / white_camera, white_xyz, white_camera
