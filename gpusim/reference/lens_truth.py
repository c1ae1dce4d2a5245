"""A judge of renders: what a pixel of a camera with a prescription sees, by brute force in float64.

Electrons/s of a pixel are

    N = A sum_lambda step (lambda / h c) QE T integral L(X; lambda) G(X; lambda) d^2 X

with G what one image point sees (`gpusim.reference.backward`), spread over the pixel's aperture. It
uses no bank of PSFs, no chief-ray map, no plan, no shader: only the surfaces, the glasses, the
scene and the sensor's figures.

G is integrated on two grids of X = f w (object directions, as lengths): a fine core, on which the
aperture is folded in by its transform, and around it cells of some micrometres over one period of
the sampled pupil, which holds every ray. What diffraction throws farther is a stated share
(`View.beyond`), and is taken to fall as 1 / r^3 in all directions alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates

from gpusim.lens.system import System, first_order, transmission
from gpusim.lens.throughput import goes_with_the_ray
from gpusim.reference.backward import (
    Frame,
    aperture_of,
    chief_back,
    core_of,
    frame_of,
    rays_of,
    wide_of,
)

PLANCK_J_S = 6.62607015e-34  # SI (2019), exact
LIGHT_M_S = 299792458.0  # SI (2019), exact
REFERENCE_NM = 550.0  # whose chief ray names the frame: any would do
# Half the width of the fine core: at least, and in wavelengths over the aperture: 16 lambda N, or
# 13 Airy radii.
CORE_UM, CORE_WAVES = 28.0, 16.0
CELLS = 7  # coarse cells across half the core
SUB = 2  # squares each way in a cell, in which outlines are taken as straight
# The sampled pupil's period holds every ray and this share more.
SPARE = 1.25
# Nodes across the pupil, at least: of a round pupil the light beyond the period is 0.45 / nodes
# (2 lambda N / (pi^2 R) beyond a radius R; Born & Wolf, sec. 8.5.2).
NODES = 768
# An outline sees the core's samples and not what lies between them: so much finer, an edge of a
# perfect lens is right to 4e-4, and to 6e-3 without.
FINER = 4
RAYS, RADII = 64, 64  # directions and distances of what lies beyond
NOTHING = -1  # material beyond the image circle


@dataclass(frozen=True)
class View:
    """What one image point sees at each wavelength.

    Attributes
    ----------
    frame : Frame
    wavelengths_nm : ndarray (L,)
    solid_angle_sr : ndarray (L,)
        Solid angle of the light that arrives at this very point, as direction cosines.
    core : ndarray (L, n, n)
        Share of the light per sample at places `at_um`; rows X1, columns X2.
    at_um : ndarray (n,)
    wide : ndarray (L, m, m)
        Share of the light in cells between `edges_um`, 0 where the core lies.
    edges_um : ndarray (m + 1,)
    beyond : ndarray (L,)
        Share of the light outside both.
    residual_waves : float
        Worst misfit of the wavefronts.
    """

    frame: Frame
    wavelengths_nm: np.ndarray
    solid_angle_sr: np.ndarray
    core: np.ndarray
    at_um: np.ndarray
    wide: np.ndarray
    edges_um: np.ndarray
    beyond: np.ndarray
    residual_waves: float


def view(
    system: System,
    point_um: tuple[float, float],
    wavelengths_nm: np.ndarray,
    *,
    core_um: float | None = None,
    nodes: int = NODES,
    finer: float = 1.0,
) -> View:
    """Return what an image point sees.

    Parameters
    ----------
    system : System
    point_um : (float, float)
        x right, y down from the axis.
    wavelengths_nm : ndarray (L,)
    core_um : float, optional
        Half the width of the core: by default `CORE_UM` or `CORE_WAVES`, whichever is more.
    nodes : int
        Least nodes across the pupil.
    finer : float
        Divides the pitch of the core.

    Raises
    ------
    ValueError
        Where no light arrives, or the object is not at infinity: this judge names what it sees by
        directions. Where losses go with the ray: it knows those on the axis alone.
    """
    if np.isfinite(system.geometry.object_z):
        raise ValueError("the object is not at infinity")
    if goes_with_the_ray(system.prescription):
        raise ValueError("losses go with the ray")
    image = np.asarray(point_um, float) * 1e-3
    focal = first_order(system.prescription, REFERENCE_NM).efl_mm
    frame = frame_of(system, system.index(np.array([REFERENCE_NM])), image, focal)
    indices = system.index(wavelengths_nm)
    chiefs = chief_back(system, indices, image)
    lines = [
        (system, indices[:, [line]], image, chiefs[:, [line]], frame)
        for line in range(len(wavelengths_nm))
    ]
    bundles = [rays_of(*line) for line in lines]
    extent = max(float(np.ptp(rays.p, axis=1).max()) for rays in bundles)
    reach = max(float(np.abs(rays.landing_um[:, rays.inside]).max()) for rays in bundles)
    shortest = float(np.min(wavelengths_nm)) * 1e-3
    if core_um is None:
        core_um = max(CORE_UM, CORE_WAVES * float(np.max(wavelengths_nm)) * 1e-3 / extent)
    half = max(SPARE * reach, 2 * core_um, nodes * shortest / (2 * extent))
    cell = core_um / CELLS
    while half / cell > 160:  # cells grow with the window
        cell *= 2
    inner = max(1, round(core_um / cell))
    core_um = inner * cell
    cells = int(np.ceil(half / cell))
    edges = cell * np.arange(-cells, cells + 1)
    half = cells * cell
    # |F|^2 has no frequency beyond extent / lambda: samples at twice that, and a tenth more.
    count = int(np.ceil(2 * core_um * 2 * 1.1 * finer * extent / shortest / 2)) * 2
    pitch = 2 * core_um / count
    at = pitch * (np.arange(count) + 0.5 - count / 2)
    cores, wides, solid, residual = [], [], [], []
    apodised = system.prescription.gaussian_apodisation or 0.0
    hole = slice(cells - inner, cells + inner)
    for rays, wavelength in zip(bundles, wavelengths_nm, strict=True):
        aperture = aperture_of(rays, wavelength, half, apodised)
        core = core_of(aperture, wavelength, at, at) * pitch**2
        wide = wide_of(aperture, edges)
        landed = 1.1 * float(np.abs(rays.landing_um[:, rays.inside]).max())
        wide = wide * _undrooped(edges, landed)
        wide[hole, hole] = 0.0
        cores.append(core)
        wides.append(wide)
        solid.append(aperture.solid_angle_sr)
        residual.append(aperture.residual_waves)
    core, wide = np.stack(cores), np.stack(wides)
    return View(
        frame,
        np.asarray(wavelengths_nm, float),
        np.array(solid),
        core,
        at,
        wide,
        edges,
        1 - core.sum(axis=(1, 2)) - wide.sum(axis=(1, 2)),
        max(residual),
    )


def _undrooped(edges: np.ndarray, landed_um: float) -> np.ndarray:
    """Return factors (m, m) that undo what averaging the pupil's rim over its cells does.

    That multiplies the light which the rim diffracts by sinc^2 of the place over the period, and
    then the copies from beyond the period fold in. Far out it falls as 1 / r^3 in the mean; where
    rays land, up to `landed_um`, most of the light is not the rim's.
    """
    period = edges[-1] - edges[0]
    at = (edges[1:] + edges[:-1]) / 2
    x, y = np.meshgrid(at, at, indexing="ij")

    def tail(u, v):
        return (u * u + v * v + edges[-1] ** 2 * 1e-12) ** -1.5

    copies = sum(
        tail(x + a * period, y + b * period)
        * np.sinc(x / period + a) ** 2
        * np.sinc(y / period + b) ** 2
        for a in range(-2, 3)
        for b in range(-2, 3)
    )
    return np.where(np.maximum(np.abs(x), np.abs(y)) > landed_um, tail(x, y) / copies, 1.0)


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
