"""The colour data of a camera, from its own spectra, in the terms of the DNG specification."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

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
    response = np.frombuffer(camera_response).reshape(-1, WAVELENGTHS_NM.size)
    white = white_radiance(illuminant, 1.0)
    patches = np.stack(list(colorchecker().values())) * white
    white_xyz, white_camera = xyz(white), response @ white
    seen = xyz(patches) / white_xyz
    counted = patches @ response.T / white_camera
    # With white at (1, 1, 1) on both sides each row sums to 1: two unknowns are left in each.
    free, *_ = np.linalg.lstsq(seen[:, :2] - seen[:, 2:], counted - seen[:, 2:], rcond=None)
    rows = np.vstack([free, 1.0 - free.sum(axis=0)]).T
    return rows * (white_camera / white_camera.max())[:, None] / white_xyz
