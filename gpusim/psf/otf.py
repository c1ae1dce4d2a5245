"""Optical transfer functions: of a PSF, of a pupil, of several wavelengths together, through focus.

An OTF is the Fourier transform of the light's distribution along one direction of the image,

    OTF(nu) = integral PSF(x) exp(-2 pi i nu x) dx,

and the MTF its modulus. Frequencies are in cycles/mm in the image plane. Directions have the names
of ISO 15529 and of lens design: **tangential** is the frequency vector along the radius (lines
perpendicular to it): columns xi of a bank's PSFs. **Sagittal** is
perpendicular to that (radial lines): rows eta.

From a pupil the OTF comes by its line spread function, which has no window: by Parseval's theorem
the sum over one direction of the image is a sum over the same direction of the pupil.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import ndimage

from gpusim.errors import UserError
from gpusim.lens.samples import Samples, sample_field
from gpusim.lens.system import System
from gpusim.lens.wavefront import Pupil, pupils

Direction = Literal["tangential", "sagittal"]
DIRECTIONS: tuple[Direction, ...] = ("tangential", "sagittal")
# Least nodes across a pupil: the OTF of the double Gauss at f/2.8 agrees to 6e-5 with that of its
# PSF from as many nodes, and to 1e-3 with a closed form.
PUPIL_NODES = 256
# Nodes for a single frequency: within 1e-3 of the finer grid for the double Gauss at f/2, f = 100
# mm, whose rays land up to 0.3 mm away, and within 7e-4 at f/2.8, f = 8.3 mm.
COARSE_NODES = 128


def otf(
    psf: np.ndarray, pitch_um: float, frequency_cy_mm: np.ndarray, direction: Direction
) -> np.ndarray:
    """Return the OTF of a sampled PSF; at frequency 0 it is the sum of the PSF.

    Parameters
    ----------
    psf : ndarray, shape (..., n, n)
        Rows sagittal (eta), columns tangential (xi), as in a bank; its origin is sample n / 2.
    pitch_um : float
        Spacing of the samples.
    frequency_cy_mm : ndarray, shape (K,)
    direction : "tangential" or "sagittal"
        Tangential: frequency along xi.

    Returns
    -------
    ndarray of complex, shape (..., K)
        What a finite window has lost of the light, the OTF may miss at every frequency.

    Raises
    ------
    UserError
        Where a frequency is beyond what the pitch samples.
    """
    frequency = np.atleast_1d(np.asarray(frequency_cy_mm, dtype=float))
    nyquist = 500 / pitch_um
    if np.abs(frequency).max() > nyquist:
        raise UserError(
            "the PSF is not sampled finely enough for this frequency",
            field="frequency_cy_mm",
            value=f"{np.abs(frequency).max():g}",
            allowed=f"up to {nyquist:g} cycles/mm for a pitch of {pitch_um:g} um",
        )
    line = np.asarray(psf, dtype=float).sum(axis=-2 if direction == "tangential" else -1)
    at_um = (np.arange(line.shape[-1]) - line.shape[-1] // 2) * pitch_um
    return transform(line, at_um, frequency)


def transform(line: np.ndarray, at_um: np.ndarray, frequency_cy_mm: np.ndarray) -> np.ndarray:
    """Return the Fourier transform of lines (..., n) at given places, shape (..., K)."""
    return line @ np.exp(-2e-3j * np.pi * np.outer(at_um, frequency_cy_mm))


def diffraction_mtf(
    frequency_cy_mm: np.ndarray, wavelength_nm: float, f_number: float
) -> np.ndarray:
    """Return the MTF of a perfect lens with a round pupil (Goodman, Fourier Optics, sec. 6.4).

    Parameters
    ----------
    frequency_cy_mm : ndarray, shape (K,)
    wavelength_nm : float
    f_number : float
        Working f-number: 1 / (2 sin theta').
    """
    s = np.minimum(np.abs(frequency_cy_mm) * wavelength_nm * 1e-6 * f_number, 1.0)
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))


def refocused(pupil: Pupil, dz_mm: float, slope: float = 0.0) -> Pupil:
    """Return the pupil as seen from an image plane that is shifted by ``dz_mm`` along the light.

    A plane wave with direction cosines (alpha, beta, gamma) gains the path gamma dz: exact, not
    the usual quadratic. The centre of the image moves along with the slope: beta slope dz.

    Parameters
    ----------
    pupil : Pupil
    dz_mm : float
    slope : float
        By how much the image's centre moves radially per dz; beta / gamma of a ray keeps the place
        where it lands.
    """
    gained = _path_per_dz(pupil.alpha[:, None], pupil.beta[None], slope)
    return replace(pupil, opd_mm=pupil.opd_mm + dz_mm * gained)


def _path_per_dz(alpha: np.ndarray, beta: np.ndarray, slope: float) -> np.ndarray:
    return np.sqrt(np.maximum(1 - alpha**2 - beta**2, 0.0)) + slope * beta


def line_spread(
    pupil: Pupil, wavelength_nm: float, direction: Direction
) -> tuple[np.ndarray, np.ndarray]:
    """Return the line spread function of a pupil: places (um), and share of the light at each.

    The places cover one period of the sampled pupil's image, lambda / spacing, with 0 in the
    middle; light beyond it folds back.

    The share is of the light that the pupil's area passes. A cell on the rim counts with the square
    of its coverage at frequency 0 and with its coverage at others: the sum falls short of 1 by
    2.5e-3 with 256 nodes, and the other frequencies are right to 2e-4.
    """
    wavelength_um = wavelength_nm * 1e-3
    field = pupil.amplitude * np.exp(2e3j * np.pi / wavelength_um * pupil.opd_mm)
    if direction == "tangential":
        spacing = pupil.beta[1] - pupil.beta[0]
    else:
        field = _whole(field, pupil).T
        spacing = pupil.alpha[1] - pupil.alpha[0]
    # Twice as many samples as nodes: the intensity has twice the field's bandwidth.
    count = 2 * field.shape[1]
    # The inverse transform has exp(+i k beta xi), as the image has.
    line = np.fft.fftshift(np.square(np.abs(np.fft.ifft(field, count, axis=1))).sum(axis=0))
    at_um = (np.arange(count) - count // 2) * (wavelength_um / (spacing * count))
    both = 2 if pupil.half and direction == "sagittal" else 1
    passed = both * pupil.light.sum()
    return at_um, line * (count / passed)


def _whole(values: np.ndarray, pupil: Pupil) -> np.ndarray:
    """Return values on the whole pupil: of a half, those with alpha < 0 are the mirror image."""
    return np.concatenate([values[::-1], values]) if pupil.half else values


def pupil_otf(
    pupil: Pupil, wavelength_nm: float, frequency_cy_mm: np.ndarray, direction: Direction
) -> np.ndarray:
    """Return the OTF of a pupil, 0 beyond the cut-off; shape (K,)."""
    at_um, line = line_spread(pupil, wavelength_nm, direction)
    # Beyond its Nyquist frequency the sampled line repeats itself; the pupil has no more to give.
    within = np.abs(frequency_cy_mm) <= 500 / (at_um[1] - at_um[0])
    return within * transform(line, at_um, np.where(within, frequency_cy_mm, 0.0))


def through_focus(
    pupil: Pupil,
    wavelength_nm: float,
    frequency_cy_mm: float,
    direction: Direction,
    dz_mm: np.ndarray,
    *,
    slope: float = 0.0,
) -> np.ndarray:
    """Return the OTF at one frequency in many image planes, by the pupil's autocorrelation.

    OTF(nu) = integral P(+) P*(-) over the pupil, P(+-) half of lambda nu to either side (Goodman,
    sec. 6.3). What stays under the integral turns by 2 pi nu times where a ray lands, not by the
    wavefront: at a single frequency a coarse grid does for large aberrations too.

    Parameters
    ----------
    pupil : Pupil
    wavelength_nm, frequency_cy_mm : float
    direction : "tangential" or "sagittal"
    dz_mm : ndarray, shape (Z,)
        Shifts of the image plane along the light.
    slope : float
        As for ``refocused``.

    Returns
    -------
    ndarray of complex, shape (Z,)
    """
    step = wavelength_nm * 1e-6 * frequency_cy_mm / 2
    alpha, beta = pupil.alpha, pupil.beta
    amplitude, light, opd = pupil.amplitude, pupil.light, pupil.opd_mm
    if direction == "sagittal":
        alpha = np.concatenate([-alpha[::-1], alpha]) if pupil.half else alpha
        amplitude, light, opd = (_whole(one, pupil) for one in (amplitude, light, opd))
        nodes, turn = step / (alpha[1] - alpha[0]), (1, 0)
        ahead, behind = ((alpha[:, None] + side, beta[None]) for side in (step, -step))
    else:
        nodes, turn = step / (beta[1] - beta[0]), (0, 1)
        ahead, behind = ((alpha[:, None], beta[None] + side) for side in (step, -step))

    def moved(values: np.ndarray, sign: float, order: int) -> np.ndarray:
        """Return the values a step away, 0 beyond the grid."""
        return ndimage.shift(values, [-sign * nodes * axis for axis in turn], order=order)

    both = moved(amplitude, 1, 1) * moved(amplitude, -1, 1)
    lit = both > 0
    difference = (moved(opd, 1, 3) - moved(opd, -1, 3))[lit]
    per_dz = (_path_per_dz(*ahead, slope) - _path_per_dz(*behind, slope))[lit]
    k = 2e6 * np.pi / wavelength_nm
    phase = np.exp(1j * k * (difference + np.multiply.outer(np.asarray(dz_mm), per_dz)))
    return phase @ both[lit] / light.sum()


def polychromatic(
    otfs: np.ndarray,
    weight: np.ndarray,
    frequency_cy_mm: np.ndarray,
    shift_um: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Return the OTF of all wavelengths together, each with its light and at its place.

    Parameters
    ----------
    otfs : ndarray of complex, shape (L, K)
        One for each wavelength, 1 at frequency 0.
    weight : ndarray, shape (L,)
        Light of each wavelength: any spectrum times transmission and solid angle.
    frequency_cy_mm : ndarray, shape (K,)
    shift_um : ndarray, shape (L,)
        Where each wavelength's origin lies along the direction: lateral colour. 0 for sagittal.

    Returns
    -------
    ndarray of complex, shape (K,)
    """
    at = np.broadcast_to(shift_um, weight.shape)
    phase = np.exp(-2e-3j * np.pi * np.outer(at, frequency_cy_mm))
    return (weight / weight.sum()) @ (otfs * phase)


@dataclass(frozen=True)
class FieldPupils:
    """The pupils of one field with what turns them into polychromatic transfer functions.

    Attributes
    ----------
    wavelengths_nm, weight : ndarray, shape (L,)
        Weight: light, to any scale.
    shift_um : ndarray, shape (2, L)
        Place of each chief ray, from the reference's, along each of ``DIRECTIONS``.
    fine : list of Pupil, length L
        So finely sampled that no ray lands where the image repeats.
    coarse : list of Pupil, length L
        Enough for a single frequency.
    slope : float
        Radial slope of the reference wavelength's light, by which the image moves with focus.
    """

    wavelengths_nm: np.ndarray
    weight: np.ndarray
    shift_um: np.ndarray
    fine: list[Pupil]
    coarse: list[Pupil]
    slope: float

    def otf(
        self, frequency_cy_mm: np.ndarray, direction: Direction, dz_mm: float = 0.0
    ) -> np.ndarray:
        """Return the polychromatic OTF in an image plane shifted by ``dz_mm``; shape (K,)."""
        frequency = np.atleast_1d(np.asarray(frequency_cy_mm, dtype=float))
        otfs = [
            pupil_otf(refocused(pupil, dz_mm, self.slope), wavelength, frequency, direction)
            for pupil, wavelength in zip(self.fine, self.wavelengths_nm, strict=True)
        ]
        return self._together(otfs, frequency, direction)

    def through_focus(
        self, frequency_cy_mm: float, direction: Direction, dz_mm: np.ndarray
    ) -> np.ndarray:
        """Return the polychromatic OTF at one frequency in many image planes; shape (Z,)."""
        otfs = [
            through_focus(pupil, wavelength, frequency_cy_mm, direction, dz_mm, slope=self.slope)
            for pupil, wavelength in zip(self.coarse, self.wavelengths_nm, strict=True)
        ]
        return self._together(otfs, np.full(len(dz_mm), float(frequency_cy_mm)), direction)

    def _together(
        self, otfs: list[np.ndarray], frequency: np.ndarray, direction: Direction
    ) -> np.ndarray:
        shift = self.shift_um[DIRECTIONS.index(direction)]
        return polychromatic(np.array(otfs), self.weight, frequency, shift)


def field_pupils(
    system: System,
    theta: float,
    wavelengths_nm: np.ndarray,
    spectrum: np.ndarray,
    *,
    reference: int = 0,
    depth_mm: float = 0.0,
    azimuth: float = 0.0,
) -> FieldPupils:
    """Trace one field and put its pupils on grids.

    Parameters
    ----------
    system : System
    theta : float
        Field angle, rad.
    wavelengths_nm : ndarray, shape (L,)
    spectrum : ndarray, shape (L,)
        Light before the pupil: source times transmission; what enters the pupil is found here.
    reference : int
        Index of the wavelength whose chief ray is the image's centre.
    depth_mm : float
        Largest shift of the image plane for which ``otf`` will be asked.
    azimuth : float
        Azimuth of the field, rad. Whatever it is, tangential is along y and sagittal along x.

    Raises
    ------
    UserError
        Where the field does not pass the lens.
    """
    samples = sample_field(system, system.index(wavelengths_nm), theta, azimuth)
    slope = _mean_slope(samples, reference)
    # The image repeats after twice the window: a little beyond where the farthest rays land.
    window_um = 1.1 * reach_um(samples, slope, depth_mm)
    fine = pupils(samples, wavelengths_nm, window_um, PUPIL_NODES)
    entered = np.array([pupil.entered for pupil in fine])
    chief_um = 1e3 * np.stack([samples.chief_y_mm, samples.chief_x_mm])
    return FieldPupils(
        wavelengths_nm=np.asarray(wavelengths_nm, dtype=float),
        weight=np.asarray(spectrum, dtype=float) * entered,
        shift_um=chief_um - chief_um[:, [reference]],
        fine=fine,
        coarse=pupils(samples, wavelengths_nm, 1.0, COARSE_NODES),
        slope=slope,
    )


def _slopes(samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Return dx/dz and dy/dz of the rays."""
    gamma = np.sqrt(np.maximum(1 - samples.alpha**2 - samples.beta**2, 1e-12))
    return samples.alpha / gamma, samples.beta / gamma


def _mean_slope(samples: Samples, line: int) -> float:
    """Return the mean dy/dz of the rays of one wavelength that pass the lens."""
    return float(_slopes(samples)[1][line][samples.inside[line]].mean())


def reach_um(samples: Samples, slope: float, depth_mm: float) -> float:
    """Return how far from the image's centre rays land, with the image plane shifted by a depth."""
    steep_x, steep_y = _slopes(samples)
    x = np.abs(samples.landing_x_mm) + depth_mm * np.abs(steep_x)
    y = np.abs(samples.landing_y_mm) + depth_mm * np.abs(steep_y - slope)
    return 1e3 * float(np.maximum(x, y)[samples.inside].max())
