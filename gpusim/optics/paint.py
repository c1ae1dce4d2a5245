"""Host side of the paint stage: a chart's primitives, low-passed and sampled on the sim grid."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
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
# Standard deviation of the Gaussian low-pass, sim samples. At 0.8 the alias of an edge's 0.75
# cycles/sample is exp(-2 pi^2 0.8^2 (0.75^2 - 0.25^2)) = 0.2 % of what it disturbs, and the inverse
# in the kernels stays below 24.
SIGMA = 0.8
REACH = 8.0  # sim samples beyond which the Gaussian edge of a primitive (6 sigma) is zero, and more


def primitives_by_block(
    chart: Chart, coefficients: np.ndarray, grid: SimGrid, pitch_um: float, chief_ray: ChiefRayMap
) -> tuple[dict[tuple[int, int], np.ndarray], dict[tuple[int, int], int]]:
    """List the primitives that each block of a sim grid sees, and count the planes that it needs.

    Parameters
    ----------
    chart : Chart
        Placed, in um on the ideal plane.
    coefficients : ndarray (M, J)
        Of the chart's materials.
    grid : SimGrid
    pitch_um : float
        Of the sim grid.
    chief_ray : ChiefRayMap

    Returns
    -------
    seen : dict of ndarray
        Indices of primitives, in painter's order, by block.
    needed : dict of int
        By block: planes beyond these have no coefficient in it.
    """
    bounds_um = np.array([(shape.cx, shape.cy, shape.reach) for shape in chart.primitives]).reshape(
        -1, 3
    )
    material = np.array([shape.material for shape in chart.primitives], int)
    last_plane = np.array([np.flatnonzero(row)[-1] + 1 if row.any() else 0 for row in coefficients])
    g = np.polynomial.Polynomial(chief_ray.coefficients)
    side = np.linspace(0, 1, 9)
    # Nine points a side of the block's outline: on the way from one to the next the map is
    # monotone.
    outline = np.concatenate(
        [np.stack([side, np.full(9, end)], axis=1) for end in (0, 1)]
        + [np.stack([np.full(9, end), side], axis=1) for end in (0, 1)]
    )
    seen, needed = {}, {}
    for y in range(grid.blocks[1]):
        for x in range(grid.blocks[0]):
            corner = np.array(grid.block_origin((x, y))) - grid.centre - REACH
            real = (corner + outline * (np.array(grid.block) + 2 * REACH)) * pitch_um
            rho2 = np.minimum(np.sum(real**2, axis=1) / chief_ray.radius_um**2, 1.0)
            ideal = real * g(rho2)[:, None]
            low, high = ideal.min(axis=0) - pitch_um, ideal.max(axis=0) + pitch_um
            near = np.all(
                (bounds_um[:, :2] + bounds_um[:, 2:] > low)
                & (bounds_um[:, :2] - bounds_um[:, 2:] < high),
                axis=1,
            )
            seen[x, y] = np.flatnonzero(near)
            needed[x, y] = int(max(last_plane[chart.background], *last_plane[material[near]], 0))
    return seen, needed


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

    Attributes
    ----------
    needed : dict of int
        Planes that each block needs.
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
        for row, shape in zip(table, chart.primitives, strict=False):
            disc = isinstance(shape, Disc)
            size_um = (shape.radius, shape.radius) if disc else (shape.half_w, shape.half_h)
            angle = 0.0 if disc else shape.angle_rad
            row["centre"] = np.array([shape.cx, shape.cy]) / scale.pitch_um
            row["half_size"] = np.array(size_um) / scale.pitch_um
            row["axis"] = np.cos(angle), np.sin(angle)
            row["kind"] = disc
            row["material"] = shape.material
        materials = np.zeros((len(coefficients), 8), np.float32)
        materials[:, : coefficients.shape[1]] = coefficients
        seen, self.needed = primitives_by_block(
            chart, coefficients, scale.grid, scale.pitch_um, chief_ray
        )
        starts = np.cumsum([0, *map(len, seen.values())])
        self.ranges = {
            block: (int(start), len(picked))
            for (block, picked), start in zip(seen.items(), starts[:-1], strict=True)
        }
        chosen = np.concatenate([*seen.values(), [0]]).astype(np.uint32)
        self.primitives = device.resident("paint primitives", table.view(np.uint32))
        self.materials = device.resident("paint materials", materials)
        self.chosen = device.resident("paint chosen", chosen)
        self.kernel = Kernel(
            "optics/paint", BX=self.grid.block[0], BY=self.grid.block[1], J=coefficients.shape[1]
        )

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in (self.primitives, self.materials, self.chosen):
            resident.destroy()

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
