"""Encircled energy: the share of the light within a circle about the image's centre of mass.

By Parseval's theorem it is the OTF times the transform of the disc, r J1(2 pi nu r) / nu, summed
over all frequencies: no window cuts the PSF, and no sampling of it makes steps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import fft2, fftfreq, next_fast_len, rfft2
from scipy.special import j0, j1

from gpusim.lens.wavefront import Pupil

# The OTF is averaged over rings so narrow: over a ring the phase 2 pi nu r turns by pi / 16 at most
# for the largest circle, half a period of the sampled image.
_RINGS_PER_NODE = 16
FIRST_ZERO = 3.8317060  # of J1


def encircled_energy(
    pupils: Sequence[Pupil],
    wavelengths_nm: np.ndarray,
    weight: np.ndarray,
    chief_um: np.ndarray,
    radius_um: np.ndarray,
) -> np.ndarray:
    """Return the share of the light within circles about the centre of mass of all of it.

    Parameters
    ----------
    pupils : sequence of Pupil, length L
    wavelengths_nm, weight : ndarray, shape (L,)
        Weight: light of each wavelength.
    chief_um : ndarray, shape (2, L)
        x and y of each wavelength's chief ray.
    radius_um : ndarray, shape (R,)
        Up to ``largest_radius_um``.

    Returns
    -------
    ndarray, shape (R,)
    """
    share = weight / weight.sum()
    centres = chief_um + np.transpose([centroid_um(pupil) for pupil in pupils])
    away = chief_um - (centres @ share)[:, None]
    return sum(
        part * _of_one(pupil, wavelength, shift, radius_um)
        for part, pupil, wavelength, shift in zip(
            share, pupils, wavelengths_nm, away.T, strict=True
        )
    )


def largest_radius_um(pupils: Sequence[Pupil], wavelengths_nm: np.ndarray) -> float:
    """Return half the least period of the sampled images: a larger circle would see the next."""
    return min(
        5e-4 * wavelength / max(np.diff(pupil.alpha[:2])[0], np.diff(pupil.beta[:2])[0])
        for pupil, wavelength in zip(pupils, wavelengths_nm, strict=True)
    )


def centroid_um(pupil: Pupil) -> tuple[float, float]:
    """Return the centre of mass of a pupil's image, x and y from the chief ray: where rays land."""
    slope_x, slope_y = np.gradient(pupil.opd_mm, pupil.alpha, pupil.beta)
    light = pupil.light / pupil.light.sum()
    x = 0.0 if pupil.half else -1e3 * float((light * slope_x).sum())
    return x, -1e3 * float((light * slope_y).sum())


def _of_one(
    pupil: Pupil, wavelength_nm: float, shift_um: np.ndarray, radius_um: np.ndarray
) -> np.ndarray:
    """Return the encircled energy of one wavelength, its chief ray off the circle's middle."""
    wave_um = 1e-3 * wavelength_nm
    field = pupil.amplitude * np.exp(2j * np.pi / wave_um * 1e3 * pupil.opd_mm)
    if pupil.half:
        field = np.concatenate([field[::-1], field])
    size = [next_fast_len(2 * n) for n in field.shape]
    image = np.square(np.abs(fft2(field, size)))
    # The image is real: frequencies to one side of it say all.
    otf = rfft2(image).conj() * (pupil.cell / pupil.light_sr / image.size)
    otf[0, 0] = 1.0  # a cell on the rim passes its share of the light, not that share's square
    step = np.array([np.diff(pupil.alpha[:2])[0], np.diff(pupil.beta[:2])[0]]) / wave_um
    nu_x = fftfreq(size[0], 1 / size[0]) * step[0]
    nu_y = np.arange(otf.shape[1]) * step[1]
    # The image as seen from the circle's middle.
    turn_x, turn_y = (
        np.exp(-2j * np.pi * nu * s) for nu, s in zip((nu_x, nu_y), shift_um, strict=True)
    )
    real = (otf * turn_x[:, None] * turn_y).real
    real[:, 1:] *= 2  # what lies to the other side
    nu = np.hypot(nu_x[:, None], nu_y).ravel()
    ring = np.rint(nu * (_RINGS_PER_NODE / step.min())).astype(int)
    count = np.bincount(ring)
    full = count > 0
    total = np.bincount(ring, real.ravel())[full]
    mean = np.bincount(ring, nu)[full] / count[full]
    kernel = np.pi * radius_um[:, None] ** 2 * np.ones_like(mean)
    off = mean > 0
    turns = 2 * np.pi * mean[off] * radius_um[:, None]
    kernel[:, off] = radius_um[:, None] * j1(turns) / mean[off]
    return kernel @ total * float(step.prod())


def airy_energy(radius_um: np.ndarray, airy_um: np.ndarray | float) -> np.ndarray:
    """Return the encircled energy of an Airy disc: 1 - J0^2 - J1^2 (Born & Wolf, sec. 8.5.2).

    Parameters
    ----------
    radius_um : ndarray
    airy_um : ndarray or float
        Radius of the first dark ring.
    """
    v = FIRST_ZERO * radius_um / airy_um
    return 1 - j0(v) ** 2 - j1(v) ** 2
