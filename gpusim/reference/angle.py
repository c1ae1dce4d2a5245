"""Quantum efficiency averaged over the light that arrives, ray by ray in float64.

    q_c(lambda; f, l, psi) = sum over rays d of s_d EQE_c(lambda, theta_d, phi_d)

with the rays of field f and bank wavelength l turned to the azimuth psi of the image point, after
the sine of the micro-lenses' angle is taken off, towards the axis. EQE is trilinear in the map.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.interpolate import RegularGridInterpolator

NODES = 72  # azimuths around; between them whatever is made of q is cubic


class MeanQe:
    """Mean quantum efficiency of a sensor behind a lens.

    Parameters
    ----------
    bank : gpusim.psf.bank.Bank or gpusim.psf.plane_bank.PlaneBank
    sensor : gpusim.sensor.sensor.Sensor
        With ``eqe_map``.
    wavelengths_nm : ndarray (K,)
    """

    def __init__(self, bank: Any, sensor: Any, wavelengths_nm: np.ndarray) -> None:
        self.bank, self.micro_lens = bank, sensor.micro_lens
        measured = sensor.eqe_map
        phi = np.array([*measured.phi_deg, measured.phi_deg[0] + 360.0])
        cubes = np.stack([measured.eqe(name) for name in sensor.channels], axis=-1)
        cubes = np.concatenate([cubes, cubes[:, :, :1]], axis=2)
        over = RegularGridInterpolator((measured.wavelengths_nm,), cubes)(wavelengths_nm)
        for one in sensor.filters:
            passed = np.interp(wavelengths_nm, one.wavelengths_nm, one.transmission)
            over = over * passed[:, None, None, None]
        # One theta stands for all, as far as the sensor's maker says.
        self.theta, self.phi = np.array(measured.theta_deg, float), phi
        self.table = np.ascontiguousarray(np.moveaxis(over, 0, -2))  # (thetas, phis, K, C)
        turns = len(phi) > 2 and np.ptp(cubes, axis=2).max() > 0
        self.rays: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}  # by field
        self.turns = bool(turns) and not hasattr(bank, "field_x_deg")

    def mean(self, field: int, node: int) -> np.ndarray:
        """Return q (L, K, C) of a field at the azimuth 2 pi node / NODES."""
        if field not in self.rays:
            self.rays[field] = self._arriving(field)
        theta, azimuth_deg, share = self.rays[field]
        turned = azimuth_deg + 360.0 * node / NODES
        phi = (turned - self.phi[0]) % 360.0 + self.phi[0]
        return np.tensordot(self._on_map(theta, phi, share), self.table, axes=2)

    def _arriving(self, field: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return angle and azimuth, degrees, and share of rays, each (L, R), of a field."""
        place, _, cone = self.bank.rays(field)
        inwards = np.zeros(2)
        height = np.hypot(*place)
        if self.micro_lens is not None and height > 0:
            angle = np.interp(
                height / 1e3, self.micro_lens.heights_mm, self.micro_lens.chief_ray_deg
            )
            inwards = -np.sin(np.deg2rad(angle)) * place / height
        x, y, share = np.moveaxis(cone.astype(np.float64), -1, 0)
        direction = x + inwards[0] + 1j * (y + inwards[1])
        # Farther out than the map only beyond the sensor: there it goes on as it ends.
        theta = np.rad2deg(np.arcsin(np.minimum(np.abs(direction), 1)))
        return np.minimum(theta, self.theta[-1]), np.rad2deg(np.angle(direction)), share

    def _on_map(self, theta: np.ndarray, phi: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return shares of rays (L, R) laid on the map's angles (L, thetas, phis), bilinearly.

        The mean over rays is then one sum over the map, however many rays and wavelengths.
        """
        shape = len(share), len(self.theta), len(self.phi)
        line, laid = np.arange(len(share))[:, None], np.zeros(math.prod(shape))
        for i, of_theta in _around(self.theta, theta):
            for j, of_phi in _around(self.phi, phi):
                at = np.ravel_multi_index((line, i, j), shape)
                weight = share * of_theta * of_phi
                laid += np.bincount(at.ravel(), weight.ravel(), laid.size)
        return laid.reshape(shape)


def _around(grid: np.ndarray, at: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the values of a grid below and above places: their indices, and each one's weight."""
    low = np.clip(np.searchsorted(grid, at, side="right") - 1, 0, len(grid) - 2)
    weight = (at - grid[low]) / (grid[low + 1] - grid[low])
    return [(low, 1 - weight), (low + 1, weight)]
