"""Host side of the paint stage: a chart's primitives, low-passed and sampled on the sim grid."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.convolve import Scale
from gpusim.scene.chart import Chart, Disc

PRIMITIVE = np.dtype(
    [
        ("centre", "<f4", 2),
        ("half_size", "<f4", 2),
        ("axis", "<f4", 2),
        ("kind", "<u4"),
        ("material", "<u4"),
    ]
)
# Standard deviation of the Gaussian low-pass, sim samples. At 0.8 the alias of an edge's 0.75 cycles/sample is
# exp(-2 pi^2 0.8^2 (0.75^2 - 0.25^2)) = 0.2 % of what it disturbs, and the inverse in the kernels stays below 24.
SIGMA = 0.8
REACH = 8.0  # sim samples beyond which a primitive's Gaussian edge (6 standard deviations) is zero, with margin


class Paint:
    """A chart on the device.

    Parameters
    ----------
    device : Device
    chart : Chart
        Placed, in um on the ideal plane.
    coefficients : ndarray (M, J)
        Of the chart's materials in the reduced basis.
    scale : Scale
    chief_ray : ChiefRayMap
    """

    def __init__(
        self,
        device: Device,
        chart: Chart,
        coefficients: np.ndarray,
        scale: Scale,
        chief_ray: ChiefRayMap,
    ) -> None:
        self.grid, self.pitch_um, self.sigma = scale.grid, scale.pitch_um, scale.sigma
        self.chief_ray = chief_ray
        self.background = chart.background
        table = np.zeros(max(len(chart.primitives), 1), PRIMITIVE)
        self.material = np.array([shape.material for shape in chart.primitives], int)
        self.bounds_um = np.zeros((len(chart.primitives), 3))  # centre x, y and radius of the circle around
        for row, bounds, shape in zip(table, self.bounds_um, chart.primitives, strict=False):
            disc = isinstance(shape, Disc)
            size_um = (shape.radius, shape.radius) if disc else (shape.half_w, shape.half_h)
            angle = 0.0 if disc else shape.angle_rad
            row["centre"] = np.array([shape.cx, shape.cy]) / scale.pitch_um
            row["half_size"] = np.array(size_um) / scale.pitch_um
            row["axis"] = np.cos(angle), np.sin(angle)
            row["kind"] = disc
            row["material"] = shape.material
            bounds[:] = shape.cx, shape.cy, shape.reach
        materials = np.zeros((len(coefficients), 8), np.float32)
        materials[:, : coefficients.shape[1]] = coefficients
        self.primitives = device.resident("paint primitives", table.view(np.uint32))
        self.materials = device.resident("paint materials", materials)
        self.chosen, self.ranges, self.needed = self._choose(device, coefficients)
        self.kernel = Kernel("optics/paint", BX=self.grid.block[0], BY=self.grid.block[1], J=coefficients.shape[1])

    def _choose(self, device: Device, coefficients: np.ndarray) -> tuple[Array, dict, dict]:
        """List the primitives that each block sees, and count the planes that their materials need."""
        grid, pitch = self.grid, self.pitch_um
        chosen, ranges, needed = [], {}, {}
        for y in range(grid.blocks[1]):
            for x in range(grid.blocks[0]):
                low = (np.array(grid.block_origin((x, y))) - grid.centre - REACH) * pitch
                high = low + (np.array(grid.block) + 2 * REACH) * pitch
                line = np.linspace(0, 1, 9)
                # The block's outline on the ideal plane: along the outline the map is monotone between these points.
                outline = np.concatenate(
                    [
                        np.stack([low[0] + line * (high[0] - low[0]), np.full(9, y_um)], axis=1)
                        for y_um in (low[1], high[1])
                    ]
                    + [
                        np.stack([np.full(9, x_um), low[1] + line * (high[1] - low[1])], axis=1)
                        for x_um in (low[0], high[0])
                    ]
                )
                rho2 = np.minimum(np.sum(outline**2, axis=1) / self.chief_ray.radius_um**2, 1.0)
                ideal = outline * np.polynomial.Polynomial(self.chief_ray.coefficients)(rho2)[:, None]
                low, high = ideal.min(axis=0) - pitch, ideal.max(axis=0) + pitch
                near = np.all(
                    (self.bounds_um[:, :2] + self.bounds_um[:, 2:] > low)
                    & (self.bounds_um[:, :2] - self.bounds_um[:, 2:] < high),
                    axis=1,
                )
                picked = np.flatnonzero(near)
                ranges[x, y] = (sum(map(len, chosen)), len(picked))
                chosen.append(picked)
                seen = {self.background, *(int(self.material[i]) for i in picked)}
                used = np.flatnonzero(np.any(coefficients[list(seen)] != 0, axis=0))
                needed[x, y] = int(used[-1]) + 1 if len(used) else 0
        flat = np.concatenate([*chosen, [0]]).astype(np.uint32)
        return device.resident("paint chosen", flat), ranges, needed

    def record(self, rec: Recording, block: tuple[int, int], planes: Array) -> None:
        """Paint one block of the sim grid into `planes` (J, BY, BX)."""
        grid = self.grid
        first, count = self.ranges[block]
        corner = np.array(grid.block_origin(block)) + 0.5
        self.kernel.record(
            rec,
            groups=(-(-grid.block[0] // 16), -(-grid.block[1] // 16), 1),
            params={
                **self.chief_ray.params(self.pitch_um),
                "origin": corner - grid.centre,
                "sigma": self.sigma,
                "first": first,
                "count": count,
                "background": self.background,
            },
            primitives=self.primitives,
            chosen=self.chosen,
            materials=self.materials,
            planes=planes,
        )
