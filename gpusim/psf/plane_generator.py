"""PSFs of a lens without an axis, field by field: few rays on the host, the rest on the device.

The float64 tracer follows few rays of a field. Polynomials through them say W, the rim and the
light at the nodes of a grid of directions that spans the whole pupil; from there the shaders go on
as for a lens with an axis (`gpusim.psf.transform`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from scipy.spatial import ConvexHull

from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.lens.entering import q_of, stretch
from gpusim.lens.samples import RINGS_OVERSIZE, Samples, sample_rings
from gpusim.lens.system import System
from gpusim.lens.wavefront import DEGREES, GOOD_FIT_WAVES
from gpusim.psf.boundary_wave import rim_lost
from gpusim.psf.cone import cone_of
from gpusim.psf.halo import distances_um, fall, field_halo, through_few
from gpusim.psf.rim import rim_share
from gpusim.psf.transform import GRID, TRANSFORM, Transform
from gpusim.psf.wave import Wave

# Fields of a grid that lie beyond the lens's largest are those of points inside too: cubics reach
# two fields on. They are what rays say, up to so many times the largest field and no steeper.
REACH, STEEP_DEG = 1.25, 80.0
NODES = 128  # across the pupil: see `gpusim.psf.generator.RAYS`
# The nodes span so much of the rays' extent.
OVERSIZE = 1.04
# Rays are believed as far as this of a rim: those of other wavelengths than the aimed one lie not
# quite where those do.
KEPT = RINGS_OVERSIZE + 0.02
# Polynomials are believed as far as this times the rays' hull.
NEAR = 1.005
NO_RAY = 2.0  # reach of nodes farther out
LEAST = 1e-3  # of the chief ray's light: has a logarithm
# Rays of the halo for each node, each way: 1/110 of the pupil's half width apart. Against 6 they
# change the first level of the triplet and of the phone lens by less than its nodes do.
RAYS_PER_NODE = 2


@dataclass(frozen=True)
class Pupils:
    """The pupils of one field, L wavelengths, on grids of NODES x NODES directions.

    Attributes
    ----------
    samples : Samples
        The rays.
    grids : ndarray of GRID, shape (L,)
        Where the nodes are; the transform's cells are filled in later.
    waves, reach, entering, lost : ndarray, shape (L, A, B)
        W; (height / clear semi-diameter)^2 at the aperture that is nearest to clipping; -ln of the
        amplitude that enters, over the chief ray's, and of what passes of it.
    at_chief : ndarray, shape (L,)
        E of the chief ray: see `gpusim.lens.entering`.
    residual_waves : ndarray, shape (L,)
    """

    samples: Samples
    grids: np.ndarray
    waves: np.ndarray
    reach: np.ndarray
    entering: np.ndarray
    lost: np.ndarray
    at_chief: np.ndarray
    residual_waves: np.ndarray

    @property
    def chief_um(self) -> np.ndarray:
        """Where the chief rays land, x and y (L, 2)."""
        return 1e3 * np.stack([self.samples.chief_x_mm, self.samples.chief_y_mm], axis=-1)

    def directions(self, line: int) -> tuple[np.ndarray, np.ndarray]:
        """Return alpha (A,) and beta (B,) of the nodes of a wavelength."""
        grid, at = self.grids[line], np.arange(NODES)
        first, step = (grid[name].astype(float) for name in ("first", "step"))
        return first[0] + at * step[0], first[1] + at * step[1]

    def wave(self, line: int, wavelength_nm: float) -> Wave:
        """Return the wavefront of a wavelength."""
        alpha, beta = self.directions(line)
        reach = self.reach[line]
        passed = np.exp(-2.0 * (self.entering[line] + self.lost[line]))
        return Wave(
            alpha=alpha,
            beta=beta,
            opd_um=1e-3 * wavelength_nm * self.waves[line],
            # As good as beyond the rim where no ray leads.
            reach=np.where(reach > 0, reach, NO_RAY),
            light=rim_share(reach[None])[0] * passed,
            passed=passed,
            rays_per_node=RAYS_PER_NODE,
        )


class Polynomials:
    """Chebyshev products of one total degree through values at rays' directions.

    Parameters
    ----------
    a, b : ndarray (R,)
        Directions, scaled to -1 .. 1.
    values : ndarray (R, K)
    degree : int
    """

    def __init__(self, a: np.ndarray, b: np.ndarray, values: np.ndarray, degree: int) -> None:
        i, j = np.meshgrid(np.arange(degree + 1), np.arange(degree + 1), indexing="ij")
        used = i + j <= degree
        in_a, in_b = chebyshev.chebvander(a, degree), chebyshev.chebvander(b, degree)
        design = in_a[:, i[used]] * in_b[:, j[used]]
        # Normal equations, as in `gpusim.lens.wavefront`.
        solution = np.linalg.solve(design.T @ design, design.T @ values)
        self.fitted = design @ solution
        self.coefficients = np.zeros((values.shape[1], *i.shape))
        self.coefficients[:, used] = solution.T

    def on(self, a: np.ndarray, b: np.ndarray, number: int, slope: int | None = None) -> np.ndarray:
        """Return one of the polynomials on the grid of a (A,) and b (B,), or a slope of it."""
        found = self.coefficients[number]
        if slope is not None:
            found = chebyshev.chebder(found, axis=slope)
        in_a, in_b = (
            chebyshev.chebvander(at, count - 1)
            for at, count in zip((a, b), found.shape, strict=True)
        )
        return in_a @ found @ in_b.T


class PlaneGenerator:
    """A lens, symmetric or not, that gives the PSFs of any field.

    Parameters
    ----------
    device : Device
    system : System
    wavelengths_nm : ndarray (L,)
    pitch_um, size : float, int
        Pitch and size of the PSFs; size at most half of the transform.
    reference_nm : float
        One of the wavelengths: rays are aimed at it.
    transform : int
        Cells of the pupil each way, 512 or 1024: the PSF repeats after so many samples.
    """

    def __init__(
        self,
        device: Device,
        system: System,
        wavelengths_nm: np.ndarray,
        *,
        pitch_um: float,
        size: int,
        reference_nm: float,
        transform: int = TRANSFORM,
    ) -> None:
        self.device, self.system, self._transform = device, system, transform
        self.wavelengths_nm, self.reference_nm = wavelengths_nm, reference_nm
        self.pitch_um, self.size = float(pitch_um), size
        self._index = system.index(wavelengths_nm)
        self._reference = int(np.flatnonzero(wavelengths_nm == reference_nm)[0])
        given = {"pitch_um": self.pitch_um, "size": size, "cells": transform}
        self._to_psfs = Transform(device, **given, mirrored=False)
        self._inside = distances_um(size, pitch_um) < size / 2 * pitch_um
        self._within = fall(distances_um(size, pitch_um), size / 2 * pitch_um)

    def pupils(self, field_deg: tuple[float, float]) -> Pupils:
        """Trace the rays of a field, and lay its pupils on grids.

        Raises
        ------
        UserError
            No light passes at the field, or the pitch does not sample the PSF.
        """
        samples = self._samples(field_deg)
        scaled = self._kept(samples, self._reference)[-1]
        # As far as the aimed rays reach: those of the other lines fill as much of their extent.
        near = _within(scaled, _nodes())
        laid = [self._laid(samples, line, near) for line in range(len(self.wavelengths_nm))]
        stacked = [np.array(one) for one in zip(*laid, strict=True)]
        return Pupils(samples, *stacked)

    def _samples(self, field_deg: tuple[float, float]) -> Samples:
        """Return the rays of a field, beyond the largest one as far as they pass."""
        angles = self.angles(field_deg)
        given = self.system, self._index
        try:
            return sample_rings(*given, *angles, self._reference)
        except UserError:
            nearer = self.angles(field_deg, 1.0)
            if nearer == angles:
                raise
        return sample_rings(*given, *nearer, self._reference)

    def angles(self, field_deg: tuple[float, float], reach: float = REACH) -> tuple[float, float]:
        """Return angle from the axis, at most so many times the largest, and azimuth, rad."""
        largest_deg = self.system.prescription.max_field_deg
        most_deg = min(reach * largest_deg, max(largest_deg, STEEP_DEG))
        theta = np.radians(min(np.hypot(*field_deg), most_deg))
        return float(theta), float(np.arctan2(*field_deg))

    def _kept(
        self, samples: Samples, line: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return which rays of a wavelength are kept, and the scale of their directions.

        Rays (R,), middle and half width (2,) of the kept ones, and these scaled to -1 .. 1 (2, K).
        """
        keep = samples.ok[line] & (samples.margin[:, line] <= KEPT**2 - 1).all(axis=0)
        cosines = np.stack([samples.alpha[line], samples.beta[line]])[:, keep]
        low, high = cosines.min(axis=1), cosines.max(axis=1)
        middle, half = (low + high) / 2, (high - low) / 2
        return keep, middle, half, (cosines - middle[:, None]) / half[:, None]

    def _laid(self, samples: Samples, line: int, near: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return what `Pupils` has of one wavelength, in its order.

        ``near``: nodes (A, B) that rays surround.
        """
        wavelength_nm = self.wavelengths_nm[line]
        keep, middle, half, scaled = self._kept(samples, line)
        margin, inside = samples.margin[:, line, keep], samples.inside[line, keep]
        self._check_pitch(line, (np.ptp(scaled[:, inside], axis=1) * half).max())
        entering = samples.entering
        active = [m for m in range(len(margin) - 1) if margin[m].max() > 0]
        entered = q_of(entering.launch, entering.px, entering.py)[:, line, keep]
        targets = [samples.opd_mm[line, keep] * 1e6 / wavelength_nm, *entered]
        # The diaphragm last, though it may clip nothing.
        targets += [*margin[active], margin[-1]]
        lost = samples.apodisation * (1 + margin[-1])
        if samples.losses is not None:
            lost = lost + samples.losses.exponent(line, wavelength_nm)[keep]
        lossy = bool(np.any(lost))
        if lossy:
            targets.append(lost)

        values = np.stack(targets, axis=1)
        for degree in DEGREES:
            # A strongly vignetted beam has few rays: each coefficient takes at least two.
            degree = min(degree, int(np.sqrt(scaled.shape[1])) - 1)
            fit = Polynomials(*scaled, values, degree)
            residual = float(np.std((fit.fitted[:, 0] - values[:, 0])[inside]))
            if residual < GOOD_FIT_WAVES:
                break

        nodes = _nodes()
        grid = np.zeros((), GRID)
        grid["step"] = 2 * OVERSIZE * half / NODES
        grid["first"] = middle + half * nodes[0]
        chief = samples.chief_direction[line]
        grid["chief"], grid["waves_per_mm"] = chief, 1e6 / wavelength_nm

        on = (nodes, nodes)
        reach = 1 + np.max([fit.on(*on, k) for k in range(3, 4 + len(active))], axis=0)
        reach = np.where(near, np.maximum(reach, 1e-6), 0.0)
        at_chief = _entering(fit, *((chief - middle) / half)[:, None])[0, 0]
        light = np.where(near, np.maximum(_entering(fit, *on) / at_chief, LEAST), 1.0)
        lost_there = np.where(near, fit.on(*on, len(targets) - 1), 0.0) if lossy else 0 * reach
        return (
            grid,
            fit.on(*on, 0),  # beyond the rays too, for slopes next to them
            reach,
            -0.5 * np.log(light),
            lost_there,
            at_chief / half.prod(),
            residual,
        )

    def _check_pitch(self, line: int, width: float) -> None:
        """Refuse a pitch above the Nyquist limit of the PSF, lambda / (2 pupil width)."""
        limit = self.wavelengths_nm[line] * 1e-3 / (2 * width)
        if self.pitch_um > limit:
            raise UserError(
                "the PSF pitch is too coarse for this aperture at "
                f"{self.wavelengths_nm[line]:g} nm",
                file=self.system.prescription.file,
                field="pitch_um",
                value=self.pitch_um,
                allowed=f"<= {limit:.3g}",
            )

    def beside(self, pupils: Pupils) -> dict[str, np.ndarray]:
        """Return what the device does not do of a field, by the names of the bank's variables.

        And ``rim``, shape (L, n, n): what sampling the rim takes from the PSFs; ``area``, the
        image's per area of the scene.
        """
        samples, lines = pupils.samples, self.wavelengths_nm
        radius_um = self.size / 2 * self.pitch_um

        def wave(line: int) -> Wave:
            return pupils.wave(line, lines[line])

        few, basis = through_few(lines)
        period_um = 2 * (self._transform * self.pitch_um,)
        lost = [
            rim_lost(wave(line), 1e-3 * lines[line], self.size, self.pitch_um, period_um)
            for line in few
        ]
        levels, beyond = field_halo(wave, lines, self.pitch_um, radius_um)
        share = rim_share(pupils.reach) * np.exp(-2.0 * pupils.lost)
        cones = [cone_of(*pupils.directions(k), one, False) for k, one in enumerate(share)]
        in_stop = samples.margin[-1] < 0
        return {
            "rim": np.einsum("lf,fxy->lxy", basis, lost),
            "area": self.area(pupils),
            "levels": levels.swapaxes(-1, -2),
            "beyond": beyond,
            "cone": np.stack(cones),
            "fit_residual_waves": pupils.residual_waves,
            "failed_rays": (~samples.ok & in_stop).sum(axis=1).astype(np.int32),
            "chief_x_um": pupils.chief_um[:, 0],
            "chief_y_um": pupils.chief_um[:, 1],
            "chief": samples.chief_direction,
        }

    def area(self, pupils: Pupils) -> float:
        """Return the image's area per area of the scene: see `gpusim.lens.entering.stretch`."""
        launch = pupils.samples.entering.launch
        start = replace(launch, base=launch.base[:, [self._reference]])
        return stretch(self.system, self.reference_nm, launch.theta, launch.azimuth, start).area()

    def spread(self, pupils: Pupils) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the PSFs (L, n, n) of a field, by the device, rows x and columns y.

        Without what sampling the rim takes from them; and the light that enters (L,), and the
        share (L,) that would fold.
        """
        grids = pupils.grids.copy()
        cell = 1e-3 * self.wavelengths_nm / (self._transform * self.pitch_um)
        width = (NODES - 1) * grids["step"].astype(float)
        middle = grids["first"] + width / 2
        rows = int(np.ceil((width[:, 0] / cell).max())) + 1
        grids["cell"] = cell
        grids["origin"] = middle - np.stack([rows / 2 * cell, 0 * cell], axis=-1)
        nodes = np.stack([pupils.waves, pupils.reach], axis=-1).astype(np.float32)
        held = [
            self.device.resident("nodes", nodes),
            self.device.resident("exponent", (pupils.entering + pupils.lost).astype(np.float32)),
        ]
        try:
            psf, light, folded = self._to_psfs.spread(grids, *held, rows)
        finally:
            for one in held:
                one.destroy()
        return psf, light * cell**2 * pupils.at_chief, folded

    def row(self, pupils: Pupils, beside: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return all wavelengths of one field, by the names of the bank's variables."""
        psf, entered, folded = self.spread(pupils)
        kept = {name: one for name, one in beside.items() if name not in ("rim", "area")}
        psf = (psf + beside["rim"].astype(np.float32)) * self._inside
        return kept | {
            "light_sr": entered / beside["area"],
            "outside_energy": 1 - psf.sum(axis=(1, 2), dtype=float),
            "core": np.einsum("lxy,xy->l", psf, self._within, dtype=float),
            "folded_energy": folded,
            # Rows are x in the pupil, and y in the image.
            "psf": psf.swapaxes(1, 2).astype(np.float32),
        }

    def release(self) -> None:
        """Give the device memory back."""
        self._to_psfs.release()


def _nodes() -> np.ndarray:
    """Return where the nodes lie along either direction, scaled as the rays are."""
    return OVERSIZE * (2 * np.arange(NODES) + 1 - NODES) / NODES


def _entering(fit: Polynomials, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return E (A, B) by the scaled directions: the area of q, which are numbers 1 and 2."""
    (x_a, x_b), (y_a, y_b) = ([fit.on(a, b, n, slope) for slope in (0, 1)] for n in (1, 2))
    return np.abs(x_a * y_b - x_b * y_a)


def _within(scaled: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return which nodes (N, N) lie within NEAR times the convex hull of directions (2, R)."""
    within = np.ones((len(nodes), len(nodes)), bool)
    middle = scaled.mean(axis=1)
    for a, b, offset in ConvexHull(scaled.T).equations:
        own = a * middle[0] + b * middle[1]
        within &= a * nodes[:, None] + b * nodes <= own - NEAR * (own + offset)
    return within
