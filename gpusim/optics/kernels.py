"""Channel kernels at the PSF nodes: what one sample of one plane gives to each photosite around it.

A kernel is an image of the PSFs at a field (`gpusim.optics.images`), or its core or tail, with the
band of a sim grid. It is held as splines, of which `gpusim.optics.sampling` makes that at any
place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.fft

from gpusim.optics.images import PAD, mirrored
from gpusim.psf.places import Places

# Samples of the splines in one sample of the sim grid, where the bank has more. In the tails of the
# demonstration camera (6.2), taking every second one errs by 5e-5 of the tail's sum, every fourth
# by 2.5e-4.
SAMPLES_WITHIN = 3.0
# The kernels' band ends at the sim grid's Nyquist frequency, with a raised-cosine edge below it.
BAND_EDGE = 0.85
# PSFs that are sharp on that grid would ring with such an edge, far beyond where they are held:
# next to a bright edge by 5e-4 of its light. The band of what is held falls from 0 on, and its
# spectra make up for that (`sharpening`): by 44 at most, and most where the pixel's aperture passes
# little. That leaves 5e-6. A desk before the AR/VR camera, with 2 samples a pixel, had been off by
# up to 7 % in the dark next to its window, and by 2e-3 in all; it is off by 5e-4 now.
SOFT_EDGE = 0.0
# Sim samples as far as which kernels are held: those of PSFs narrower than a sample ring. What
# rings farther is folded back, for transforms are periodic: their spectra are right at the
# frequencies of the period, and so are their sums.
RINGING = 24
# Transfer at the middle of the band's edge from which on a part rings.
RINGS_FROM = 0.02
# Where the core of a PSF is cut from its tail, a raised cosine falls from this fraction of the
# outer radius to it.
CUT_EDGE = 0.5


@dataclass(frozen=True)
class FieldKernels:
    """Channel kernels at the fields of the bank, in the frame of its PSFs.

    Attributes
    ----------
    splines : ndarray (F, J, C, n, n)
        Coefficients of quintic splines, [y, x]: [sagittal, tangential] of a lens with an axis; the
        chief ray is at sample n / 2. Planes and channels are sampled together: in memory those of a
        sample follow one another (see `interleaved`).
    places : Places
        Where the fields lie.
    pitch_um : float
        Pitch of the grid: the bank's, or a multiple of it.
    mirrored : bool
        Whether the kernels of a place are those of its mirror images about both axes, mirrored.
    ringing : bool
        Whether they ring beyond the PSFs: their band ends softly, and their spectra are sharpened.
    """

    splines: np.ndarray
    places: Places
    pitch_um: float
    mirrored: bool = False
    ringing: bool = False


def low_pass(
    frequency: np.ndarray, sim_pitch_um: float, from_nyquist: float = BAND_EDGE
) -> np.ndarray:
    """Return the band limit of a sim grid at radial spatial frequencies, cycles/um.

    It falls from that share of the Nyquist frequency on.
    """
    nyquist = 0.5 / sim_pitch_um
    fall = np.clip((frequency / nyquist - from_nyquist) / (1 - from_nyquist), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * fall))


def sharpening(frequency: np.ndarray) -> np.ndarray:
    """Return what makes of the band of kernels that end softly that of a sim grid.

    At radial frequencies, cycles per sim sample.
    """
    soft = low_pass(frequency, 1.0, SOFT_EDGE)
    return np.divide(low_pass(frequency, 1.0), soft, out=np.zeros_like(soft), where=soft > 0)


def sharpened(kernels: np.ndarray) -> np.ndarray:
    """Return kernels (..., n, n) that are held softly, float32, with the band of their grid."""
    size = kernels.shape[-1]
    f = np.hypot(scipy.fft.rfftfreq(size), scipy.fft.fftfreq(size)[:, None])
    spectra = scipy.fft.rfft2(kernels) * sharpening(f).astype(np.float32)
    return scipy.fft.irfft2(spectra, (size, size))


def core_window(distance_um: np.ndarray, radius_um: float) -> np.ndarray:
    """Return the weight of a PSF's core at distances from its chief ray; the rest is the tail's."""
    fall = np.clip((distance_um / radius_um - CUT_EDGE) / (1 - CUT_EDGE), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * fall))


def distances_um(n: int, pitch_um: float) -> np.ndarray:
    """Return the distance of each sample of an n x n kernel grid from the chief ray."""
    line = (np.arange(n) - n // 2) * pitch_um
    return np.hypot(line, line[:, None])


def interleaved(fields: int, planes: int, channels: int, n: int) -> np.ndarray:
    """Return room for `FieldKernels.splines` in the order in which they are read."""
    return np.empty((fields, n, n, planes, channels), np.float32).transpose(0, 3, 4, 1, 2)


def field_kernels(
    images: np.ndarray,
    places: Places,
    bank_pitch_um: float,
    sim_pitch_um: float,
    part: np.ndarray,
) -> FieldKernels:
    """Take a part of the channel kernels, end its band at a sim grid's, and make splines of it.

    As many samples are kept as the part is wide or as it rings, and as far apart as the sim grid's
    band allows.

    Parameters
    ----------
    images, places
        As `gpusim.optics.images.field_images` returns them.
    bank_pitch_um, sim_pitch_um : float
    part : ndarray (n, n)
        Weight of each sample: the core, the tail, or all.
    """
    ratio = sim_pitch_um / bank_pitch_um
    step = _step(ratio, len(part))
    within = _around(part, step)
    part = part[within, within].astype(np.float32)
    around = 0
    edge = (1 + BAND_EDGE) / 4 / ratio  # cycles a sample of the bank
    # Beyond the bank's own band PSFs hold nothing.
    rings = edge < 0.5 and _transfer(images[0][..., within, within] * part, edge) > RINGS_FROM
    if rings:
        ringing = step * scipy.fft.next_fast_len(math.ceil(RINGING * ratio / step), real=True)
        around = max(ringing - len(part) // 2, 0)
    n = len(part) + 2 * around
    # The band ends below the Nyquist frequency of every step-th sample: the spectrum of those is
    # its middle.
    half = n // step // 2
    rows = np.r_[:half, n - half : n]
    fx, fy = scipy.fft.rfftfreq(n)[: half + 1], scipy.fft.fftfreq(n)[rows, None]
    # Splines through the samples are the samples with the spectrum of the B-spline's own samples
    # (1, 26, 66, 26, 1) / 120 divided out, along each axis (Unser 1999).
    along_x, along_y = (
        (33 + 26 * np.cos(2 * np.pi * step * f) + np.cos(4 * np.pi * step * f)) / 60
        for f in (fx, fy)
    )
    edge = SOFT_EDGE if rings else BAND_EDGE
    band = low_pass(np.hypot(fx, fy) / bank_pitch_um, sim_pitch_um, edge)
    shaping = (band / (along_x * along_y)).astype(np.float32)
    splines = interleaved(*images.shape[:3], n // step)
    if around:
        # Far wider than the PSFs: their spectra at these frequencies alone, by matrices.
        at = around + np.arange(len(part))
        to_x, to_y = (np.exp(-2j * np.pi * at * f).astype(np.complex64) for f in (fx[:, None], fy))
    for of_field, field in zip(splines, images, strict=True):  # what is at hand stays in the cache
        held = field[..., within, within] * part
        if around:
            shaped = to_y @ held @ to_x.T
        else:
            shaped = scipy.fft.rfft2(held, workers=2)
            if step > 1:
                shaped = shaped[..., rows, : half + 1]
        shaped *= shaping
        of_field[...] = scipy.fft.irfft2(shaped, s=of_field.shape[-2:], workers=2, overwrite_x=True)
    symmetric = mirrored(images[:, 0], places)
    return FieldKernels(splines, places, step * bank_pitch_um, symmetric, rings)


def _transfer(images: np.ndarray, frequency: float) -> float:
    """Return the largest transfer of PSFs (..., n, n) at a frequency along x, cycles a sample."""
    turn = np.exp(-2j * np.pi * frequency * np.arange(images.shape[-1]))
    light = images.sum(axis=(-2, -1))
    return float(np.max(np.abs(images.sum(axis=-2) @ turn) / np.where(light > 0, light, np.inf)))


def _step(ratio: float, n: int) -> int:
    """Return how many of the bank's samples go to one of the splines', of n along an axis.

    At least `SAMPLES_WITHIN` remain in one of the sim grid, and an even number in all.
    """
    step = 1
    while 2 * step * SAMPLES_WITHIN <= ratio and n % (4 * step) == 0:
        step *= 2
    return step


def _around(part: np.ndarray, step: int) -> slice:
    """Return which samples, along each axis, hold a part about the middle, and what rings."""
    n = len(part)
    far = np.flatnonzero(part[n // 2])
    half = max(n // 2 - far[0], far[-1] - n // 2) + PAD if len(far) else PAD
    # A size that is transformed fast, in whole samples of the splines on both sides.
    half = step * scipy.fft.next_fast_len(-(-half // step), real=True)
    return slice(n // 2 - half, n // 2 + half) if half < n // 2 else slice(0, n)
