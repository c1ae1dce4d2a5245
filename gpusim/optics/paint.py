"""Host side of the paint stage: a chart's primitives, low-passed and sampled on the sim grid."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, Resident
from gpusim.optics.chief_ray import ChiefRayMap, block_bounds_um
from gpusim.optics.convolve import Scale
from gpusim.optics.grid import SimGrid
from gpusim.optics.paint_table import table_of, with_steps
from gpusim.scene.chart import Chart, Disc, Polygon, Primitive

# Standard deviation of the Gaussian low-pass, sim samples. At 0.8 the alias of an edge's 0.75
# cycles/sample is exp(-2 pi^2 0.8^2 (0.75^2 - 0.25^2)) = 0.2 % of what it disturbs, and the inverse
# in the kernels stays below 24.
SIGMA = 0.8
PLANES = 8  # that a dispatch of it paints
TILE = 16  # side of the tiles of shaders/optics/paint, samples
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
        Coefficients of the chart's materials.
    grid : SimGrid
    pitch_um : float
        Pitch of the sim grid.
    chief_ray : ChiefRayMap

    Returns
    -------
    seen : dict of ndarray
        Indices of primitives, in painter's order, by block.
    needed : dict of int
        By block: planes beyond these have no coefficient in it; beyond the image circle, all.
    """
    near, planes = _blocks_and_primitives(chart, coefficients, grid, pitch_um, chief_ray)
    seen = {block: np.flatnonzero(row) for block, row in zip(planes, near, strict=True)}
    return seen, planes


def planes_by_block(
    chart: Chart, coefficients: np.ndarray, grid: SimGrid, pitch_um: float, chief_ray: ChiefRayMap
) -> dict[tuple[int, int], int]:
    """Count the planes that each block needs: see `primitives_by_block`."""
    return _blocks_and_primitives(chart, coefficients, grid, pitch_um, chief_ray)[1]


def _blocks_and_primitives(
    chart: Chart, coefficients: np.ndarray, grid: SimGrid, pitch_um: float, chief_ray: ChiefRayMap
) -> tuple[np.ndarray, dict[tuple[int, int], int]]:
    """Return whether each block sees each primitive, and the planes that it needs."""
    bounds_um = np.array([(shape.cx, shape.cy, shape.reach) for shape in chart.primitives]).reshape(
        -1, 3
    )
    material = np.array([shape.material for shape in chart.primitives], int)
    last_plane = np.array([np.flatnonzero(row)[-1] + 1 if row.any() else 0 for row in coefficients])
    low, high, lit = block_bounds_um(grid, pitch_um, chief_ray, REACH)
    # One axis after the other: pairs along a third axis take seven times as long.
    near = np.ones((len(low), len(bounds_um)), bool)
    for axis in (0, 1):
        near &= bounds_um[:, axis] + bounds_um[:, 2] > low[:, axis, None]
        near &= bounds_um[:, axis] - bounds_um[:, 2] < high[:, axis, None]
    planes = np.full(len(low), last_plane[chart.background])
    for count in np.unique(last_plane[material]):  # few: one product for all takes longer
        planes[near[:, last_plane[material] == count].any(axis=1) & (planes < count)] = count
    across = grid.blocks[0]
    blocks = [(index % across, index // across) for index in range(len(near))]
    return near, dict(zip(blocks, (planes * lit).tolist(), strict=True))


def samples_at_edges(chart: Chart, half_um: tuple[float, float], pitch_um: float) -> float:
    """Estimate the work at edges: samples of tiles that see one, counted for each primitive.

    Parameters
    ----------
    chart : Chart
        Placed, in um on the ideal plane.
    half_um : (float, float)
        Half the width and height of the frame.
    pitch_um : float
        Pitch of the sim grid.
    """
    near_um = (TILE / np.sqrt(2) + 6 * SIGMA) * pitch_um
    area = 0.0
    for shape in chart.primitives:
        band = _band(shape, near_um)
        # The part of its box that lies in the frame.
        box = [
            (min(at + shape.reach, end) - max(at - shape.reach, -end)) / (2 * shape.reach)
            for at, end in zip((shape.cx, shape.cy), half_um, strict=True)
        ]
        area += band * max(box[0], 0.0) * max(box[1], 0.0)
    return float(area) / pitch_um**2


def _band(shape: Primitive, near: float) -> float:
    """Return about the area that is nearer than that to a shape's outline."""
    if isinstance(shape, Polygon):
        ways = np.diff(shape.corners(), axis=0, append=shape.points[:1])
        most = 4.0 * (shape.reach + near) ** 2
        return float(min(2 * near * np.hypot(*ways.T).sum(), most))
    disc = isinstance(shape, Disc)
    half = (shape.radius, shape.radius) if disc else (shape.half_w, shape.half_h)
    band = 4.0 * np.prod([side + near for side in half])
    band -= 4.0 * np.prod([max(side - near, 0.0) for side in half])
    return float(band) * (np.pi / 4 if disc else 1.0)


def tiles_by_block(
    chart: Chart,
    blocks: Sequence[tuple[int, int]],
    seen: dict[tuple[int, int], np.ndarray],
    needed: dict[tuple[int, int], int],
    *,
    scale: Scale,
    chief_ray: ChiefRayMap,
) -> tuple[np.ndarray, np.ndarray, dict[tuple[int, int], tuple[int, int, int]]]:
    """List the primitives that have an edge in each tile of each block.

    The last primitive that covers a whole tile is the tile's ground.

    Parameters
    ----------
    chart : Chart
        Placed, in um on the ideal plane.
    blocks : sequence of (int, int)
        Blocks whose lists are made.
    seen, needed : dict
        As `primitives_by_block` returns them.
    scale : Scale
    chief_ray : ChiefRayMap

    Returns
    -------
    tiles : ndarray (T, 4), uint32
        As shaders/optics/paint reads them. Each block's tiles without edges come first.
    chosen : ndarray, uint32
        Indices of primitives to which the tiles refer.
    ranges : dict of (int, int, int)
        By block: its first tile, its tiles without edges, its tiles with edges.
    """
    grid = scale.grid
    # From a tile's middle to its corners, and the Gaussian's reach: Phi(-6) = 1e-9.
    reach_um = (TILE / np.sqrt(2) + 6 * scale.sigma) * scale.pitch_um
    across, down = (np.arange(0, side, TILE) for side in grid.block)
    corners = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    tiles: list[tuple[int, int, int, int]] = []
    chosen: list[int] = []
    ranges = {}
    for block in blocks:
        numbers = seen[block]
        corner = np.array(grid.block_origin(block)) - grid.centre
        middle_um = (corner + corners + TILE / 2) * scale.pitch_um
        u, v = chief_ray.ideal_um(middle_um).T
        distance_um = np.reshape(
            [chart.primitives[n].distance(u, v) for n in numbers], (len(numbers), len(corners))
        )
        off_um = np.hypot(*(middle_um - chief_ray.centre_um).T)
        rim = off_um > chief_ray.radius_um - reach_um
        # By how much the map stretches what is so near; 1.01 for f32.
        stretch = chief_ray.stretch_within(off_um - reach_um, off_um + reach_um)
        margins_um = 1.01 * stretch * reach_um
        with_edges = []
        first = len(tiles)
        for place, (x, y) in enumerate(corners):
            ground, near, margin_um = chart.background, [], margins_um[place]
            for n, distance in zip(numbers, distance_um[:, place], strict=True):
                if distance < -margin_um:  # so do those around it, which come before
                    ground = chart.primitives[n].material
                elif distance < margin_um:
                    near.append(n)
            tile = (x + 65536 * y, len(chosen), len(near), ground + 65536 * needed[block])
            chosen += near
            (with_edges if near or rim[place] else tiles).append(tile)
        ranges[block] = (first, len(tiles) - first, len(with_edges))
        tiles += with_edges
    return np.array(tiles, np.uint32), np.array([*chosen, 0], np.uint32), ranges


class Paint:
    """A chart on the device.

    Parameters
    ----------
    device : Device
    chart : Chart
        Placed, in um on the ideal plane.
    coefficients : ndarray (M, J)
        Coefficients of the chart's materials in the reduced basis.
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
        self.device, self.chart, self.scale, self.chief_ray = device, chart, scale, chief_ray
        own = [shape.material for shape in chart.primitives]
        rows, steps = with_steps(coefficients, own, chart.under)
        table, corners = table_of(
            chart.primitives, steps, scale.pitch_um, scale.sigma, chief_ray.least_stretch
        )
        groups = range(0, coefficients.shape[1], PLANES)
        materials = np.zeros((len(groups), len(rows), PLANES), np.float32)
        for first, of_group in zip(groups, materials, strict=True):
            part = rows[:, first : first + PLANES]
            of_group[:, : part.shape[1]] = part
        self.seen, self.needed = primitives_by_block(
            chart, coefficients, scale.grid, scale.pitch_um, chief_ray
        )
        self.primitives = device.resident("paint primitives", table.view(np.uint32))
        self.corners = device.resident("paint corners", corners)
        self.materials = [device.resident("paint materials", of_group) for of_group in materials]
        self.terms = device.resident("paint terms", chief_ray.terms(scale.pitch_um))
        self.ranges: dict[tuple[int, int], tuple[int, int, int]] = {}
        self.lists: tuple[Resident, ...] = ()
        size = {"BX": self.grid.block[0], "BY": self.grid.block[1]}
        size |= {"AXIS": chief_ray.has_axis, "DISTORTION": chief_ray.distortion}
        counts = [min(PLANES, coefficients.shape[1] - first) for first in groups]
        made = {
            count: [Kernel("optics/paint", **size, J=count, EDGES=edges) for edges in (False, True)]
            for count in set(counts)
        }
        self.kernels = [made[count] for count in counts]

    def prepare(self, blocks: Sequence[tuple[int, int]]) -> None:
        """List the tiles of blocks, unless that was done before; the lists stay on the device."""
        if not self.ranges.keys() >= set(blocks):
            wanted = sorted({*self.ranges, *blocks}, key=lambda block: block[::-1])
            tiles, chosen, self.ranges = tiles_by_block(
                self.chart,
                wanted,
                self.seen,
                self.needed,
                scale=self.scale,
                chief_ray=self.chief_ray,
            )
            for resident in self.lists:
                resident.destroy()
            self.lists = (
                self.device.resident("paint tiles", tiles),
                self.device.resident("paint chosen", chosen),
            )

    def load_bytes(self, blocks: Sequence[tuple[int, int]]) -> int:
        """Return the device memory that `load` takes: none."""
        return 0

    def load(self, blocks: Sequence[tuple[int, int]]) -> None:
        """Do nothing: all that blocks need is on the device after `prepare`."""

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in (self.primitives, self.corners, *self.materials, self.terms, *self.lists):
            resident.destroy()

    def record(self, rec: Recording, block: tuple[int, int], planes: Array) -> None:
        """Paint one block of the sim grid into `planes` (J, BY, BX), after `prepare`."""
        grid = self.grid
        tiles, chosen = self.lists
        first, plain, with_edges = self.ranges[block]
        corner = np.array(grid.block_origin(block)) + 0.5
        tiles_of = (first, plain), (first + plain, with_edges)
        groups = -(-max(self.needed[block], 1) // PLANES)
        for group, edges in product(range(groups), (0, 1)):
            start, count = tiles_of[edges]
            self.kernels[group][edges].record(
                rec,
                groups=(count, 1, 1),
                params={
                    **self.chief_ray.params(self.pitch_um),
                    "origin": corner - grid.centre,
                    "sigma": self.sigma,
                    "first": start,
                    "plane": PLANES * group,
                },
                primitives=self.primitives,
                corners=self.corners,
                chosen=chosen,
                materials=self.materials[group],
                tiles=tiles,
                terms=self.terms,
                planes=planes,
            )
