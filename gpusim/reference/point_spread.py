"""What a source point spreads over the sensor: H of the exact model.

    H_cm(t; s) = sum_k sum_l R[c, m, l, k] K(s, l) h_l(t - (x_c(s, k) - x_ref(s)); s)
    R[c, m, l, k] = q_c(k) L_m(k) Omega(k) T(k) (lambda_k / hc) d lambda_k  S_l(lambda_k)

R in electrons/s per unit area of an aperture, by channel, scene spectrum, wavelength l of the bank
and sample k of the spectra. S_l are the cubic splines in 1 / lambda that are 1 at one wavelength of
the bank and 0 at the others: by them go the PSF about its own chief ray, the chief ray x_c, and
Omega T. With a sensor whose quantum efficiency goes with the angle of the light, q goes with the
field and the azimuth of s (`gpusim.reference.angle`), and with l.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import scipy.fft
from scipy.interpolate import CubicSpline
from scipy.ndimage import shift, spline_filter
from scipy.sparse import csr_array

from gpusim.reference.angle import NODES, MeanQe
from gpusim.reference.fields import Grid, Heights
from gpusim.reference.quadrature import Zone

H_J_S = 6.62607015e-34
C_M_S = 299792458.0
PAD = 32  # samples around the bank's PSFs, room for their shifts
KERNEL_PAD = 16  # samples around a zone: splines forget where they end by 0.43 a sample
# With banks of 256 samples and 13 wavelengths, kernels take 0.04 MiB, and one in three 0.8 MiB;
# fields take 10 MiB. Probes come by height. Each needs four or five heights, or 16 fields of a
# grid.
KEPT_KERNELS, KEPT_HEIGHTS, KEPT_FIELDS = 600, 10, 24
KEPT_LAMPS = 48  # of 6 MiB each, with three filters and three spectra
KEPT_DENSITIES = 24  # of 0.8 MiB: what the zones of one probe share
TOGETHER = 8192  # points of a sparse matrix: some MiB, which stay in the processor's cache
SPLINE_PAD = 4  # samples around PSFs, in which their splines come down to zero
DEGREE = 5  # of splines under highlights: see DEGREES in `gpusim.reference.exact_model`


def _quantum_efficiency(sensor: Any, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return q (K, C): a channel's table times what filters pass, straight between values."""
    table = sensor.quantum_efficiency
    curves = np.array([table.channels[name] for name in sensor.channels])
    found = np.stack([np.interp(wavelengths_nm, table.wavelengths_nm, one) for one in curves])
    for one in sensor.filters:
        found = found * np.interp(wavelengths_nm, one.wavelengths_nm, one.transmission)
    return found.T


class PointSpread:
    """H of one camera and scene.

    Parameters
    ----------
    bank : gpusim.psf.bank.Bank or gpusim.psf.plane_bank.PlaneBank
    sensor : gpusim.sensor.sensor.Sensor
    fields : Heights or Grid
        Fields of the bank.
    spectra : ndarray (M, K)
        Spectral radiance of each scene spectrum, W m^-2 sr^-1 nm^-1.
    wavelengths_nm : ndarray (K,)
        Wavelengths of the spectra.
    aperture_um : float, optional
        Side of a square over which `at` and `wide` average, by a Gaussian of the same variance,
        aperture^2 / 12. A wave as long as four sides passes square and Gaussian by 0.9003, 0.9023.
    """

    def __init__(
        self,
        bank: Any,
        sensor: Any,
        fields: Heights | Grid,
        spectra: np.ndarray,
        wavelengths_nm: np.ndarray,
        aperture_um: float = 0.0,
    ) -> None:
        self.bank, self.fields = bank, fields
        self.sigma = aperture_um / np.sqrt(12) / bank.pitch_um
        self.kept_fields = KEPT_HEIGHTS if isinstance(fields, Heights) else KEPT_FIELDS
        self.spectra, self.wavelengths_nm = spectra, wavelengths_nm
        self.mean_qe = None
        if sensor.eqe_map is not None:
            self.mean_qe = MeanQe(bank, sensor, wavelengths_nm)
        else:
            self.qe = _quantum_efficiency(sensor, wavelengths_nm)[None]
        self.splines = _line_splines(bank, wavelengths_nm)
        steradian = (bank.projected_solid_angle_sr * bank.transmission) @ self.splines
        photons = wavelengths_nm * 1e-9 / (H_J_S * C_M_S)
        of_samples = np.trapezoid(np.eye(len(wavelengths_nm)), wavelengths_nm)
        # Per um^2 of aperture.
        self.even = self.splines * steradian * photons * of_samples * 1e-12
        self.qe_there: dict[tuple[int, int], np.ndarray] = {}
        self.weights_there: dict[tuple[int, int], np.ndarray] = {}
        self.lights: dict[int, tuple[np.ndarray, np.ndarray | None, np.ndarray | None]] = {}
        self.densities: dict[tuple[int, int, int, int], np.ndarray] = {}
        self.kernels: dict[tuple[int, int, int, int, Zone], np.ndarray] = {}
        self.lamps: dict[tuple[int, int], np.ndarray] = {}
        self.wide_splines: tuple[np.ndarray, set[int]] | None = None

    def _qe_at(self, field: int, node: int) -> np.ndarray:
        """Return q (L or 1, K, C) at a field of the bank and one of NODES azimuths."""
        if self.mean_qe is None:
            return self.qe
        found = self.qe_there.get((field, node))
        if found is None:
            found = self.qe_there[field, node] = self.mean_qe.mean(field, node)
        return found

    def _rates(self, channel: int, spectrum: int, field: int, node: int) -> np.ndarray:
        """Return R (L, K) of a channel and spectrum at a field of the bank and an azimuth."""
        return self._qe_at(field, node)[..., channel] * self.spectra[spectrum] * self.even

    def _weights_at(self, field: int, node: int) -> np.ndarray:
        """Return the sums of R over the samples (C, M, L) at a field of the bank and an azimuth."""
        key = (field, node) if self.mean_qe is not None else (0, 0)
        found = self.weights_there.get(key)
        if found is None:
            per_photon = self._qe_at(field, node) * self.even[..., None]
            found = np.einsum("lkc,mk->cml", per_photon, self.spectra)
            self.weights_there[key] = found
        return found

    def _seen_from(self, side: int, node: int) -> int:
        """Return the azimuth of a field that is seen at one, from this side or beyond the axis."""
        turns = self.mean_qe is not None and self.mean_qe.turns
        return (node + NODES // 2) % NODES if turns and side < 0 else node

    def _nodes(self, source: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the azimuths whose weights source points (P, 2) need, with the share (P,) of each.

        Cubic between them (Lagrange, four nodes).
        """
        if self.mean_qe is None or not self.mean_qe.turns:
            yield 0, np.ones(len(source))
            return
        place = np.arctan2(*self.fields.axes(source).T[::-1]) % (2 * np.pi) / (2 * np.pi) * NODES
        before = np.floor(place).astype(int)
        t = place - before
        shares = {
            -1: -t * (t - 1) * (t - 2) / 6,
            0: (t + 1) * (t - 1) * (t - 2) / 2,
            1: -(t + 1) * t * (t - 2) / 2,
            2: (t + 1) * t * (t - 1) / 6,
        }
        for node in np.unique(np.add.outer(before, list(shares)) % NODES):
            share = np.zeros(len(t))
            for step, of_step in shares.items():
                share += np.where((before + step) % NODES == node, of_step, 0.0)
            yield int(node), share

    def _light(self, field: int) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Return what all kernels of one bank field are made of.

        Its PSFs (L, n, n) with illumination, per um^2. If chief rays move with the wavelength: the
        spectra of these, along x, or along both where they move in y too; and what each sample of
        the spectra turns at each frequency along x (61, n / 2 + 1), and along y (61, n).
        """
        found = self.lights.get(field)
        if found is None:
            pitch, n = self.bank.pitch_um, self.bank.psf.shape[-1] + 2 * PAD
            images, shifts = np.zeros((len(self.splines), n, n)), []
            for place, image in enumerate(images):
                psf, illumination, shift = self.fields.light(field, place)
                image[PAD:-PAD, PAD:-PAD] = psf * np.float64(illumination / pitch**2)
                shifts.append(shift)
            found = images, None, None
            if np.any(shifts):
                x, y = np.transpose(shifts) @ self.splines
                spectra = scipy.fft.rfft(images)
                across = np.exp(-2j * np.pi * np.outer(x, scipy.fft.rfftfreq(n, pitch)))
                down = None
                if y.any():
                    spectra = scipy.fft.fft(spectra, axis=1)
                    down = np.exp(-2j * np.pi * np.outer(y, scipy.fft.fftfreq(n, pitch)))
                found = spectra, across, down
            _keep(self.lights, field, found, self.kept_fields)
        return found

    def _kernel(self, channel: int, spectrum: int, field: int, node: int, zone: Zone) -> np.ndarray:
        """Return spline coefficients of H at one bank field and azimuth, in its PSFs' frame.

        As far as a zone reaches, from the middle outwards.
        """
        key = (channel, spectrum, field, node, zone)
        kernel = self.kernels.get(key)
        if kernel is None:
            density = self._density(channel, spectrum, field, node)
            middle, half = len(density) // 2, self._half(zone)
            there = slice(middle - half, middle + half)
            kernel = spline_filter(density[there, there], order=zone.degree)
            _keep(self.kernels, key, kernel, KEPT_KERNELS)
        return kernel

    def _density(self, channel: int, spectrum: int, field: int, node: int) -> np.ndarray:
        """Return H (n, n) at one bank field and azimuth, in its PSFs' frame, with PAD around."""
        key = (channel, spectrum, field, node)
        density = self.densities.get(key)
        if density is None:
            rates = self._rates(channel, spectrum, field, node)
            images, across, down = self._light(field)
            if across is None:
                density = np.tensordot(rates.sum(axis=1), images, axes=1)
            else:
                if down is None:
                    moved = np.einsum("lx,lyx->yx", rates @ across, images)
                else:
                    moved = sum(
                        ((rate[:, None] * down).T @ across) * image
                        for rate, image in zip(rates, images, strict=True)
                    )
                    moved = scipy.fft.ifft(moved, axis=0)
                density = scipy.fft.irfft(moved, images.shape[1])
            _keep(self.densities, key, density, KEPT_DENSITIES)
        return density

    def _half(self, zone: Zone) -> int:
        """Return half the width of a zone's kernels, samples."""
        most = self.bank.psf.shape[-1] // 2 + PAD
        return min(int(zone.reach_um / self.bank.pitch_um) + KERNEL_PAD, most)

    def _turned(self, t: np.ndarray, source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return t (P, 2) from source points (P, 2) in the frame of their PSFs, x and y, um."""
        (t_x, t_y), (cos, sin) = t.T, self.fields.axes(source).T
        return t_x * cos + t_y * sin, t_y * cos - t_x * sin

    def around(
        self, zone: Zone, channel: int, spectra: Sequence[int], source: np.ndarray
    ) -> np.ndarray:
        """Return H (M, P) of spectra at a zone's t (P, 2) from source points (P, 2), per um^2."""
        side = 2 * self._half(zone)
        x, y = (at / self.bank.pitch_um for at in self._turned(zone.t, source))
        result = np.zeros((len(source), len(spectra)))
        nodes = list(self._nodes(source))
        seen: dict[int, list[tuple[int, int, np.ndarray]]] = {1: [], -1: []}
        for field, way, of_field in self.fields.shares(source):
            for here, of_node in nodes:
                if (share := of_field * of_node).any():
                    seen[way].append((field, self._seen_from(way, here), share))
        for way, parts in seen.items():
            if not parts:
                continue
            # All kernels side by side: a sparse matrix has for each point what it takes of each.
            kernels = np.stack(
                [
                    self._kernel(channel, spectrum, field, node, zone).ravel()
                    for field, node, _ in parts
                    for spectrum in spectra
                ],
                axis=-1,
            )
            for first in range(0, len(source), TOGETHER):
                part = slice(first, first + TOGETHER)
                there = (way * at[part] + side // 2 for at in (y, x))
                found = _between(*there, side, zone.degree, len(kernels)) @ kernels
                found = found.reshape(-1, len(parts), len(spectra))
                for number, (*_, share) in enumerate(parts):
                    result[part] += share[part, None] * found[:, number]
        return result.T

    def at(self, channel: int, excess: np.ndarray, t: np.ndarray, source: np.ndarray) -> np.ndarray:
        """Return H (..., P) of spectra (P, M) at t (..., P, 2) from source (P, 2).

        A shift of the samples by the lateral colour, as `_kernel` has it, rings far beyond the PSF,
        by 1e-10 of a highlight: more than the shadows next to the sun hold. Here each wavelength of
        the bank has its light at its own chief ray, sum_l (sum_k R[l, k]) K h_l(t - x_l): the
        splines between them are of the whole, not of PSF and chief ray apart.
        """
        x, y = np.moveaxis(t, -1, 0) / self.bank.pitch_um
        cos, sin = self.fields.axes(source).T
        x, y = x * cos + y * sin, y * cos - x * sin
        result = np.zeros(x.shape)
        nodes = list(self._nodes(source))
        seen: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {1: [], -1: []}
        for field, way, of_field in self.fields.shares(source):
            for here, of_node in nodes:
                if (share := of_field * of_node).any():
                    table = self._lamp(field, self._seen_from(way, here))[channel]
                    seen[way].append((table, share[:, None] * excess))
        rows, step = x.reshape(-1, len(source)), max(1, TOGETHER // max(len(source), 1))
        for way, parts in seen.items():
            if not parts:
                continue
            count = len(parts[0][0])
            side = math.isqrt(count)
            for first in range(0, len(rows), step):
                part = slice(first, first + step)
                there = (way * at.reshape(rows.shape)[part] + side // 2 for at in (y, x))
                taken = _between(*there, side, DEGREE, count)
                result.reshape(rows.shape)[part] += sum(
                    np.einsum("apm,pm->ap", (taken @ table).reshape(-1, *light.shape), light)
                    for table, light in parts
                )
        return result

    def wide(
        self, channel: int, excess: np.ndarray, t: np.ndarray, source: np.ndarray
    ) -> np.ndarray:
        """Return the same as `at`, of PSFs that are smooth, at t within them: all lines at once.

        Each PSF is moved by its lateral colour once, and has a spline of its own there. What a
        point needs of all fields and lines is one row of a sparse matrix.
        """
        fields, sides, shares = self.fields.near(source)
        table, side = self._wide_splines(np.unique(fields))
        x, y = (sides * at / self.bank.pitch_um + side // 2 for at in self._turned(t, source))
        taken = _between(y, x, side, 3, len(table), fields * side**2)
        taken.data *= np.repeat(shares.ravel(), 16)
        rows = taken @ table
        rows = rows.reshape(*fields.shape, -1)
        if self.mean_qe is None:
            return np.einsum("npl,pl->p", rows, excess @ self._weights_at(0, 0)[channel])
        result = np.zeros(len(t))
        nodes = list(self._nodes(source))
        for field, seen in {(f, s) for f, s in zip(fields.flat, sides.flat, strict=True)}:
            own = np.where(((fields == field) & (sides == seen))[..., None], rows, 0.0).sum(axis=0)
            for node, of_node in nodes:
                weights = self._weights_at(field, self._seen_from(seen, node))[channel]
                result += of_node * np.einsum("pl,pl->p", own, excess @ weights)
        return result

    def _wide_splines(self, fields: np.ndarray) -> tuple[np.ndarray, int]:
        """Return spline coefficients (all fields * n * n, L) of PSFs where they land, and n.

        Those of the given fields are there; per um^2, with illumination.
        """
        pitch, lines = self.bank.pitch_um, len(self.bank.wavelengths_nm)
        if self.wide_splines is None:
            count = math.prod(self.bank.psf.shape[:-3])
            half = self.bank.psf.shape[-1] // 2 + self._pad
            side = 2 * scipy.fft.next_fast_len(half, real=True)
            self.wide_splines = np.zeros((count, side, side, lines)), set()
        table, there = self.wide_splines
        side = table.shape[1]
        for field in set(fields.tolist()) - there:
            images, moves = np.zeros((lines, side, side)), []
            for line, image in enumerate(images):
                psf, illumination, shift = self.fields.light(field, line)
                around = side // 2 - len(psf) // 2
                image[around : around + len(psf), around : around + len(psf)] = psf
                image *= np.float64(illumination / pitch**2)
                moves.append(shift)
            x, y = np.array(moves).T / pitch
            spectra = scipy.fft.rfft2(images)
            across, down = scipy.fft.rfftfreq(side), scipy.fft.fftfreq(side)
            spectra *= (_moved(x, across) * self._averaged(across))[:, None]
            spectra *= (_moved(y, down) * self._averaged(down))[:, :, None]
            table[field] = np.moveaxis(scipy.fft.irfft2(spectra, (side, side)), 0, -1)
            there.add(field)
        return table.reshape(-1, lines), side

    def _averaged(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the transfer of the mean over the aperture, at frequencies in cycles a sample."""
        return np.exp(-2 * (np.pi * self.sigma * frequencies) ** 2)

    @cached_property
    def _pad(self) -> int:
        """Samples around PSFs: room for their splines, and for lateral colour."""
        most = max(
            np.abs(self.fields.light(field, line)[2]).max()
            for field in self.fields.used
            for line in range(len(self.bank.wavelengths_nm))
        )
        return SPLINE_PAD + math.ceil(most / self.bank.pitch_um)

    def _lamp(self, field: int, node: int) -> np.ndarray:
        """Return spline coefficients (C, n * n, M) of H at one bank field and azimuth, per um^2."""
        found = self.lamps.get((field, node))
        if found is None:
            pitch = self.bank.pitch_um
            weights = self._weights_at(field, node)
            side = self.bank.psf.shape[-1] + 2 * self._pad
            down, across = scipy.fft.fftfreq(side), scipy.fft.rfftfreq(side)
            averaged = np.multiply.outer(self._averaged(down), self._averaged(across))
            total = np.zeros((*weights.shape[:2], side, side))
            for line in range(len(self.bank.wavelengths_nm)):
                psf, illumination, (x, y) = self.fields.light(field, line)
                image = np.pad(psf * np.float64(illumination / pitch**2), self._pad)
                if self.sigma:
                    image = scipy.fft.irfft2(scipy.fft.rfft2(image) * averaged, image.shape)
                if x or y:
                    image = shift(image, (y / pitch, x / pitch), order=DEGREE)
                total += weights[..., line, None, None] * image
            splines = [[spline_filter(one, order=DEGREE) for one in row] for row in total]
            found = np.moveaxis(np.reshape(splines, (*weights.shape[:2], -1)), 1, -1)
            found = np.ascontiguousarray(found)
            _keep(self.lamps, (field, node), found, KEPT_LAMPS)
        return found


def spreads_of(
    sensor: Any,
    spectra: np.ndarray,
    wavelengths_nm: np.ndarray,
    first: tuple[Any, Heights | Grid],
    less: tuple[Any, Heights | Grid] | None,
    aperture_um: float = 0.0,
) -> list[tuple[float, PointSpread]]:
    """Return what a bank with its fields spreads, and with the sign of it what it has more."""
    return [
        (sign, PointSpread(bank, sensor, fields, spectra, wavelengths_nm, aperture_um))
        for sign, (bank, fields) in ((1.0, first), *(((-1.0, less),) if less else ()))
    ]


def _line_splines(bank: Any, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return S (L, 61) of the bank's wavelengths; beyond the first and last they stay as there.

    Not-a-knot; of three wavelengths the parabola, of two the straight line in 1 / lambda. A bank
    may ask for straight lines in lambda instead.
    """
    lines = np.asarray(bank.wavelengths_nm, np.float64)
    each = np.eye(len(lines))
    if bank.spectral_degree == 1 or len(lines) == 1:
        return np.stack([np.interp(wavelengths_nm, lines, row) for row in each])
    within = np.minimum(np.maximum(wavelengths_nm, lines[0]), lines[-1])
    return CubicSpline(1e3 / lines[::-1], each[::-1], bc_type="not-a-knot")(1e3 / within).T


def _between(
    y: np.ndarray,
    x: np.ndarray,
    side: int,
    degree: int,
    count: int,
    begin: np.ndarray | int = 0,
) -> csr_array:
    """Return the matrix (P, count) by which spline coefficients become values at points (...).

    Parameters
    ----------
    y, x : ndarray (...), P in all
        Rows and columns in squares of `side` coefficients each way, which end in nothing.
    side, degree, count : int
        Coefficients along a side, degree of the splines, and coefficients in all.
    begin : ndarray (...) of int
        Number of the first coefficient of the square.
    """
    places, weights = [], []
    for at in (y, x):
        first, of_taps = _taps(at, degree)
        there = np.clip(first, 0, side - degree - 1)
        places.append(there)
        weights.append(of_taps * (there == first)[..., None])
    taps = np.arange(degree + 1, dtype=np.int32)
    first = (begin + places[0] * side + places[1]).astype(np.int32)
    number = first[..., None, None] + (taps[:, None] * np.int32(side) + taps)
    data = weights[0][..., :, None] * weights[1][..., None, :]
    ends = np.arange(0, data.size + 1, (degree + 1) ** 2, dtype=np.int32)
    return csr_array((data.ravel(), number.ravel(), ends), shape=(first.size, count))


def _taps(at: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first coefficient around places (...), and the B-splines (..., degree + 1) there.

    The degree is odd. Cox and de Boor's recursion makes the splines: where t of a cell has passed,
    the k + 1 splines of degree k are B_k,j = ((k - j + t) B_k-1,j-1 + (j + 1 - t) B_k-1,j) / k.
    """
    cell = np.floor(at)
    t = at - cell
    splines = [np.ones_like(t)]
    for k in range(1, degree + 1):
        below = [0.0, *splines, 0.0]
        splines = [((k - j + t) * below[j] + (j + 1 - t) * below[j + 1]) / k for j in range(k + 1)]
    return cell.astype(np.int32) - degree // 2, np.stack(splines, axis=-1)


def _moved(ways: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return by what transforms (L, F) of samples become those of splines moved by so many samples.

    Frequencies in cycles a sample. The samples of a cubic spline with coefficients of transform C
    have C (4 + 2 cos w) / 6; moved, those of the B-splines around in place of 1/6, 4/6, 1/6.
    """
    turn = np.exp(-2j * np.pi * frequencies)
    of_samples = (4 + 2 * turn.real) / 6
    first, weights = _taps(-ways, 3)
    numbers = -(first[:, None] + np.arange(4))
    moved = np.einsum("lt,ltf->lf", weights, turn ** numbers[..., None])
    return np.where(ways[:, None] == 0, of_samples, moved) / of_samples**2


def _keep(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Put a value into a store of at most so many, in place of the oldest."""
    # Probes run in threads: another may make room, or this very value, at the same time.
    for oldest in list(store)[: max(0, len(store) - most + 1)]:
        store.pop(oldest, None)
    store[key] = value
