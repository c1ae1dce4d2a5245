"""What a source point spreads over the sensor: H of the truth model.

    H_cm(t; s) = sum_l W[c, m, l] K(s, l) h_l(t - (x_l(s) - x_ref(s)); s)

W in electrons/s per unit area of an aperture, by channel, scene spectrum and wavelength of the
bank. Of a sensor whose quantum efficiency goes with the angle of the light, W goes with the field
and the azimuth of s (`gpusim.reference.angle`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import scipy.fft
from scipy.ndimage import map_coordinates, spline_filter

from gpusim.reference.angle import NODES, MeanQe
from gpusim.reference.fields import Grid, Heights
from gpusim.reference.quadrature import Zone

H_J_S = 6.62607015e-34
C_M_S = 299792458.0
PAD = 32  # samples around the bank's PSFs, room for their shifts
KERNEL_PAD = 16  # samples around a zone: splines forget where they end by 0.43 a sample
# Of banks of 256 samples and 13 wavelengths: kernels of 0.04 MiB, and one in three of 0.8 MiB;
# fields of 10 MiB. Probes come by height, and each needs two or three heights.
KEPT_KERNELS, KEPT_FIELDS = 600, 8
SPLINE_PAD = 4  # samples around PSFs, in which their splines come down to zero


class PointSpread:
    """H of one camera and scene.

    Parameters
    ----------
    bank : gpusim.lens.bank.Bank or gpusim.lens.plane_bank.PlaneBank
    sensor : gpusim.sensor.sensor.Sensor
    fields : Heights or Grid
        Of the bank.
    spectra : ndarray (M, 61)
        Spectral radiance of each scene spectrum, W m^-2 sr^-1 nm^-1.
    wavelengths_nm : ndarray (61,)
        Of the spectra and of the sensor's quantum efficiency.
    """

    def __init__(
        self,
        bank: Any,
        sensor: Any,
        fields: Heights | Grid,
        spectra: np.ndarray,
        wavelengths_nm: np.ndarray,
    ) -> None:
        self.bank, self.fields = bank, fields
        self.spectra, self.wavelengths_nm = spectra, wavelengths_nm
        self.mean_qe = None
        if sensor.eqe_map is not None:
            self.mean_qe = MeanQe(bank, sensor, wavelengths_nm)
        else:
            qe = np.stack([sensor.qe[name] for name in sensor.channels])
            self.weights = self._weights([qe] * len(bank.wavelengths_nm))
        self.weights_there: dict[tuple[int, int], np.ndarray] = {}
        self.shifted: dict[int, np.ndarray] = {}
        self.kernels: dict[tuple[int, int, int, int, Zone], np.ndarray] = {}
        self.psf_splines: dict[int, np.ndarray] = {}

    def _weights(self, qe: Sequence[np.ndarray]) -> np.ndarray:
        """Return W (C, M, L): electrons/s per unit area of an aperture.

        Of quantum efficiencies (C, 61), one for each wavelength of the bank.
        """
        bank, spectra, wavelengths_nm = self.bank, self.spectra, self.wavelengths_nm
        energy_j = H_J_S * C_M_S / (wavelengths_nm * 1e-9)
        steradian = np.interp(
            wavelengths_nm, bank.wavelengths_nm, bank.projected_solid_angle_sr * bank.transmission
        )
        weights = np.empty((len(qe[0]), len(spectra), len(bank.wavelengths_nm)))
        for place in range(len(bank.wavelengths_nm)):
            tent = np.interp(
                wavelengths_nm, bank.wavelengths_nm, np.eye(len(bank.wavelengths_nm))[place]
            )
            integrand = qe[place][:, None] * spectra * tent * steradian / energy_j
            weights[..., place] = np.trapezoid(integrand, wavelengths_nm, axis=-1)
        return weights * 1e-12  # per um^2 of aperture

    def _weights_at(self, field: int, node: int) -> np.ndarray:
        """Return W (C, M, L) at a field of the bank and one of NODES azimuths."""
        if self.mean_qe is None:
            return self.weights
        found = self.weights_there.get((field, node))
        if found is None:
            qe = self.mean_qe.mean(field, node)
            found = self.weights_there[field, node] = self._weights(qe.swapaxes(1, 2))
        return found

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

    def _shifted(self, field: int) -> np.ndarray:
        """Return the PSFs (L, n, n) of one bank field, with lateral colour and illumination."""
        images = self.shifted.get(field)
        if images is None:
            bank = self.bank
            n = bank.psf.shape[-1] + 2 * PAD
            images = np.zeros((len(bank.wavelengths_nm), n, n))
            frequency = scipy.fft.rfftfreq(n, bank.pitch_um)
            for place, image in enumerate(images):
                psf, illumination, shift = self.fields.light(field, place)
                image[PAD:-PAD, PAD:-PAD] = psf * np.float64(illumination / bank.pitch_um**2)
                for axis, along in ((1, shift[0]), (0, shift[1])):
                    if along:
                        turns = np.exp(-2j * np.pi * frequency * along)
                        turns = turns if axis else turns[:, None]
                        lines = scipy.fft.rfft(image, axis=axis) * turns
                        image[:] = scipy.fft.irfft(lines, n, axis=axis)
            _keep(self.shifted, field, images, KEPT_FIELDS)
        return images

    def _kernel(self, channel: int, spectrum: int, field: int, node: int, zone: Zone) -> np.ndarray:
        """Return spline coefficients of H at one bank field and azimuth, in its PSFs' frame.

        As far as a zone reaches, from the middle outwards.
        """
        key = (channel, spectrum, field, node, zone)
        kernel = self.kernels.get(key)
        if kernel is None:
            weights = self._weights_at(field, node)[channel, spectrum]
            images = self._shifted(field)
            middle, half = images.shape[-1] // 2, self._half(zone)
            there = slice(middle - half, middle + half)
            density = np.tensordot(weights, images[:, there, there], axes=1)
            kernel = spline_filter(density, order=zone.degree)
            _keep(self.kernels, key, kernel, KEPT_KERNELS)
        return kernel

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
        half = self._half(zone)
        x, y = (at / self.bank.pitch_um + half for at in self._turned(zone.t, source))
        result = np.zeros((len(spectra), len(source)))
        nodes = list(self._nodes(source))
        for field, of_field in self.fields.shares(source):
            for node, of_node in nodes:
                share = of_field * of_node
                used = np.flatnonzero(share)
                if not len(used):
                    continue
                share, where = share[used], np.stack([y[used], x[used]])
                for one, spectrum in zip(result, spectra, strict=True):
                    kernel = self._kernel(channel, spectrum, field, node, zone)
                    one[used] += share * map_coordinates(
                        kernel, where, order=zone.degree, prefilter=False, mode="constant"
                    )
        return result

    def at(self, channel: int, excess: np.ndarray, t: np.ndarray, source: np.ndarray) -> np.ndarray:
        """Return H of spectra (P, M) at t from source (P,): no blend of wavelengths is resampled.

        A shift of the samples by the lateral colour, as `_shifted` has it, rings far beyond the
        PSF, by 1e-10 of a highlight: more than the shadows next to the sun hold.
        """
        pitch, half = self.bank.pitch_um, self.bank.psf.shape[-1] // 2 + SPLINE_PAD
        x, y = self._turned(t, source)
        result = np.zeros(len(t))
        nodes = list(self._nodes(source))
        for field, share in self.fields.shares(source):
            used = share > 0
            if not used.any():
                continue
            light = sum(
                of_node[used, None] * (excess[used] @ self._weights_at(field, node)[channel])
                for node, of_node in nodes
            )
            for place, spline in enumerate(self._psf_splines(field)):
                _, illumination, shift = self.fields.light(field, place)
                where = [(y[used] - shift[1]) / pitch + half, (x[used] - shift[0]) / pitch + half]
                result[used] += (share[used] * light[:, place] * illumination / pitch**2) * (
                    map_coordinates(spline, where, order=3, prefilter=False, mode="constant")
                )
        return result

    def _psf_splines(self, field: int) -> np.ndarray:
        """Return the spline coefficients (L, n, n) of one field's PSFs, each on its own."""
        if field not in self.psf_splines:
            self.psf_splines[field] = np.stack(
                [
                    spline_filter(
                        np.pad(self.fields.light(field, place)[0].astype(np.float64), SPLINE_PAD),
                        order=3,
                    )
                    for place in range(len(self.bank.wavelengths_nm))
                ]
            )
        return self.psf_splines[field]


def _keep(store: dict[Any, Any], key: Any, value: Any, most: int) -> None:
    """Put a value into a store of at most so many, in place of the oldest."""
    # Probes run in threads: another may make room, or this very value, at the same time.
    for oldest in list(store)[: max(0, len(store) - most + 1)]:
        store.pop(oldest, None)
    store[key] = value
