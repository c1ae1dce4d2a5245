"""What a source point spreads over the sensor: H of the exact model.

    H_cm(t; s) = sum_k sum_l R[c, m, l, k] K(s, l) h_l(t - (x_c(s, k) - x_ref(s)); s)

with R in electrons/s per unit area of an aperture, by channel, scene spectrum, wavelength l of the
bank and sample k of the spectra (`gpusim.reference.rates`), and K of the fields.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft
from scipy.ndimage import spline_filter

from gpusim.reference.b_splines import TOGETHER, between, moved, moved_by
from gpusim.reference.fields import Grid, Heights, lateral_um
from gpusim.reference.quadrature import Zone
from gpusim.reference.rates import Rates

PAD = 32  # samples around the bank's PSFs, at least: room for their shifts, and what these ring
KERNEL_PAD = 16  # samples around a zone: splines forget where they end by 0.43 a sample
# With banks of 256 samples and 13 wavelengths, kernels take 0.04 MiB, and one in three 0.8 MiB;
# fields take 10 MiB. Probes come by height. Each needs four or five heights, or 16 fields of a
# grid.
KEPT_KERNELS, KEPT_HEIGHTS, KEPT_FIELDS = 600, 10, 24
KEPT_LAMPS = 48  # of 6 MiB each, with three filters and three spectra
# Of 0.8 MiB: what the zones of a probe share, and probes beside it: four heights' for three filters
# and three spectra on each of two threads.
KEPT_DENSITIES = 72
SPLINE_PAD = 4  # samples around PSFs, in which their splines come down to zero
DEGREE = 5  # of splines under highlights: see DEGREES in `gpusim.reference.exact_model`


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
        *,
        aperture_um: float = 0.0,
    ) -> None:
        self.bank, self.fields = bank, fields
        self.sigma = aperture_um / np.sqrt(12) / bank.pitch_um
        moved = math.ceil(lateral_um(fields) / bank.pitch_um)  # samples, at most
        self.pad, self.spline_pad = max(PAD, moved + KERNEL_PAD), moved + SPLINE_PAD
        self.kept_fields = KEPT_HEIGHTS if isinstance(fields, Heights) else KEPT_FIELDS
        self.rates = Rates(bank, sensor, fields, spectra, wavelengths_nm)
        self.lights: dict[int, tuple[np.ndarray, np.ndarray | None, np.ndarray | None]] = {}
        self.densities: dict[tuple[int, int, int, int], np.ndarray] = {}
        self.kernels: dict[tuple[int, int, int, int, Zone], np.ndarray] = {}
        self.lamps: dict[tuple[int, int], np.ndarray] = {}
        self.wide_splines: tuple[np.ndarray, set[int]] | None = None

    def _light(self, field: int) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Return what all kernels of one bank field are made of.

        Its PSFs (L, n, n) with illumination, per um^2. If chief rays move with the wavelength: the
        spectra of these, along x, or along both where they move in y too; and what each sample of
        the spectra turns at each frequency along x (61, n / 2 + 1), and along y (61, n).
        """
        found = self.lights.get(field)
        if found is None:
            pitch, n = self.bank.pitch_um, self.bank.psf.shape[-1] + 2 * self.pad
            images, shifts = np.zeros((len(self.rates.splines), n, n)), []
            for place, image in enumerate(images):
                psf, illumination, shift = self.fields.light(field, place)
                image[self.pad : -self.pad, self.pad : -self.pad] = psf * np.float64(
                    illumination / pitch**2
                )
                shifts.append(shift)
            found = images, None, None
            if np.any(shifts):
                x, y = np.transpose(shifts) @ self.rates.splines
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
        """Return H (n, n) at one bank field and azimuth, in its PSFs' frame, padded."""
        key = (channel, spectrum, field, node)
        density = self.densities.get(key)
        if density is None:
            rates = self.rates.at(channel, spectrum, field, node)
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
        most = self.bank.psf.shape[-1] // 2 + self.pad
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
        nodes = list(self.rates.nodes(source))
        seen: dict[int, list[tuple[int, int, np.ndarray]]] = {1: [], -1: []}
        for field, way, of_field in self.fields.shares(source):
            for here, of_node in nodes:
                if (share := of_field * of_node).any():
                    seen[way].append((field, self.rates.seen_from(way, here), share))
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
            shares = np.stack([share for *_, share in parts])
            if (shares == shares[:, :1]).all():  # one place for all points: its fields are mixed
                mixed = kernels.reshape(len(kernels), len(parts), -1)
                kernels, shares = shares[:, 0] @ mixed, np.ones((1, len(source)))
            for first in range(0, len(source), TOGETHER):
                part = slice(first, first + TOGETHER)
                there = (way * at[part] + side // 2 for at in (y, x))
                found = between(*there, side=side, degree=zone.degree, count=len(kernels)) @ kernels
                found = found.reshape(-1, len(shares), len(spectra))
                for number, share in enumerate(shares):
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
        nodes = list(self.rates.nodes(source))
        seen: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {1: [], -1: []}
        for field, way, of_field in self.fields.shares(source):
            for here, of_node in nodes:
                if (share := of_field * of_node).any():
                    table = self._lamp(field, self.rates.seen_from(way, here))[channel]
                    seen[way].append((table, share[:, None] * excess))
        rows, step = x.reshape(-1, len(source)), max(1, TOGETHER // max(len(source), 1))
        for way, parts in seen.items():
            if not parts:
                continue
            tables, light = (np.concatenate(one, axis=1) for one in zip(*parts, strict=True))
            side = math.isqrt(len(tables))
            for first in range(0, len(rows), step):
                part = slice(first, first + step)
                there = (way * at.reshape(rows.shape)[part] + side // 2 for at in (y, x))
                taken = between(*there, side=side, degree=DEGREE, count=len(tables)) @ tables
                found = np.einsum("apm,pm->ap", taken.reshape(-1, *light.shape), light)
                result.reshape(rows.shape)[part] += found
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
        taken = between(y, x, side=side, degree=3, count=len(table), begin=fields * side**2)
        taken.data *= np.repeat(shares.ravel(), 16)
        rows = taken @ table
        rows = rows.reshape(*fields.shape, -1)
        if self.rates.mean_qe is None:
            return np.einsum("npl,pl->p", rows, excess @ self.rates.weights(0, 0)[channel])
        result = np.zeros(len(t))
        nodes = list(self.rates.nodes(source))
        for field, seen in {(f, s) for f, s in zip(fields.flat, sides.flat, strict=True)}:
            own = np.where(((fields == field) & (sides == seen))[..., None], rows, 0.0).sum(axis=0)
            for node, of_node in nodes:
                weights = self.rates.weights(field, self.rates.seen_from(seen, node))[channel]
                result += of_node * np.einsum("pl,pl->p", own, excess @ weights)
        return result

    def _wide_splines(self, fields: np.ndarray) -> tuple[np.ndarray, int]:
        """Return spline coefficients (all fields * n * n, L) of PSFs where they land, and n.

        Those of the given fields are there; per um^2, with illumination.
        """
        pitch, lines = self.bank.pitch_um, len(self.bank.wavelengths_nm)
        if self.wide_splines is None:
            count = math.prod(self.bank.psf.shape[:-3])
            half = self.bank.psf.shape[-1] // 2 + self.spline_pad
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
            spectra *= (moved_by(x, across) * self._averaged(across))[:, None]
            spectra *= (moved_by(y, down) * self._averaged(down))[:, :, None]
            table[field] = np.moveaxis(scipy.fft.irfft2(spectra, (side, side)), 0, -1)
            there.add(field)
        return table.reshape(-1, lines), side

    def _averaged(self, frequencies: np.ndarray) -> np.ndarray:
        """Return the transfer of the mean over the aperture, at frequencies in cycles a sample."""
        return np.exp(-2 * (np.pi * self.sigma * frequencies) ** 2)

    def _lamp(self, field: int, node: int) -> np.ndarray:
        """Return spline coefficients (C, n * n, M) of H at one bank field and azimuth, per um^2."""
        found = self.lamps.get((field, node))
        if found is None:
            pitch = self.bank.pitch_um
            weights = self.rates.weights(field, node)
            side = self.bank.psf.shape[-1] + 2 * self.spline_pad
            down, across = scipy.fft.fftfreq(side), scipy.fft.rfftfreq(side)
            averaged = np.multiply.outer(self._averaged(down), self._averaged(across))
            total = np.zeros((*weights.shape[:2], side, side))
            for line in range(len(self.bank.wavelengths_nm)):
                psf, illumination, (x, y) = self.fields.light(field, line)
                image = np.pad(psf * np.float64(illumination / pitch**2), self.spline_pad)
                if self.sigma:
                    image = scipy.fft.irfft2(scipy.fft.rfft2(image) * averaged, image.shape)
                image = moved(image, (y / pitch, x / pitch), DEGREE)
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
    *,
    aperture_um: float = 0.0,
) -> list[tuple[float, PointSpread]]:
    """Return what a bank with its fields spreads, and with the sign of it what it has more."""
    return [
        (sign, PointSpread(bank, sensor, fields, spectra, wavelengths_nm, aperture_um=aperture_um))
        for sign, (bank, fields) in ((1.0, first), *(((-1.0, less),) if less else ()))
    ]


def _keep(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Put a value into a store of at most so many, in place of the oldest."""
    # Probes run in threads: another may make room, or this very value, at the same time.
    for oldest in list(store)[: max(0, len(store) - most + 1)]:
        store.pop(oldest, None)
    store[key] = value
