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
        self.table = np.moveaxis(over, 0, -2)  # (thetas, phis, K, C)
        turns = len(phi) > 2 and np.ptp(cubes, axis=2).max() > 0
        self.turns = bool(turns) and not hasattr(bank, "field_x_deg")

    def mean(self, field: int, node: int) -> np.ndarray:
        """Return q (L, K, C) of a field at the azimuth 2 pi node / NODES."""
        place, _, cone = self.bank.rays(field)
        turn = 2 * np.pi * node / NODES
        inwards = np.zeros(2)
        height = np.hypot(*place)
        if self.micro_lens is not None and height > 0:
            angle = np.interp(
                height / 1e3, self.micro_lens.heights_mm, self.micro_lens.chief_ray_deg
            )
            inwards = -np.sin(np.deg2rad(angle)) * place / height
        found = []
        for rays in cone.astype(np.float64):
            rays = rays[rays[:, 2] > 0]
            direction = (rays[:, 0] + inwards[0]) + 1j * (rays[:, 1] + inwards[1])
            direction = direction * np.exp(1j * turn)
            # Farther out than the map only beyond the sensor: there it goes on as it ends.
            theta = np.rad2deg(np.arcsin(np.minimum(np.abs(direction), 1)))
            theta = np.minimum(theta, self.theta[-1])
            phi = (np.rad2deg(np.angle(direction)) - self.phi[0]) % 360.0 + self.phi[0]
            found.append(self._on_map(theta, phi, rays[:, 2]))
        return np.tensordot(np.stack(found), self.table, axes=2)

    def _on_map(self, theta: np.ndarray, phi: np.ndarray, share: np.ndarray) -> np.ndarray:
        """Return shares of rays (R,) laid on the map's angles (thetas, phis), bilinearly.

        The mean over rays is then one sum over the map, however many rays and wavelengths.
        """
        shape = len(self.theta), len(self.phi)
        laid = np.zeros(math.prod(shape))
        for i, of_theta in _around(self.theta, theta):
            for j, of_phi in _around(self.phi, phi):
                at = np.ravel_multi_index((i, j), shape)
                laid += np.bincount(at, share * of_theta * of_phi, laid.size)
        return laid.reshape(shape)


def _around(grid: np.ndarray, at: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the values of a grid below and above places: their indices, and each one's weight."""
    low = np.clip(np.searchsorted(grid, at, side="right") - 1, 0, len(grid) - 2)
    weight = (at - grid[low]) / (grid[low + 1] - grid[low])
    return [(low, 1 - weight), (low + 1, weight)]
