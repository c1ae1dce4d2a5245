"""Quantum efficiency by angle, averaged directly over a tracer's rays: no fold, no decomposition.

At a place of the picture a channel's electrons over the photons that arrive at a pixel are

    QE_c(x, y) = sum over l of N(l) <EQE_c(l, theta, phi)> / sum of N(l),

N the photons of a wavelength, < > the mean over direction cosines inside the pupil as seen from
the place, turned by the place's azimuth, less the sine for which micro-lenses are shifted.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor
from gpusim.validate.predict import Band, Predictor

H_J_S, C_M_S = 6.62607015e-34, 2.99792458e8


class Averaging:
    """Direct averages of a sensor's map over the rays of a predictor."""

    def __init__(self, sensor: Sensor, predictor: Predictor) -> None:
        self.predictor, self.micro_lens = predictor, sensor.micro_lens
        own = sensor.eqe_map
        phi = np.array([*own.phi_deg, own.phi_deg[0] + 360.0])
        self.tables, self.mapped_nm = {}, np.array(own.wavelengths_nm, float)
        for name in own.channels:
            eqe = np.array(own.eqe(name))
            around = np.concatenate([eqe, eqe[:, :, :1]], axis=2)
            grid = self.mapped_nm, np.array(own.theta_deg, float), phi
            self.tables[name] = RegularGridInterpolator(grid, around)

    def at(self, x_mm: float, y_mm: float, wavelengths_nm: np.ndarray) -> dict[str, np.ndarray]:
        """Return the mean efficiency (W,) of each channel at a place."""
        nodes, mapped = self.predictor.nodes_nm, self.mapped_nm
        away_mm = math.hypot(x_mm, y_mm)
        out = np.array([1.0, 0.0]) if away_mm == 0 else np.array([x_mm, y_mm]) / away_mm
        aside = np.array([-out[1], out[0]])
        lens, shift = self.micro_lens, 0.0
        if lens is not None:
            shift = np.sin(np.radians(np.interp(away_mm, lens.heights_mm, lens.chief_ray_deg)))
        means = {name: [] for name in self.tables}
        for line, node in enumerate(nodes):
            band = Band("", np.array([node]), np.ones(1))
            ideal = self.predictor.ideal_um(1e3 * away_mm * out, band)
            field = math.atan(1e-3 * math.hypot(*ideal) / self.predictor.tracer.efl_mm)
            share, radial, across = self.predictor.cone(field, line).T
            cosines = (radial - shift)[:, None] * out + across[:, None] * aside
            theta = np.degrees(np.arcsin(np.hypot(*cosines.T)))
            phi = np.degrees(np.arctan2(cosines[:, 1], cosines[:, 0])) % 360
            for name, table in self.tables.items():
                seen = [share @ table((nm, theta, phi)) for nm in mapped]
                # The map is straight between its wavelengths, and so is its mean.
                means[name].append(np.interp(wavelengths_nm, mapped, seen))
        # A cone goes smoothly with the wavelength; the map does not, and is taken where it is.
        weights = np.array([np.interp(wavelengths_nm, nodes, row) for row in np.eye(len(nodes))])
        return {name: np.sum(weights * np.array(own), axis=0) for name, own in means.items()}


def photons_per_s(scene: Scene, predictor: Predictor, sensor: Sensor, away_mm: float) -> np.ndarray:
    """Return photons (K,) of an even scene that arrive at a pixel at a distance from the axis.

    One figure for each of the scene's wavelengths, weighted for the trapezoidal rule.
    """
    nm = scene.wavelengths_nm
    # Through four nodes a cubic: solid angle and glass go smoothly with the wavelength.
    light = predictor.shown(np.array([1e3 * away_mm]), nm)[:, 0]
    energy_j = H_J_S * C_M_S / (nm * 1e-9)
    area = (sensor.pixel_pitch_um * 1e-6) ** 2 * sensor.fill_factor
    width_nm = np.gradient(nm)
    width_nm[[0, -1]] /= 2
    return scene.spectra[0] * light * width_nm * area / energy_j
