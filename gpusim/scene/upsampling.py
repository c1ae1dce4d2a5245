"""RGB photographs as scenes: which spectra their colours stand for."""

from __future__ import annotations

import numpy as np

from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import (
    WAVELENGTHS_NM,
    illuminant_known,
    rgb_known,
    rgb_reflectances,
    white_radiance,
)


def lit_rgb(
    name: str, planes: np.ndarray, white_rgb: np.ndarray, scale_cd_m2: float, notes: tuple[str, ...]
) -> Scene:
    """Return a photograph: spectra of Mallett and Yuksel (2019), under D65.

    Parameters
    ----------
    name : str
    planes : ndarray (3, rows, cols), float32
        Linear R, G, B of Rec. 709.
    white_rgb : ndarray (3,)
        What is white in it.
    scale_cd_m2 : float
        Luminance of RGB (1, 1, 1).
    notes : tuple of str
    """

    def light(wavelengths_nm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        daylight = white_radiance("D65", scale_cd_m2, wavelengths_nm)
        spectra = rgb_reflectances(wavelengths_nm) * daylight
        return spectra, white_rgb @ spectra

    spectra, white = light(WAVELENGTHS_NM)
    given = {"light": light, "made_of": (rgb_known(), illuminant_known("D65"))}
    return Scene(name, spectra, Raster(planes), "D65", white, notes, **given)
