"""How a frame is cut into blocks: the cheapest grid whose kernels fit the memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.errors import UserError
from gpusim.optics.grid import SimGrid
from gpusim.sensor.sensor import Sensor

KERNEL_BYTES = (
    640 << 20
)  # of the 1 GiB that the device may use; the rest is for planes, frames and scratch
TRANSFORMS = (256, 512, 1024)  # lengths that shaders/common/line_fft takes


def cheapest_grid(
    sensor: Sensor,
    stride: int,
    period: int,
    reach: float,
    cells: tuple[int, int],
    needed: Callable[[SimGrid], dict[tuple[int, int], int]],
) -> SimGrid:
    """Return the grid that takes the least work, among those whose kernels fit the memory.

    `reach` of the kernels in sim samples; `cells` are the fewest that the tolerance allows;
    `needed` returns the planes that each block of a grid needs.
    """
    # 8 samples: half an aperture, half a sample to the pixel's centre, and the ringing of the
    # band's end.
    half_size = int(np.ceil((reach + 8) / stride)) * stride
    channels = len(sensor.channels) if stride % period == 0 else period**2
    best = None
    for length in TRANSFORMS:
        largest = (length - 2 * half_size) // stride * stride
        if largest < 8 * stride:
            continue
        for blocks in range(1, 5):
            extent = SimGrid(
                sensor.rows, sensor.cols, stride, period, length, half_size, cells
            ).extent
            finer = tuple(
                max(count, -(-size // (blocks * largest)))
                for count, size in zip(cells, extent, strict=True)
            )
            grid = SimGrid(sensor.rows, sensor.cols, stride, period, length, half_size, finer)
            planes = needed(grid)
            at_nodes = sum(grid.planes_at(node, planes) for node in np.ndindex(grid.nodes))
            if at_nodes * channels * (length // 2 + 1) * length * 8 > KERNEL_BYTES:
                continue
            # The inverse transforms and the products of a block cost about as much as the forward
            # ones of a plane.
            work = (
                sum(1 + count for count in planes.values() if count) * length**2 * np.log2(length)
            )
            if best is None or work < best[0]:
                best = (work, grid)
    if best is None:
        raise UserError(
            "The kernels of this lens do not fit: its PSF is too wide or changes too fast.",
            field="tolerance",
            value=f"{2 * half_size} sim samples wide, {cells[0] + 1} x {cells[1] + 1} PSF nodes",
            allowed=f"{TRANSFORMS[-1] - 8 * stride} samples, {KERNEL_BYTES >> 20} MiB of kernels: "
            "a looser tolerance, or a smaller region of the sensor",
        )
    return best[1]
