"""A judge of renders: what a pixel of a camera with a prescription sees, by brute force in float64.

Electrons/s of a pixel are

    N = A sum_lambda step (lambda / h c) QE T integral L(X; lambda) G(X; lambda) d^2 X

with G what one image point sees (`gpusim.reference.lens_view`), spread over the pixel's aperture.
It uses no bank of PSFs, no chief-ray map, no plan, no shader: only the surfaces, the glasses, the
scene and the sensor's figures.

What diffraction throws beyond both grids of a view is taken to fall as 1 / r^3 in all directions
alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from gpusim.lens.system import System, transmission
from gpusim.reference.bundle import Frame
from gpusim.reference.lens_view import View

PLANCK_J_S = 6.62607015e-34  # SI (2019), exact
LIGHT_M_S = 299792458.0  # SI (2019), exact
SUB = 2  # squares each way in a cell, in which outlines are taken as straight
# An outline sees the core's samples and not what lies between them: so much finer, an edge of a
# perfect lens is right to 4e-4, and to 6e-3 without.
FINER = 4
RAYS, RADII = 64, 64  # directions and distances of what lies beyond
NOTHING = -1  # material beyond the image circle


@dataclass(frozen=True)
class Judged:
    """Electrons/s of one pixel.

    Attributes
    ----------
    rate : float
        Without veiling glare.
    beyond : float
        Share of the light that falls outside both grids: the largest of any wavelength.
    bound : float
        How that errs, were it to go one way: the share times how much the directions differ.
    colours : float
        How much the rate changes where every other wavelength is left out: splines between those
        that were traced err by less. 0 where the whole table was.
    """

    rate: float
    beyond: float
    bound: float
    colours: float


class Judge:
    """Judge of one camera, of a lens with a prescription.

    Parameters
    ----------
    system : System
    sensor : gpusim.sensor.sensor.Sensor
        With square pixels; without angular response, motion and cross-talk.
    scene : gpusim.scene.scene.Scene
    wavelengths_nm : ndarray (61,)
        Wavelengths of the scene's spectra and of the quantum efficiency, evenly spaced: the
        integral is the trapezoidal rule on them.

    Raises
    ------
    ValueError
        For a raster with highlights.
    """

    def __init__(self, system: System, sensor: Any, scene: Any, wavelengths_nm: np.ndarray) -> None:
        self.system, self.sensor, self.scene = system, sensor, scene
        self.table_nm = wavelengths_nm
        self.flat = scene.projection.name == "rectilinear"
        half_um = [side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows)]
        self.chart = hasattr(scene.source, "primitives")
        if self.chart:
            self.placed = scene.source.placed(half_um[1])
        else:
            # As fine as it is: its own spline is the scene.
            self.placed = scene.source.placed(*half_um, 1e-9)
            if len(self.placed.highlights):
                raise ValueError("this judge has no eye for highlights")
            self.coefficients = self.placed.spline_coefficients()
        self.side_um = sensor.pixel_pitch_um * np.sqrt(sensor.fill_factor)
        self.edge_rad = np.radians(system.prescription.max_field_deg)

    def point_um(self, row: int, col: int) -> tuple[float, float]:
        """Return where a pixel's middle lies, x right and y down from the sensor's middle."""
        sensor = self.sensor
        return tuple(
            (at + 0.5 - side / 2) * sensor.pixel_pitch_um
            for at, side in ((col, sensor.cols), (row, sensor.rows))
        )

    def weights(self, row: int, col: int, lines_nm: np.ndarray) -> np.ndarray:
        """Return electrons/s of a sr of each of the scene's spectra, by wavelength: (M, L).

        N = A sum step (lambda / h c) QE T L Omega (EMVA 1288 R4, eq. 1). PSFs known at fewer
        wavelengths than the table has are splines between them, which are linear in the values.
        """
        pattern = self.sensor.cfa.pattern
        table = self.table_nm
        qe = self.sensor.qe_at(table)[pattern[row % len(pattern)][col % len(pattern[0])]]
        step = np.gradient(table)
        step[[0, -1]] /= 2
        response = qe * transmission(self.system.prescription, table) * step
        response = response * table * 1e-9 / (PLANCK_J_S * LIGHT_M_S) * (self.side_um * 1e-6) ** 2
        share = CubicSpline(lines_nm, np.eye(len(lines_nm)))(table)
        return (response * self.scene.spectra) @ share

    def pixel(self, seen: View, row: int, col: int) -> Judged:
        """Return the electrons/s of a pixel whose middle's view is given."""
        seen = replace(seen, frame=replace(seen.frame, flat=self.flat))
        core, at = self._over_aperture(seen)
        inner = self._shares(seen.frame, at, SUB)
        outer = self._shares(seen.frame, (seen.edges_um[1:] + seen.edges_um[:-1]) / 2, SUB)
        rings = self._rings(seen)
        light = np.tensordot(inner, core, ((1, 2), (1, 2)))
        light += np.tensordot(outer, seen.wide, ((1, 2), (1, 2)))  # (M, L)
        light += np.multiply.outer(rings.mean(axis=1), seen.beyond)
        adrift = np.multiply.outer(rings.std(axis=1), np.abs(seen.beyond))

        def summed(of: np.ndarray, every: int = 1) -> float:
            weight = self.weights(row, col, seen.wavelengths_nm[::every])
            return float(np.sum(weight * (of * seen.solid_angle_sr)[:, ::every]))

        rate = summed(light)
        whole = np.array_equal(seen.wavelengths_nm, self.table_nm)
        colours = 0.0 if whole else abs(summed(light, 2) - rate)
        return Judged(rate, float(seen.beyond.max()), summed(adrift), colours)

    def _over_aperture(self, seen: View) -> tuple[np.ndarray, np.ndarray]:
        """Return the core folded with the pixel's aperture, a parallelogram in X, on its places."""
        pitch = seen.at_um[1] - seen.at_um[0]
        sides = seen.frame.per_um * self.side_um  # columns: the aperture's sides
        spare = int(np.ceil(np.abs(sides).sum(axis=1).max() / 2 / pitch)) + 2
        count = len(seen.at_um) + 2 * spare
        size = next_fast_len(count)
        nu_1 = np.fft.fftfreq(size, pitch)[:, None]
        nu_2 = np.fft.rfftfreq(size, pitch)[None]
        fine = pitch / FINER
        box = 1.0
        for side in sides.T:
            box = box * np.sinc(nu_1 * side[0] + nu_2 * side[1])
        # The scene is looked up as a mean over each sample's square, which is one box too many.
        box = box / (np.sinc(nu_1 * fine) * np.sinc(nu_2 * fine))
        # To the middle of the first of the finer squares.
        box = box * np.exp(1j * np.pi * (nu_1 + nu_2) * (fine - pitch))
        padded = np.zeros((len(seen.core), size, size))
        middle = slice(spare, spare + len(seen.at_um))
        padded[:, middle, middle] = seen.core
        known = rfft2(padded) * box
        half, whole = size // 2, size * FINER
        spectrum = np.zeros((len(known), whole, whole // 2 + 1), complex)
        spectrum[:, :half, : known.shape[2]] = known[:, :half]
        spectrum[:, half - size :, : known.shape[2]] = known[:, half:]
        count *= FINER
        spread = irfft2(spectrum, s=(whole, whole))[:, :count, :count]
        return spread, fine * (np.arange(count) + 0.5 - count / 2)

    def _shares(self, frame: Frame, at: np.ndarray, sub: int) -> np.ndarray:
        """Return how much of each spectrum lies in squares about places at x at: (M, n, n)."""
        pitch = at[1] - at[0]
        fine = at[:, None] + pitch * ((np.arange(sub) + 0.5) / sub - 0.5)
        fine = fine.ravel()
        x, y, off = frame.ideal(fine[:, None], fine[None])
        lit = off <= self.edge_rad
        planes = self._covered(frame, fine, x, y) if self.chart else self._radiance(x, y)
        shape = (len(at), sub, len(at), sub)
        return np.stack([(plane * lit).reshape(shape).mean(axis=(1, 3)) for plane in planes])

    def _rings(self, seen: View) -> np.ndarray:
        """Return each spectrum's share by direction, where light has gone beyond the cells.

        Its mean falls as 1 / r^3: radii that are equally likely under 2 pi r / r^3.
        """
        start = seen.edges_um[-1] * 2 / np.sqrt(np.pi)  # of a circle as large as the square
        radius = start / ((np.arange(RADII) + 0.5) / RADII)
        angle = 2 * np.pi * np.arange(RAYS) / RAYS
        x1, x2 = radius * np.cos(angle)[:, None], radius * np.sin(angle)[:, None]
        focal_um = 1e3 * seen.frame.focal_mm
        ahead = np.hypot(x1, x2) < focal_um
        x, y, off = seen.frame.ideal(np.where(ahead, x1, 0), np.where(ahead, x2, 0))
        lit = ahead & (off <= self.edge_rad)
        if not self.chart:
            return np.stack([(plane * lit).mean(axis=1) for plane in self._radiance(x, y)])
        material = np.where(lit, self.placed.material_at(x, y), NOTHING)
        return np.stack(
            [(material == number).mean(axis=1) for number in range(len(self.scene.spectra))]
        )

    def _covered(self, frame: Frame, at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return each material's share (M, n, n) of squares about points with even places `at`."""
        shares = np.zeros((len(self.scene.spectra), *x.shape))
        shares[self.placed.background] = 1.0
        step = at[1] - at[0]
        for shape, under in zip(self.placed.primitives, self.placed.under, strict=True):
            x1, x2, ahead = frame.of_ideal(np.array(shape.cx), np.array(shape.cy))
            # X moves by no more than the ideal plane: by cos theta and less.
            low = [int(np.floor((one - shape.reach - at[0]) / step)) - 2 for one in (x1, x2)]
            high = [int(np.ceil((one + shape.reach - at[0]) / step)) + 3 for one in (x1, x2)]
            if not ahead:
                low, high = [0, 0], [len(at), len(at)]
            ends = [(max(a, 0), max(min(b, len(at)), 0)) for a, b in zip(low, high, strict=True)]
            if min(b - a for a, b in ends) < 2:
                continue
            part = tuple(slice(*end) for end in ends)
            distance = shape.distance(x[part], y[part])
            slopes = np.gradient(distance)
            # A straight outline through a square: exact along the sides, 1/24 off at 45 deg.
            across = np.maximum(np.abs(slopes[0]) + np.abs(slopes[1]), 1e-12)
            share = np.clip(0.5 - distance / across, 0, 1)
            # From the one material that it lies in: outlines may touch.
            shares[(under, *part)] -= share
            shares[(shape.material, *part)] += share
        return shares

    def _radiance(self, x: np.ndarray, y: np.ndarray):
        """Yield each plane of a raster at points: its cubic spline."""
        placed = self.placed
        cols = (x - placed.x0_um) / placed.pitch_um - 0.5
        rows = (y - placed.y0_um) / placed.pitch_um - 0.5
        for plane in self.coefficients:
            yield map_coordinates(
                plane.astype(float), [rows, cols], order=3, mode="nearest", prefilter=False
            )
