"""Spectra of kernels, as the transforms of a block multiply with them.

They are made on the host and handed to the device in float32. Into them are folded the pixel
aperture, and the inverse of the Gaussian with which the scene was low-passed before it was sampled
on the sim grid.
"""

from __future__ import annotations

import functools

import numpy as np
import scipy.fft

from gpusim.optics.kernels import sharpening
from gpusim.sensor.aperture import Response


def aperture_spectrum(length: int, width: float, sigma: float, shift: float) -> np.ndarray:
    """Return the transform of a square pixel aperture over that of the scene's Gaussian.

    Parameters
    ----------
    length : int
        Transform length T.
    width : float
        Side of the aperture, sim samples.
    sigma : float
        Standard deviation of the Gaussian with which the scene was low-passed, sim samples; 0 for
        none.
    shift : float
        Position of the pixel's centre, sim samples.

    Returns
    -------
    ndarray (T,), complex
        sinc(width f) exp(2 pi^2 sigma^2 f^2 + 2 pi i f shift) at f = k / T; zero at the Nyquist
        frequency, which has no mirror of its own.
    """
    f = scipy.fft.fftfreq(length)
    transfer = np.sinc(width * f) * np.exp(2 * np.pi**2 * sigma**2 * f**2 + 2j * np.pi * f * shift)
    transfer[length // 2] = 0.0
    return transfer


def aperture_spectra(
    length: int,
    aperture: float | Response,
    sigma: float,
    shift_x: float,
    shift_y: float,
    *,
    ringing: bool,
) -> np.ndarray:
    """Return the same in x and y, [kx, ky] (T/2+1, T), of a square's side or of any response.

    ``ringing``: see `FieldKernels`.
    """
    # What is left of a square without a side.
    side = 0.0 if isinstance(aperture, Response) else aperture
    along_y = aperture_spectrum(length, side, sigma, shift_y)
    along_x = aperture_spectrum(length, side, sigma, shift_x)[: length // 2 + 1, None]
    found = along_x * along_y
    f = scipy.fft.fftfreq(length)
    across = np.abs(f[: length // 2 + 1, None])
    if isinstance(aperture, Response):
        found *= aperture.spectrum(across, f)
    if ringing:
        found *= sharpening(np.hypot(across, f))
    return found


def kernel_spectra(
    sampled: np.ndarray,
    length: int,
    aperture: float | Response,
    sigma: float,
    outputs: list[tuple[int, float, float]],
    *,
    ringing: bool = False,
) -> np.ndarray:
    """Return the spectra that shaders/optics/fft_columns multiplies with.

    Parameters
    ----------
    sampled : ndarray (J, C, 2 R, 2 R)
        As `gpusim.optics.sampling.sampled_kernels` returns them.
    length : int
        Transform length T.
    aperture, sigma, ringing
        See `aperture_spectra`; sim samples.
    outputs : list of (channel, shift_x, shift_y)
        What to make spectra for: a channel, and where the pixel's centre lies, sim samples.

    Returns
    -------
    ndarray (J, T/16, T/256, 16, len(outputs), 8, 8, 2), complex64
        [plane, kx/8, g, p, output, q/2, kx%8, q%2] with ky = T/256 (p + 16 q) + g: what eight
        invocations load lies together; divided by T^2 for the inverse transforms, which are not
        normalised. Without kx = T/2, where `aperture_spectra` are zero.
    """
    fine = length // 256
    shape = (length // 16, fine, 16, len(outputs), 8, 8, 2)
    result = np.empty((len(sampled), *shape), np.complex64)
    shaped = np.empty((length, length // 2), np.complex64)
    # One after the other: what is at hand, 1 MiB at T = 512, then stays in the cache.
    for plane, channel in np.ndindex(sampled.shape[:2]):
        # Only the rows that are there are transformed, not those of the padding.
        rows = scipy.fft.rfft(sampled[plane, channel].astype(np.float32), length)
        spectrum = scipy.fft.fft(rows[:, :-1], length, axis=0)  # [ky, kx]
        for place, (of_channel, shift_x, shift_y) in enumerate(outputs):
            if of_channel != channel:
                continue
            aperture_xy = _aperture_spectra(
                length, aperture, sigma, shift_x, shift_y, ringing=ringing
            )
            np.multiply(spectrum, aperture_xy, out=shaped)
            by_lane = shaped.reshape(8, 2, 16, fine, length // 16, 8).transpose(4, 3, 2, 0, 5, 1)
            for odd in (0, 1):  # NumPy's innermost loop is then over eight, not over two
                result[plane, :, :, :, place, :, :, odd] = by_lane[..., odd]
    return result


@functools.lru_cache(maxsize=64)  # the nodes of a scale share theirs, sixteen sites at most
def _aperture_spectra(
    length: int,
    aperture: float | Response,
    sigma: float,
    shift_x: float,
    shift_y: float,
    *,
    ringing: bool,
) -> np.ndarray:
    """Return the aperture's spectrum over T^2, [ky, kx], without kx = T/2."""
    whole = aperture_spectra(length, aperture, sigma, shift_x, shift_y, ringing=ringing)
    whole /= length**2
    return np.ascontiguousarray(whole[:-1].T, np.complex64)
