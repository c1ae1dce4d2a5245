"""Images of the PSFs at the bank's fields: its wavelengths folded into each channel's.

The image of plane j in channel c at field point s is

    H_cj(x; s) = sum_k sum_l rates[j, c, l, k] K(s, l) h_l(x - (x_c(s, k) - x_ref(s)); s),

K the relative illumination, h_l the PSF at bank wavelength l about its chief ray, x_c the chief ray
at sample k of the spectrum, a spline through those of the bank's wavelengths: colours make a streak
(`gpusim.psf.lines`).
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from gpusim.optics.angular import PlaceWeights
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import line_shares
from gpusim.psf.places import Places, half_turned
from gpusim.scene.spectra import WAVELENGTHS_NM

# Pad of the fine grid against wrap-around of shifts and of the inverse Gaussian's ringing, samples
# on each side.
PAD = 32
# Difference between the sides of PSFs, relative to the largest sample, below which both count as
# one. PSFs that were traced are symmetric to the last bit.
ASYMMETRY = 1e-6


def field_images(
    bank: FieldBank,
    rates: np.ndarray,
    reach_um: float,
    *,
    force: bool = False,
    elsewhere: PlaceWeights | None = None,
    wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
) -> tuple[np.ndarray, Places]:
    """Fold the bank's wavelengths into channel kernels, at the fields that the sensor uses.

    Where no colour lies beside another, nothing is transformed.

    Parameters
    ----------
    bank : FieldBank
    rates : ndarray (J, C, L, K)
        Electrons/s of each plane in each channel, by bank wavelength and sample of the spectra.
    reach_um : float
        Largest image height that is needed.
    force : bool
        Shift the PSFs of a field without lateral colour too: for tests.
    elsewhere : PlaceWeights, optional
        In place of the rates, where they go with the place.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.

    Returns
    -------
    images : ndarray of float32 (F', J, C, n, n)
        On the bank's grid, [y, x]; of rates that are sums of terms, all fields of a term after
        those of the one before.
    places : Places
        Places of the F' fields.
    """
    n = bank.psf.shape[-1] + 2 * PAD
    fields, listed = bank.places(reach_um)
    terms, places = [rates[None]] * len(fields), listed
    if elsewhere is not None:
        terms, places = elsewhere.terms(fields, listed)
    images = np.empty((len(terms[0]), len(fields), *rates.shape[:2], n, n), np.float32)
    for place, number in enumerate(fields):
        psf, shift_um, relative_illumination = bank.field(number)
        light = terms[place] * relative_illumination[:, None]
        image = images[:, place]
        if shift_um.any() or force:
            colours = line_shares(bank.wavelengths_nm, bank.spectral_degree, wavelengths_nm)
            image[...] = _streaks(psf, light, shift_um.T @ colours, bank.pitch_um)
        else:
            image[...] = 0.0
            share = light.sum(axis=-1).astype(np.float32)
            image[..., PAD : n - PAD, PAD : n - PAD] = np.tensordot(share, psf, axes=1)
        if place in listed.opposite:
            image[...] = half_turned(image)
    return images.reshape(-1, *images.shape[2:]), places


def _streaks(
    psf: np.ndarray, light: np.ndarray, chief_um: np.ndarray, pitch_um: float
) -> np.ndarray:
    """Return the sums of PSFs (L, n, n) that move with the wavelength, in a frame of `PAD` samples.

    Parameters
    ----------
    psf : ndarray (L, n, n)
    light : ndarray (..., L, K)
        How much of each PSF lies at each chief ray.
    chief_um : ndarray (2, K)
        x, y of the chief rays.
    pitch_um : float
        Pitch of the PSFs.

    Returns
    -------
    ndarray (..., n + 2 PAD, n + 2 PAD)
    """
    n = psf.shape[-1] + 2 * PAD
    before, (lines, samples) = light.shape[:-2], light.shape[-2:]
    turn_x, turn_y = (
        np.exp(-2j * np.pi * np.outer(at, f)).astype(np.complex64)
        for at, f in zip(
            chief_um,
            (scipy.fft.rfftfreq(n, pitch_um), scipy.fft.fftfreq(n, pitch_um)),
            strict=True,
        )
    )
    spectra = scipy.fft.rfft(np.pad(psf, ((0, 0), (PAD, PAD), (PAD, PAD))), axis=-1, workers=2)
    flat = light.reshape(-1, samples).astype(np.float32)
    half = n // 2 + 1
    if chief_um[1].any():
        spectra = scipy.fft.fft(spectra, axis=-2, workers=2, overwrite_x=True)
        mixed = np.empty((n, len(flat) // lines, half), np.complex64)
        for of_row, spectrum, turn in zip(mixed, spectra.swapaxes(0, 1), turn_y.T, strict=True):
            transfer = (flat * turn) @ turn_x
            np.einsum("alf,lf->af", transfer.reshape(-1, lines, half), spectrum, out=of_row)
        mixed = scipy.fft.ifft(mixed, axis=0, workers=2, overwrite_x=True).swapaxes(0, 1)
    else:
        # The shifts of a lens with an axis are radial: each frequency along the rows has one
        # transfer, and a transform along the rows is enough.
        transfer = (flat @ turn_x).reshape(-1, lines, half)
        mixed = np.matmul(
            np.ascontiguousarray(transfer.transpose(2, 0, 1)),
            np.ascontiguousarray(spectra.transpose(2, 0, 1)),
        ).transpose(1, 2, 0)
    mixed = np.ascontiguousarray(mixed).reshape(*before, n, half)
    return scipy.fft.irfft(mixed, n, axis=-1, workers=2, overwrite_x=True)


def mirrored(images: np.ndarray, places: Places) -> bool:
    """Return whether kernels of mirrored places are mirrored.

    Parameters
    ----------
    images, places
        As `field_images` returns them.
    """
    upper = images[..., 1:, :]  # the first row has no partner
    if len(places.quadrants) != 1:
        return False
    # Half of the rows have their partners in the other half.
    few = upper.shape[-2] // 2
    parting = np.abs(upper[..., :few, :] - upper[..., : -few - 1 : -1, :]).max(initial=0.0)
    return bool(parting <= ASYMMETRY * images.max())
