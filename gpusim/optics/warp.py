"""Host side of the warp stage: a raster scene sampled on the sim grid through the chief-ray map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, Resident
from gpusim.gpu.pool import size_class
from gpusim.optics.chief_ray import ChiefRayMap, block_bounds_um, outline
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.scene.raster import PlacedRaster

# Raster samples around what a block's outline sees: the patch's reach (3), rounding to f32, and
# what the map bulges between the points of the outline.
MARGIN = 5
# Raster samples per sim sample from which detail comes back where pixels see it: a raster's highest
# frequency is then 3/4 of a cycle per sim sample, that of the pixels 1/4 with two samples a pixel.
SQUEEZED = 1.5
# Reach of the low-pass, sim samples, and what its passband counts more than its stopband: within
# 2e-3 of 1 up to 1/4 of a cycle per sim sample, below 0.065 from 3/4.
REACH, PASSBAND = 2.5, 5000
# Planes and points each way that share what one invocation of the shader loads and works out.
PLANES, SIDE = 3, 4
# Raster samples that points may lie apart to share the shader's patch: in x and in y it holds 2.
# Points of a square that the map stretches by these along some direction, and across it by none,
# lie (1 + sqrt 2) / 2 of them apart in x or y at most.
SPREAD = 1.65
MISS = 1e-4  # of a sample: what an identity may be off
TRIED = 17  # points along each side at which a map is tried


def _lattice(corner: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return points (P, 2) all over a rectangle."""
    sides = (c + np.linspace(0, s, TRIED) for c, s in zip(corner, size, strict=True))
    return np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)


def is_identity(raster: PlacedRaster, scale: Scale, chief_ray: ChiefRayMap) -> bool:
    """Whether every sample of the sim grid falls on one of the raster, to MISS of a sample."""
    centre = np.array(scale.grid.centre, float)
    real_um = scale.pitch_um * _lattice(-centre, 2 * centre)
    real_um = real_um[_seen(chief_ray, real_um)]
    moved_um = np.abs(chief_ray.ideal_um(real_um) - real_um).max(initial=0)
    middle = -np.array([raster.x0_um, raster.y0_um]) / raster.pitch_um - centre
    across = max(raster.planes.shape)
    return bool(
        moved_um <= MISS * scale.pitch_um
        and abs(scale.pitch_um / raster.pitch_um - 1) * across <= MISS
        and np.abs(middle - np.round(middle)).max() <= MISS
    )


def _seen(chief_ray: ChiefRayMap, real_um: np.ndarray) -> np.ndarray:
    """Return which points lie in the image circle."""
    return np.linalg.norm(real_um - np.array(chief_ray.centre_um), axis=-1) < chief_ray.radius_um


def stretch(chief_ray: ChiefRayMap, real_um: np.ndarray, step_um: float) -> np.ndarray:
    """Return how far points (P, 2) move on the ideal plane per step in x and in y; (P, 2).

    0 where a step of `step_um` to either side leaves the image circle.
    """
    found = np.zeros(real_um.shape)
    for axis in (0, 1):
        ends = [real_um + side * step_um * np.eye(2)[axis] for side in (-1, 1)]
        low, high = (chief_ray.ideal_um(end) for end in ends)
        inside = _seen(chief_ray, ends[0]) & _seen(chief_ray, ends[1])
        found[:, axis] = inside * np.linalg.norm(high - low, axis=-1) / (2 * step_um)
    return found


def low_pass(points: int) -> np.ndarray:
    """Return the weights of points 1/`points` of a sim sample apart; one alone where it is 1."""
    if points == 1:
        return np.ones(1)
    from scipy.signal import firls

    taps = 2 * int(REACH * points) + 1
    bands = (0, 0.25, 0.75, points / 2)
    weights = firls(taps, bands, (1, 1, 0, 0), weight=(PASSBAND, 1), fs=points)
    return weights / weights.sum()


def sharing(apart: float) -> int:
    """Return how many points each way share a patch, `apart` raster samples from each to the next.

    Along the direction in which they lie farthest apart.
    """
    return min(1 + int(SPREAD / apart), SIDE)


# Raster samples by which a sample's spline reaches on: 0.27^24 = 2e-14 of it is left there.
SPLINE_REACH = 24


@lru_cache(maxsize=2)  # of one raster for each scale; the planner asks again and again
def _bright(raster: PlacedRaster) -> np.ndarray:
    """Return how many bright samples lie above and left of each: a box's are four of these."""
    _, rows, cols = raster.planes.shape
    total = np.zeros((rows + 1, cols + 1), np.int32)
    np.cumsum(np.any(raster.planes, axis=0), axis=0, out=total[1:, 1:])
    return np.cumsum(total, axis=1, out=total)


def planes_by_block(
    raster: PlacedRaster,
    coefficients: np.ndarray,
    grid: SimGrid,
    pitch_um: float,
    chief_ray: ChiefRayMap,
) -> dict[tuple[int, int], int]:
    """Count the planes that each block of a sim grid needs.

    Parameters
    ----------
    raster : PlacedRaster
    coefficients : ndarray (M, J)
        Coefficients of the scene's spectra in the reduced basis.
    grid : SimGrid
    pitch_um : float
        Pitch of the sim grid.
    chief_ray : ChiefRayMap

    Returns
    -------
    dict of int
        By block; none where the raster is black, and beyond the image circle.
    """
    low, high, lit = block_bounds_um(grid, pitch_um, chief_ray, REACH)
    total = _bright(raster)
    rows, cols = raster.planes.shape[1:]
    corner = np.array([raster.x0_um, raster.y0_um])
    # Beyond the raster its border goes on.
    first = np.clip((low - corner) // raster.pitch_um - SPLINE_REACH, 0, (cols - 1, rows - 1))
    last = np.clip((high - corner) // raster.pitch_um + SPLINE_REACH, 0, (cols - 1, rows - 1)) + 1
    (x0, y0), (x1, y1) = first.astype(int).T, last.astype(int).T
    any_light = total[y1, x1] - total[y0, x1] - total[y1, x0] + total[y0, x0] > 0
    planes = coefficients.shape[1] * (any_light & lit)
    across = grid.blocks[0]
    return {(index % across, index // across): int(n) for index, n in enumerate(planes)}


class Warp:
    """A raster scene, of which the device holds what the blocks at hand see.

    Parameters
    ----------
    device : Device
    raster : PlacedRaster
        Its pitch is not finer than the sim grid's.
    coefficients : ndarray (M, J)
        Coefficients of the scene's spectra in the reduced basis.
    scale : Scale
    chief_ray : ChiefRayMap
    """

    def __init__(
        self,
        device: Device,
        raster: PlacedRaster,
        coefficients: np.ndarray,
        scale: Scale,
        chief_ray: ChiefRayMap,
    ) -> None:
        self.grid, self.pitch_um, self.chief_ray = scale.grid, scale.pitch_um, chief_ray
        self.device = device
        self.identity = is_identity(raster, scale, chief_ray)
        of_spectra = raster.spline_coefficients()
        if self.identity:
            of_spectra = raster.values(of_spectra)
        shape = (coefficients.shape[1], *of_spectra.shape[1:])
        # In place where that is possible: pages touched for the first time take 3 s a GiB.
        same = shape == of_spectra.shape
        self.splines = of_spectra if same else np.empty(shape, np.float32)
        for row in range(shape[1]):  # in float64 all together are twice as large as the rest
            np.matmul(
                coefficients.T, of_spectra[:, row], out=self.splines[:, row], casting="same_kind"
            )
        self.needed = planes_by_block(raster, coefficients, scale.grid, scale.pitch_um, chief_ray)
        self.size = (shape[2], shape[1])
        self.scale = scale.pitch_um / raster.pitch_um
        self.centre = (-raster.x0_um / raster.pitch_um - 0.5, -raster.y0_um / raster.pitch_um - 0.5)
        self.terms = device.resident("warp terms", chief_ray.terms(scale.pitch_um))
        # Two where any block is squeezed, and as many points of the low-pass.
        self.side = sharing(min(self.scale * chief_ray.stretch, SQUEEZED))
        self.kernels = {
            (planes, squeezed): Kernel(
                "optics/warp",
                BX=self.grid.block[0],
                BY=self.grid.block[1],
                AXIS=chief_ray.has_axis,
                DISTORTION=chief_ray.distortion,
                SPLINE=not self.identity,
                SQUEEZED=squeezed,
                SIDE=self.side,
                PLANES=planes,
            )
            for planes in range(1, PLANES + 1)
            for squeezed in (False, True)
        }
        self.points = {block: self._points(block) for block in self.needed}
        self.weights = {
            points: device.resident(
                f"warp {points}", np.append(low_pass(points), 0).astype(np.float32)
            )
            for points in set(self.points.values())
        }
        self.planes: list[Resident] = []
        self.loaded = (range(0), range(0))

    def _points(self, block: tuple[int, int]) -> int:
        """Return how many points a sim sample of a block needs, each way.

        Where the raster has s samples in a sim sample, its finest detail of s / 2 cycles comes back
        as p - s / 2 from p points: beyond what the low-pass lets through, 3/4.
        """
        if self.scale * self.chief_ray.stretch <= SQUEEZED:
            return 1
        corner = np.array(self.grid.block_origin(block)) - np.array(self.grid.centre)
        real_um = self.pitch_um * _lattice(corner, np.array(self.grid.block))
        squeezed = self.scale * float(stretch(self.chief_ray, real_um, self.pitch_um / 2).max())
        if squeezed <= SQUEEZED:
            return 1
        # Two by two share a patch.
        return int(np.ceil(max(0.75 + squeezed / 2, squeezed / SPREAD)))

    def prepare(self, blocks: Sequence[tuple[int, int]]) -> None:
        """Do nothing: a raster has no lists by block."""

    def seen(self, blocks: Sequence[tuple[int, int]]) -> tuple[range, range]:
        """Return the columns and rows of the raster that blocks see."""
        # Around a block that is squeezed, the low-pass reaches, and a point of weight 0 after it.
        around = REACH + 0.5 if any(self.points[block] > 1 for block in blocks) else 0.0
        index = np.array(blocks, int).reshape(-1, 2)
        corners = index * self.grid.block + self.grid.start - self.grid.centre
        size = np.array(self.grid.block) + 2 * around
        ideal = outline(self.chief_ray, corners - around, size, self.pitch_um)
        at = np.array(self.centre) + self.scale * ideal.reshape(-1, 2)
        low, high = (np.clip(end, 0, np.array(self.size) - 1) for end in (at.min(0), at.max(0)))
        return tuple(
            range(max(int(first) - MARGIN, 0), min(int(last) + 1 + MARGIN, size))
            for first, last, size in zip(low, high, self.size, strict=True)
        )

    def load_bytes(self, blocks: Sequence[tuple[int, int]]) -> int:
        """Return the device memory that `load` takes."""
        cols, rows = self.seen(blocks)
        return len(self.splines) * size_class(4 * len(cols) * len(rows))

    def load(self, blocks: Sequence[tuple[int, int]]) -> None:
        """Bring what blocks see onto the device, in place of what was there."""
        seen = self.seen(blocks)
        if seen != self.loaded:
            self._drop()
            cols, rows = (slice(part.start, part.stop) for part in seen)
            for j, spline in enumerate(self.splines):
                part = np.ascontiguousarray(spline[rows, cols])
                self.planes.append(self.device.resident(f"warp plane {j}", part))
            self.loaded = seen

    def release(self) -> None:
        """Give the device's memory back."""
        self._drop()
        for resident in (self.terms, *self.weights.values()):
            resident.destroy()

    def _drop(self) -> None:
        for resident in self.planes:
            resident.destroy()
        self.planes, self.loaded = [], (range(0), range(0))

    def record(self, rec: Recording, block: tuple[int, int], planes: Array) -> None:
        """Sample one block of the sim grid into `planes` (J, BY, BX), after `load`."""
        grid = self.grid
        cols, rows = self.loaded
        corner = np.array(grid.block_origin(block)) + 0.5
        points = self.points[block]
        weights = self.weights[points]
        each = 1 if points > 1 else self.side
        invocations = math.prod(-(-side // each) for side in grid.block)
        for first in range(0, len(self.planes), PLANES):
            coefficients = self.planes[first : first + PLANES]
            self.kernels[len(coefficients), points > 1].record(
                rec,
                groups=(-(-invocations // 64), 1, 1),
                params={
                    **self.chief_ray.params(self.pitch_um),
                    "origin": corner - grid.centre,
                    "centre": self.centre,
                    "size": self.size,
                    "first": (cols.start, rows.start),
                    "cols": len(cols),
                    "scale": self.scale,
                    "plane": first,
                    "reach": (weights.shape[0] - 1) // 2,
                    "step": 1 / points,
                },
                coefficients=coefficients[0],
                coefficients_1=coefficients[1 % len(coefficients)],
                coefficients_2=coefficients[2 % len(coefficients)],
                terms=self.terms,
                weights=weights,
                planes=planes,
            )
