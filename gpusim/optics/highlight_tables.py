"""Kernels of highlights, tabulated in the frame of the PSFs, and how they are mixed.

Tables are made at the fields of the bank, and mixed as the exact model mixes these. Behind a lens
with an axis, the aperture of the pixel and the highlight's square stand at an angle in it, the
azimuth modulo 90 degrees: tables are made at so many angles, and cubics lead through the nearest
four.

Colours lie at the chief rays of the bank's wavelengths, each as much as the splines between these
give it (`gpusim.psf.lines`): what aperture and square blur follows the streak between the chief
rays as closely as cubics do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.fft

from gpusim.optics.angular import AngularResponse, PlaceWeights
from gpusim.optics.highlight_squares import Squares
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import FieldPsfs, Places
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.aperture import Response
from gpusim.sensor.sensor import Sensor

# Parts of the spline's spectrum that its samples fold onto their own frequencies, as multiples of
# the samples' rate. What is left out is below SLIGHT with aperture and square, and weak in PSFs,
# which are sampled finely enough.
ALIASES = (0, -1, 1, -2, 2)
SLIGHT = 1e-5
SMALL = 1e-7  # an angle whose sine is the angle
TRIED = 16  # angles in 90 degrees with which it is found out what mixing errs


class Tables:
    """Kernels of squares, by field of the bank, angle and shape of the square.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    spectra : ndarray (M, K)
    largest_um : float
        Side of the squares on the real plane, where it is largest.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.
    fine : int
        Samples of a table along one of the bank's.
    """

    def __init__(
        self,
        bank: FieldBank,
        sensor: Sensor,
        spectra: np.ndarray,
        largest_um: float,
        wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
        *,
        fine: int = 1,
    ) -> None:
        self.bank, self.fine = bank, fine
        self.pitch_um = bank.pitch_um / fine
        self.largest_um = largest_um
        self.aperture_um = sensor.response_um
        per_radiance = spectral_weights(bank, sensor, wavelengths_nm=wavelengths_nm)
        self.weights = np.einsum("clw,mw->cml", per_radiance, spectra)
        self.elsewhere = None
        if sensor.eqe_map is not None:
            response = AngularResponse(bank, sensor, wavelengths_nm)
            alike = np.ones((1, 1, wavelengths_nm.size))
            even = spectral_weights(bank, sensor, alike, wavelengths_nm)[0]
            self.elsewhere = PlaceWeights(response, even, spectra, 0.0)
        aperture_um = self.aperture_um
        if isinstance(aperture_um, Response):
            aperture_um = 2 * aperture_um.reach
        # From the middle of aperture and square to their corners, and lateral colour.
        corner = (aperture_um + largest_um) / np.sqrt(2) + bank.lateral_um
        n = bank.psf.shape[-1]
        at = np.arange(n) - n // 2
        psf_lit = bank.psf.reshape(-1, n, n).any(axis=0)
        reach = np.hypot(at, at[:, None])[psf_lit].max() + 2
        self.support = fine * reach + corner / self.pitch_um
        self.side = 2 * fine * scipy.fft.next_fast_len(math.ceil((self.support + 5) / fine))

    @property
    def reach_um(self) -> float:
        """Distance beyond which a square gives no light."""
        return self.support * self.pitch_um

    def spectra(self, field: FieldPsfs) -> np.ndarray:
        """Return the spectra (L, side, side / 2 + 1) of a field's PSFs, as density per um^2.

        Two transforms are divided out in each direction: that of the quintic B-spline's samples,
        by which the PSF's own become coefficients, and that of the cubic one's, by which what is
        tabulated does. A sharp PSF has detail that cubics miss; aperture and square blur it.
        """
        side, middle = self.side, field.psf.shape[-1] // 2
        half = side // (2 * self.fine)
        # A window may be much wider than what is lit in it, which a table always holds.
        lit = slice(max(middle - half, 0), middle + half)
        psf = field.psf[:, lit, lit].astype(np.float64) / self.bank.pitch_um**2
        before = half - (middle - lit.start)
        padded = np.pad(psf, ((0, 0), *[(before, 2 * half - psf.shape[-1] - before)] * 2))
        turn = 2 * np.pi * scipy.fft.fftfreq(side)
        cubic = (2 + np.cos(turn)) / 3
        quintic = (33 + 26 * np.cos(turn) + np.cos(2 * turn)) / 60
        line = cubic * quintic
        found = _finer(scipy.fft.rfft2(padded), self.fine)
        return found / (line[:, None] * line[: side // 2 + 1])

    @property
    def turns(self) -> int:
        """Quarters of a turn after which kernels are the same again."""
        turning = self.elsewhere is not None and self.elsewhere.response.turning
        return 4 if turning or isinstance(self.aperture_um, Response) else 1

    def weights_at(self, number: int, angle: float) -> np.ndarray:
        """Return electrons/s (C, M, L) of the scene's spectra at a field of the bank."""
        if self.elsewhere is None:
            return self.weights
        return self.elsewhere.of_field_at(number, angle).swapaxes(0, 1)

    def table(
        self,
        field: FieldPsfs,
        spectra: np.ndarray,
        weights: np.ndarray,
        angle: float,
        square: np.ndarray,
    ) -> np.ndarray:
        """Return spline coefficients (C, M, side, side) of a field's kernels at one angle.

        Electrons/s per um^2 of the square on the real plane and unit of the scene's spectra.

        Parameters
        ----------
        field : FieldPsfs
        spectra : ndarray
            As `spectra` returns them.
        weights : ndarray (C, M, L)
            As `weights_at` returns them.
        angle : float
            Azimuth, radians: that of the PSFs' x axis.
        square : ndarray (2, 2)
            Its sides in the frame of the PSFs at azimuth 0, um: d(real)/d(ideal) times the side.
        """
        shifts, pitch_um = field.shift_um / self.pitch_um, self.pitch_um
        spread = spectra * boxes(
            self.side, pitch_um, self.aperture_um, shifts, angle=angle, square=square
        )
        mixed = np.tensordot(weights * field.relative_illumination, spread, axes=1)
        table = scipy.fft.irfft2(mixed, s=(self.side, self.side))
        at = np.arange(self.side) - self.side // 2
        # Beyond lies rounding; and where the PSF is cut off, its spline swings below zero.
        table[..., np.hypot(at, at[:, None]) > self.support] = 0.0
        return np.maximum(table, 0.0)


def _finer(spectra: np.ndarray, fine: int) -> np.ndarray:
    """Return the spectra (L, s, s / 2 + 1) of samples that lie so many times as densely."""
    if fine == 1:
        return spectra
    count, half = len(spectra), spectra.shape[-1] - 1
    side = 2 * half * fine
    found = np.zeros((count, side, side // 2 + 1), spectra.dtype)
    found[:, :half, :half] = fine**2 * spectra[:, :half, :half]
    found[:, 1 - half :, :half] = fine**2 * spectra[:, 1 - half :, :half]
    return found


def boxes(
    side: int,
    pitch_um: float,
    aperture_um: float | Response,
    shifts: np.ndarray,
    *,
    angle: float,
    square: np.ndarray,
) -> np.ndarray:
    """Return spectra of the quintic B-spline averaged over aperture and square.

    (L, side, side / 2 + 1), in the frame of the PSFs, whose samples are the pitch apart; each
    wavelength (L, 2) lies where lateral colour moves it, samples. What is known in between, the
    transform of samples folds onto their own frequencies: sinc^6 of the spline, with a sinc for
    each side of aperture and square. ``angle`` and ``square``: see `Tables.table`.
    """
    fy, fx = scipy.fft.fftfreq(side), scipy.fft.rfftfreq(side)
    # Columns are the PSFs' x and y axis.
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    parallelograms = [turn @ square.T / pitch_um]
    aperture = None
    if isinstance(aperture_um, Response):
        aperture = aperture_um / pitch_um
    else:
        parallelograms.append(aperture_um / pitch_um * turn)
    folded, aliases = [], []
    for down, across in itertools.product(ALIASES, ALIASES):
        y, x = fy + down, fx + across
        of_y, of_x = np.sinc(y) ** 6, np.sinc(x) ** 6
        nearest = float(np.hypot(np.abs(y).min(), np.abs(x).min()))
        most = of_y.max() * of_x.max()
        if most * math.prod(_most(sides, nearest) for sides in parallelograms) < SLIGHT:
            continue
        one = _turned_boxes(np.concatenate(parallelograms), x, y)
        if aperture is not None:
            one = one * aperture.spectrum(
                turn[0, 0] * x + turn[0, 1] * y[:, None],
                turn[1, 0] * x + turn[1, 1] * y[:, None],
            )
        one *= of_x
        one *= of_y[:, None]
        folded.append((across, down))
        aliases.append(one)
    phases = np.exp(-2j * np.pi * shifts @ np.array(folded, float).T)
    planes = np.reshape(aliases, (len(aliases), -1))
    result = np.empty((len(shifts), side, len(fx)), np.complex128)
    if np.iscomplexobj(planes):
        result[...] = (phases @ planes).reshape(result.shape)
    else:
        result.real = (phases.real @ planes).reshape(result.shape)
        result.imag = (phases.imag @ planes).reshape(result.shape)
    for found, (moved_x, moved_y) in zip(result, shifts, strict=True):
        found *= np.exp(-2j * np.pi * moved_x * fx)
        if moved_y:
            found *= np.exp(-2j * np.pi * moved_y * fy)[:, None]
    return result


def _most(sides: np.ndarray, frequency: float) -> float:
    """Return a bound on the spectrum of a parallelogram at a distance from the frequency 0.

    A sinc is below 1 over pi times its argument, and the larger of the two arguments is at least
    the parallelogram's least stretch times the frequency over the root of two.
    """
    least = np.linalg.svd(sides, compute_uv=False)[-1] * frequency / np.sqrt(2)
    return 1.0 if np.pi * least <= 1 else float(1 / (np.pi * least))


def _turned_boxes(sides: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the spectrum (Y, X) of even parallelograms at frequencies x (X,) and y (Y,).

    `sides` (N, 2): their sides as rows; sinc of each one's product with the frequency.
    """
    sines, products = 1.0, 1.0
    for of_x, of_y in np.pi * sides:
        a, b = of_x * x, of_y * y
        total = a + b[:, None]
        # sin(a + b) from those of its parts: lines instead of a plane of them.
        sine = np.stack([np.cos(b), np.sin(b)], axis=1) @ np.stack([np.sin(a), np.cos(a)])
        small = np.abs(total) < SMALL
        total[small] = sine[small] = 1.0
        sines, products = sines * sine, products * total
    return sines / products


class MixingErrors(NamedTuple):
    """What mixing tables of angles errs half-way between two of TRIED in 90 degrees.

    It is relative to the largest value, in the light of the reference wavelength, at the worst of
    some fields.

    Attributes
    ----------
    linear, cubic : float
        Through the nearest two tables, and through the nearest four. The first falls with the
        square of the step from one angle to the next, the second with its fourth power.
    """

    linear: float
    cubic: float


def mixing_errors(kernels: Tables, fields: Sequence[FieldPsfs]) -> MixingErrors:
    """Return what mixing errs for the largest squares."""
    bank = kernels.bank
    line = slice(bank.reference, bank.reference + 1)
    square = kernels.largest_um * np.eye(2)
    half = np.pi / 4 / TRIED
    errors = []
    for field in fields:
        one = FieldPsfs(field.psf[line], field.shift_um[line], field.relative_illumination[line])
        spectra = kernels.spectra(one)
        far, before, between, after, beyond = (
            kernels.table(one, spectra, np.ones((1, 1, 1)), np.pi / 8 + step * half, square)
            for step in (-3, -1, 0, 1, 3)
        )
        largest = max(float(between.max()), np.finfo(float).tiny)
        linear = (before + after) / 2
        cubic = linear + (linear - (far + beyond) / 2) / 8
        errors.append([float(np.abs(mixed - between).max()) / largest for mixed in (linear, cubic)])
    return MixingErrors(*np.max(errors, axis=0).tolist())


class Mixture(NamedTuple):
    """How the kernels of squares are made.

    Attributes
    ----------
    keys : ndarray (N, K, 3) of int
        Tables, by place of their field in the list, by angle, and by the number of the size.
    shares : ndarray (N, K)
        Shares of the tables; sum 1.
    axis : ndarray (N, 2)
        Direction of the PSFs' x axis.
    """

    keys: np.ndarray
    shares: np.ndarray
    axis: np.ndarray


def mixture(places: Places, squares: Squares, bins: int, turns: int = 1) -> Mixture:
    """Mix fields as the exact model does, and, by cubics (Lagrange), angles where PSFs are turned.

    Tables are the same again after `turns` quarters of a turn.
    """
    fields, weights, cos, sin = places.blends(*squares.real_um.T)
    angle = np.arctan2(sin, cos) / (np.pi / 2) % float(turns) * bins
    before = np.floor(angle)
    four = (before.astype(int)[:, None] + np.arange(-1, 3)) % (turns * bins)
    t = angle - before
    near = np.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ],
        axis=1,
    )
    size = np.unique(squares.size_um, return_inverse=True)[1]
    parts = len(fields), fields.shape[1], 4
    keys = np.stack(
        [
            np.broadcast_to(fields[:, :, None], parts),
            np.broadcast_to(four[:, None], parts),
            np.broadcast_to(size[:, None, None], parts),
        ],
        axis=-1,
    ).reshape(len(fields), -1, 3)
    shares = (weights[:, :, None] * near[:, None]).reshape(len(fields), -1)
    # What counts comes first; where a square needs fewer tables, nothing of its first once more.
    none = shares == 0
    order = np.argsort(none, axis=1, kind="stable")
    keys = np.take_along_axis(keys, order[..., None], axis=1)
    shares = np.take_along_axis(shares, order, axis=1)
    most = int((~none).sum(axis=1).max())
    keys = np.where(shares[..., None] == 0, keys[:, :1], keys)
    return Mixture(keys[:, :most], shares[:, :most], np.stack([cos, sin], axis=1))


def turned(slopes: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return slopes (N, 2, 2) in the frames whose x axis is `axis` (N, 2)."""
    frame = np.stack([axis, np.stack([-axis[:, 1], axis[:, 0]], axis=1)], axis=1)
    return frame @ slopes @ frame.swapaxes(1, 2)


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the keys (T, 3) that occur among (N, K, 3), in order, and where each is (N, K)."""
    used, where = np.unique(keys.reshape(-1, 3), axis=0, return_inverse=True)
    return used, where.reshape(keys.shape[:2])
