"""R of the exact model: electrons/s per unit area of an aperture, of what a source point radiates.

    R[c, m, l, k] = q_c(k) L_m(k) Omega(k) T(k) (lambda_k / hc) d lambda_k  S_l(lambda_k)

by channel, scene spectrum, wavelength l of the bank and sample k of the spectra. S_l are the cubic
splines in 1 / lambda that are 1 at one wavelength of the bank and 0 at the others: by them go the
PSF about its own chief ray, the chief ray x_c, and Omega T. With a sensor whose quantum efficiency
goes with the angle of the light, q goes with the field and the azimuth of the source
(`gpusim.reference.angle`), and with l.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from gpusim.reference.angle import NODES, MeanQe
from gpusim.reference.fields import Grid, Heights

H_J_S = 6.62607015e-34
C_M_S = 299792458.0


class Rates:
    """R of one camera and scene.

    Parameters
    ----------
    bank, sensor, fields, spectra, wavelengths_nm
        As for `gpusim.reference.point_spread.PointSpread`.
    """

    def __init__(
        self,
        bank: Any,
        sensor: Any,
        fields: Heights | Grid,
        spectra: np.ndarray,
        wavelengths_nm: np.ndarray,
    ) -> None:
        self.fields, self.spectra = fields, spectra
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

    def _qe_at(self, field: int, node: int) -> np.ndarray:
        """Return q (L or 1, K, C) at a field of the bank and one of NODES azimuths."""
        if self.mean_qe is None:
            return self.qe
        found = self.qe_there.get((field, node))
        if found is None:
            found = self.qe_there[field, node] = self.mean_qe.mean(field, node)
        return found

    def at(self, channel: int, spectrum: int, field: int, node: int) -> np.ndarray:
        """Return R (L, K) of a channel and spectrum at a field of the bank and an azimuth."""
        return self._qe_at(field, node)[..., channel] * self.spectra[spectrum] * self.even

    def weights(self, field: int, node: int) -> np.ndarray:
        """Return the sums of R over the samples (C, M, L) at a field of the bank and an azimuth."""
        key = (field, node) if self.mean_qe is not None else (0, 0)
        found = self.weights_there.get(key)
        if found is None:
            per_photon = self._qe_at(field, node) * self.even[..., None]
            found = np.tensordot(per_photon, self.spectra, (1, 1)).transpose(1, 2, 0)
            self.weights_there[key] = found
        return found

    def seen_from(self, side: int, node: int) -> int:
        """Return the azimuth of a field that is seen at one, from this side or beyond the axis."""
        turns = self.mean_qe is not None and self.mean_qe.turns
        return (node + NODES // 2) % NODES if turns and side < 0 else node

    def nodes(self, source: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
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


def _quantum_efficiency(sensor: Any, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return q (K, C): a channel's table times what filters pass, straight between values."""
    table = sensor.quantum_efficiency
    curves = np.array([table.channels[name] for name in sensor.channels])
    found = np.stack([np.interp(wavelengths_nm, table.wavelengths_nm, one) for one in curves])
    for one in sensor.filters:
        found = found * np.interp(wavelengths_nm, one.wavelengths_nm, one.transmission)
    return found.T


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
