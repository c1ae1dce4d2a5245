"""Channel kernels at the PSF nodes: what one sample of one plane gives to each photosite around it.

All in float64 on the host; the spectra are handed to the device in float32. The kernel of plane j
in channel c at field point s is

    H_cj(x; s) = sum_k sum_l rates[j, c, l, k] K(s, l) h_l(x - (x_c(s, k) - x_ref(s)); s),

K the relative illumination, h_l the PSF at bank wavelength l about its chief ray, x_c the chief ray
at sample k of the spectrum, a spline through those of the bank's wavelengths: colours make a streak
(`gpusim.psf.lines`). Between the bank's fields the sum is interpolated (`gpusim.psf.places`: in
radius and rotated to the azimuth of s, or over a grid). Into it are folded the pixel aperture, and
the inverse of the Gaussian with which the scene was low-passed before it was sampled on the sim
grid.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.sparse import csr_array

from gpusim.optics.angular import PlaceWeights
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.lines import line_shares
from gpusim.psf.places import Places, half_turned
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.aperture import Response

# Pad of the fine grid against wrap-around of shifts and of the inverse Gaussian's ringing, samples
# on each side.
PAD = 32
# The splines between the bank's samples: the six quintic B-splines that are not 0 between two of
# them, as polynomials of the place there, 0 to 1; a line for each power, a column for each sample
# from two before to three after (Unser 1999, eq. 5).
# What a spline of degree d adds beyond the bank's band falls as sinc(f)^(d+1) and folds back when
# it is sampled on the sim grid: with cubic splines the sums of the demonstration camera's kernels
# change with the azimuth by 0.3, 0.6 and 1.1e-3 in red, green and blue, with quintic ones by 0.8, 3
# and 6e-5. Nodes do not help against it.
BASIS = (
    np.array(
        [
            (1, 26, 66, 26, 1, 0),
            (-5, -50, 0, 50, 5, 0),
            (10, 20, -60, 20, 10, 0),
            (-10, 20, 0, -20, 10, 0),
            (5, -20, 30, -20, 5, 0),
            (-1, 5, -10, 10, -5, 1),
        ]
    )
    / 120
)
# Samples of the splines in one sample of the sim grid, where the bank has more. In the tails of the
# demonstration camera (6.2), taking every second one errs by 5e-5 of the tail's sum, every fourth
# by 2.5e-4.
SAMPLES_WITHIN = 3.0
# Difference between the sides of PSFs, relative to the largest sample, below which both count as
# one. PSFs that were traced are symmetric to the last bit.
ASYMMETRY = 1e-6
# The kernels' band ends at the sim grid's Nyquist frequency, with a raised-cosine edge below it: a
# sharp end would ring.
BAND_EDGE = 0.85
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
        Coefficients of quintic splines, [y, x]: [tangential, radial] of a lens with an axis; the
        chief ray is at sample n / 2. Planes and channels are sampled together: in memory those of a
        sample follow one another (see `interleaved`).
    places : Places
        Where the fields lie.
    pitch_um : float
        Pitch of the grid: the bank's, or a multiple of it.
    mirrored : bool
        Whether the kernels of a place are those of its mirror images about both axes, mirrored.
    ringing : bool
        Whether they ring beyond the PSFs.
    """

    splines: np.ndarray
    places: Places
    pitch_um: float
    mirrored: bool = False
    ringing: bool = False


def low_pass(frequency: np.ndarray, sim_pitch_um: float) -> np.ndarray:
    """Return the band limit of a sim grid at radial spatial frequencies, cycles/um."""
    nyquist = 0.5 / sim_pitch_um
    fall = np.clip((frequency / nyquist - BAND_EDGE) / (1 - BAND_EDGE), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * fall))


def core_window(distance_um: np.ndarray, radius_um: float) -> np.ndarray:
    """Return the weight of a PSF's core at distances from its chief ray; the rest is the tail's."""
    fall = np.clip((distance_um / radius_um - CUT_EDGE) / (1 - CUT_EDGE), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * fall))


def interleaved(fields: int, planes: int, channels: int, n: int) -> np.ndarray:
    """Return room for `FieldKernels.splines` in the order in which they are read."""
    return np.empty((fields, n, n, planes, channels), np.float32).transpose(0, 3, 4, 1, 2)


def field_images(
    bank: FieldBank,
    rates: np.ndarray,
    reach_um: float,
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
        As `field_images` returns them.
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
    rings = _transfer(images[0][..., within, within] * part, edge) > RINGS_FROM
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
    band = low_pass(np.hypot(fx, fy) / bank_pitch_um, sim_pitch_um)
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


def mirrored(images: np.ndarray, places: Places) -> bool:
    """Return whether kernels of mirrored places are mirrored: see `FieldKernels`.

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


def distances_um(n: int, pitch_um: float) -> np.ndarray:
    """Return the distance of each sample of an n x n kernel grid from the chief ray."""
    line = (np.arange(n) - n // 2) * pitch_um
    return np.hypot(line, line[:, None])


def sampled_kernels(
    kernels: FieldKernels,
    x_um: float,
    y_um: float,
    sim_pitch_um: float,
    half_size: int,
    planes: int,
) -> np.ndarray:
    """Return the kernels of one field point on a sim grid, of the first planes only.

    They hold all of the light, also where they ring beyond what is sampled: a sharp PSF on a grid
    of 5 um lost 2.4e-3 of it within 66 um. What is cut off is added to what is there.

    Returns
    -------
    ndarray (planes, C, 2 R, 2 R)
        Index [row, column]; the source sample is at [R, R]. The first row and column are zero: to
        the other side there is none as far away.
    """
    channels, n = kernels.splines.shape[2], kernels.splines.shape[-1]
    fields, weights, cos, sin = kernels.places.at(x_um, y_um)
    dx = (np.arange(2 * half_size) - half_size) * sim_pitch_um
    dy = dx[:, None]
    radial = (cos * dx + sin * dy) / kernels.pitch_um
    tangential = (cos * dy - sin * dx) / kernels.pitch_um
    inside = np.maximum(np.abs(radial), np.abs(tangential)) < n // 2 - 2
    inside[0] = inside[:, 0] = False
    # Those of a sample side by side. Made by Fourier transforms, splines go on periodically.
    splines = np.empty((n + 1, n + 1, planes * channels))
    splines[:n, :n] = sum(
        np.float64(weight) * kernels.splines[field, :planes].transpose(2, 3, 0, 1).reshape(n, n, -1)
        for field, weight in zip(fields, weights, strict=True)
    )
    splines[n], splines[:, n] = splines[0], splines[:, 0]
    at = (part[inside] + n // 2 for part in (tangential, radial))
    area = (sim_pitch_um / kernels.pitch_um) ** 2
    found = _spline_weights(*at, n + 1) @ splines.reshape((n + 1) ** 2, -1)
    found *= area
    lacking = splines[:n, :n].sum(axis=(0, 1)) - found.sum(axis=0)
    # Terms of weights that go with the place may be negative, and hold nothing in sum.
    share = np.abs(found)
    found += lacking * share / np.maximum(share.sum(axis=0), np.finfo(float).tiny)
    out = np.zeros((planes * channels, 2 * half_size, 2 * half_size))
    out[:, inside] = found.T
    return out.reshape(planes, channels, *out.shape[1:])


def _spline_weights(y: np.ndarray, x: np.ndarray, n: int) -> csr_array:
    """Return splines' values at points as sums of n x n coefficients: a matrix (points, n * n).

    Made once for all planes and channels: with 9 of them and 88 x 88 points all together takes a
    third of the time of nine calls of `scipy.ndimage.map_coordinates`, which find the weights anew
    each time.
    """
    first = np.zeros(len(y), np.int32)
    along = []
    for place in (y, x):
        before = np.floor(place)
        first = first * np.int32(n) + before.astype(np.int32) - np.int32(2)
        between = place - before
        of_taps = np.empty((len(BASIS), len(place)))
        of_taps[:] = BASIS[-1][:, None]
        for terms in BASIS[-2::-1]:  # Horner's scheme
            of_taps *= between
            of_taps += terms[:, None]
        along.append(of_taps)
    weights = np.einsum("yp,xp->pyx", *along, order="C")
    taps = np.arange(len(BASIS), dtype=np.int32)
    columns = first[:, None] + (taps[:, None] * np.int32(n) + taps).ravel()
    ends = np.arange(0, columns.size + 1, columns.shape[1], dtype=np.int32)
    return csr_array((weights.ravel(), columns.ravel(), ends), shape=(len(y), n * n))


def node_kernels(
    sample: Callable[[int, int], np.ndarray],
) -> np.ndarray:
    """Return the kernels of a node that let interpolation err least in the mean square.

    Straight lines through samples of a curve err to one side, by f'' t (h - t) / 2. Lines through

        f - h^2 f'' / 12

    instead err to both, and 2.4 times less in the root mean square (the least-squares spline of
    degree 1; Unser 1999, section on approximation). f'' h^2 is taken as the second difference
    between the nodes, along x and along y.

    Parameters
    ----------
    sample : callable
        Returns the kernels dx, dy nodes away.
    """
    neighbours = sample(-1, 0) + sample(1, 0) + sample(0, -1) + sample(0, 1)
    return sample(0, 0) * (1 + 4 / 12) - neighbours / 12


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
    length: int, aperture: float | Response, sigma: float, shift_x: float, shift_y: float
) -> np.ndarray:
    """Return the same in x and y, [kx, ky] (T/2+1, T), of a square's side or of any response."""
    half = length // 2 + 1
    if not isinstance(aperture, Response):
        along_y = aperture_spectrum(length, aperture, sigma, shift_y)
        return aperture_spectrum(length, aperture, sigma, shift_x)[:half, None] * along_y
    # What is left of a square without a side.
    along_y = aperture_spectrum(length, 0.0, sigma, shift_y)
    along_x = aperture_spectrum(length, 0.0, sigma, shift_x)[:half, None]
    f = scipy.fft.fftfreq(length)
    return aperture.spectrum(np.abs(f[:half, None]), f) * along_x * along_y


def kernel_spectra(
    sampled: np.ndarray,
    length: int,
    aperture: float | Response,
    sigma: float,
    outputs: list[tuple[int, float, float]],
) -> np.ndarray:
    """Return the spectra that shaders/optics/columns multiplies with.

    Parameters
    ----------
    sampled : ndarray (J, C, 2 R, 2 R)
        As `sampled_kernels` returns them.
    length : int
        Transform length T.
    aperture, sigma
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
            aperture_xy = _aperture_spectra(length, aperture, sigma, shift_x, shift_y)
            np.multiply(spectrum, aperture_xy, out=shaped)
            by_lane = shaped.reshape(8, 2, 16, fine, length // 16, 8).transpose(4, 3, 2, 0, 5, 1)
            for odd in (0, 1):  # NumPy's innermost loop is then over eight, not over two
                result[plane, :, :, :, place, :, :, odd] = by_lane[..., odd]
    return result


@functools.lru_cache(maxsize=64)  # the nodes of a scale share theirs, sixteen sites at most
def _aperture_spectra(
    length: int, aperture: float | Response, sigma: float, shift_x: float, shift_y: float
) -> np.ndarray:
    """Return the aperture's spectrum over T^2, [ky, kx], without kx = T/2."""
    whole = aperture_spectra(length, aperture, sigma, shift_x, shift_y) / length**2
    return np.ascontiguousarray(whole[:-1].T, np.complex64)
