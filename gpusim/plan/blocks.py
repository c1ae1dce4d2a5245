"""How a frame is cut into blocks: the cheapest grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu.pool import MAX_BINDING_BYTES
from gpusim.optics.grid import SimGrid
from gpusim.plan.predict import GUARD
from gpusim.sensor.sensor import Sensor

# Kernels around one block: half of the 1 GiB that the device may use.
BLOCK_BYTES = 512 << 20
TRANSFORMS = (256, 512, 1024)  # lengths that shaders/common/line_fft takes

Needed = dict[tuple[int, int], int]


@dataclass(frozen=True)
class Memory:
    """Bytes of the kernels around a block, and of the largest buffer."""

    block_bytes: int
    largest_bytes: int


@dataclass(frozen=True)
class Layout:
    """A grid and the work on it.

    Attributes
    ----------
    grid : SimGrid
    needed : dict of int
        Planes that each block needs.
    seconds : dict of float
        Predicted for a frame, by stage; "dispatch" for what the dispatches cost beside.
    kernels_s : float
        Predicted for the kernels, which are made once.
    """

    grid: SimGrid
    needed: Needed
    seconds: dict[str, float]
    kernels_s: float

    @property
    def frame_s(self) -> float:
        """Predicted seconds of a frame."""
        return sum(self.seconds.values())

    @property
    def cost_s(self) -> float:
        """Predicted seconds of the first frame, its kernels included."""
        return self.frame_s + self.kernels_s


class Work(Protocol):
    """The work of a way to convolve, on any grid."""

    def needed(self, grid: SimGrid) -> Needed:
        """Return the planes that each block of a grid needs."""

    def seconds(self, grid: SimGrid, needed: Needed) -> dict[str, float]:
        """Return the predicted seconds of a frame, by stage."""

    def kernels_s(self, grid: SimGrid, needed: Needed) -> float:
        """Return the predicted seconds for the kernels."""

    def memory(self, grid: SimGrid, needed: Needed) -> Memory:
        """Return what the kernels take."""


def cheapest_grid(
    sensor: Sensor,
    work: Work,
    reach: float,
    cells: tuple[int, int],
    *,
    stride: int,
    period: int,
    layers: int = 1,
) -> Layout:
    """Return the grid that takes the least time for one frame, among those that fit the memory.

    Parameters
    ----------
    sensor : Sensor
    work : Work
    reach : float
        Reach of the kernels, sim samples.
    cells : (int, int)
        The fewest that the tolerance allows.
    stride, period, layers : int
        See `SimGrid`.

    Raises
    ------
    UserError
        When none fits.
    """
    aligned = max(stride, 4)  # see SimGrid.alignment
    half_size = int(np.ceil((reach + GUARD) / aligned)) * aligned
    best = None
    for length in TRANSFORMS:
        largest = (length - 2 * half_size) // aligned * aligned
        if largest < 8 * stride:
            continue
        extent = SimGrid(sensor.rows, sensor.cols, stride, period, length, half_size, cells).extent
        # As few cells as are allowed, in so many blocks each way; more cells take fewer blocks.
        choices = {
            tuple(
                max(count, -(-size // (blocks * largest)))
                for count, size in zip(cells, extent, strict=True)
            )
            for blocks in range(1, 5)
        }
        for finer in sorted(choices):
            if any(n * 2 * stride > size for n, size in zip(finer, extent, strict=True)):
                continue
            grid = SimGrid(
                sensor.rows, sensor.cols, stride, period, length, half_size, finer, layers
            )
            planes = work.needed(grid)
            taken = work.memory(grid, planes)
            if taken.block_bytes > BLOCK_BYTES or taken.largest_bytes > MAX_BINDING_BYTES:
                continue
            found = Layout(grid, planes, work.seconds(grid, planes), work.kernels_s(grid, planes))
            if best is None or found.cost_s < best.cost_s:
                best = found
    if best is None:
        raise UserError(
            "The kernels of this lens do not fit: its PSF is too wide or changes too fast.",
            field="tolerance",
            value=f"{2 * half_size} sim samples wide, {cells[0] + 1} x {cells[1] + 1} PSF nodes",
            allowed=f"{TRANSFORMS[-1] - 8 * stride} samples, {BLOCK_BYTES >> 20} MiB of kernels "
            f"around a block, nodes at least {2 * stride} samples apart: a looser tolerance",
        )
    return best


def planes_at_nodes(
    grid: SimGrid, needed: Needed, folds: tuple[bool, bool] = (False, False)
) -> np.ndarray:
    """Return the planes of each node's kernels: the most that a block around it needs.

    `gpusim.optics.nodes.folds_of` says which blocks are mirror images of others.
    """
    across, down = grid.blocks_per_cell
    planes = np.zeros(grid.blocks, int)
    planes[tuple(np.array(list(needed)).T)] = list(needed.values())
    by_cell = planes.reshape(grid.cells[0], across, grid.cells[1], down).max(axis=(1, 3))
    for axis in (axis for axis in (0, 1) if folds[axis]):
        by_cell = np.maximum(by_cell, np.flip(by_cell, axis))
        near = -(-grid.cells[axis] // 2)
        by_cell[(slice(None),) * axis + (slice(near, None),)] = 0
    around = np.pad(by_cell, 1)
    corners = [around[x:, y:][: grid.nodes[0], : grid.nodes[1]] for x in (0, 1) for y in (0, 1)]
    return np.maximum.reduce(corners)


def planes_at_points(planes: np.ndarray, mirrored: tuple[bool, bool]) -> int:
    """Return the planes of PSFs that are sampled for nodes, all points together.

    Each node counts, and so do those beside it (see `gpusim.optics.sampling.node_kernels`), the
    ones beyond the grid included: with few nodes these are nearly as many again. Where kernels are
    mirrored, points on one side of the axis serve the other.

    Parameters
    ----------
    planes : ndarray (across, down)
        As `planes_at_nodes` returns them.
    mirrored : (bool, bool)
        Whether nodes lie symmetrically in x, in y, and their kernels are mirror images.
    """
    around = np.pad(planes, 2)
    cross = [around[1 + x :, 1 + y :] for x, y in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))]
    across, down = (count + 2 for count in planes.shape)
    points = np.maximum.reduce([part[:across, :down] for part in cross])
    if mirrored[0]:
        points = np.maximum(points, points[::-1])[: -(-across // 2)]
    if mirrored[1]:
        points = np.maximum(points, points[:, ::-1])[:, : -(-down // 2)]
    return int(points.sum())
