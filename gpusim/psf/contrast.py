"""MTF and illumination over the field, polychromatic, at a few frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.entering import stretch
from gpusim.lens.samples import sample_field
from gpusim.lens.system import System
from gpusim.lens.wavefront import pupils
from gpusim.psf import otf
from gpusim.psf.sampling import REFERENCE_NM


@dataclass(frozen=True)
class FieldContrast:
    """What one field makes of white light.

    Attributes
    ----------
    mtf : ndarray, shape (2, K)
        Along each of ``otf.DIRECTIONS``.
    light_sr : ndarray, shape (L,)
        What an even scene of unit radiance sends through, per area of its image.
    """

    mtf: np.ndarray
    light_sr: np.ndarray


def field_contrast(
    system: System,
    theta: float,
    wavelengths_nm: np.ndarray,
    spectrum: np.ndarray,
    frequency_cy_mm: np.ndarray,
) -> FieldContrast:
    """Trace one field and return its MTF at a few frequencies, and its light.

    Parameters
    ----------
    system : System
    theta : float
        Field angle along y, rad.
    wavelengths_nm, spectrum : ndarray, shape (L,)
        Spectrum: light before the pupil.
    frequency_cy_mm : ndarray, shape (K,)
    """
    index = system.index(wavelengths_nm)
    samples = sample_field(system, index, theta)
    found = pupils(samples, wavelengths_nm, 1.0, otf.COARSE_NODES)
    entered = np.array([pupil.entered for pupil in found])
    weight = spectrum * entered
    shift_um = dict(
        zip(otf.DIRECTIONS, (1e3 * samples.chief_y_mm, 1e3 * samples.chief_x_mm), strict=True)
    )
    here = np.zeros(1)

    def contrast(frequency: float, direction: otf.Direction) -> float:
        otfs = np.array(
            [
                otf.through_focus(pupil, wavelength, frequency, direction, here)
                for pupil, wavelength in zip(found, wavelengths_nm, strict=True)
            ]
        )
        at = np.array([frequency])
        together = otf.polychromatic(otfs, weight, at, shift_um[direction])
        return float(np.abs(together[0]))

    mtf = [[contrast(float(f), way) for f in frequency_cy_mm] for way in otf.DIRECTIONS]
    return FieldContrast(np.array(mtf), entered / stretch(system, REFERENCE_NM, theta).area())
