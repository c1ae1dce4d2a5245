"""How a frame is cut into blocks: the cheapest grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu.pool import MAX_BINDING_BYTES
from gpusim.optics.grid import SimGrid
from gpusim.sensor.sensor import Sensor

# Of the kernels around one block: half of the 1 GiB that the device may use.
BLOCK_BYTES = 512 << 20
TRANSFORMS = (256, 512, 1024)  # lengths that shaders/common/line_fft takes
# Measured on lavapipe with 2 cores (2028 x 1520 pixels, 3 planes, 3 channels, transforms of 256):
# ns for each sample of a transform and its log2, of a block's planes and its inverse; for each
# sample of a kernel's spectrum, and of the kernel in space, as it is made on the host.
TRANSFORM_NS, SPECTRUM_NS, KERNEL_NS = 3.6, 7.5, 30.0


def cheapest_grid(
    sensor: Sensor,
    stride: int,
    period: int,
    reach: float,
    cells: tuple[int, int],
    needed: Callable[[SimGrid], dict[tuple[int, int], int]],
) -> SimGrid:
    """Return the grid that takes the least time for one frame, its kernels included.

    `reach` of the kernels in sim samples; `cells` are the fewest that the tolerance allows;
    `needed` returns the planes that each block of a grid needs.
    """
    # 8 samples: half an aperture, half a sample to the pixel's centre, and the ringing of the
    # band's end.
    half_size = int(np.ceil((reach + 8) / stride)) * stride
    outputs = len(sensor.channels) if stride % period == 0 else period**2
    best = None
    for length in TRANSFORMS:
        step = max(stride, 4)  # see SimGrid.alignment
        largest = (length - 2 * half_size) // step * step
        if largest < 8 * stride:
            continue
        node_bytes = outputs * (length // 2 + 1) * length * 8  # a plane
        kernel_ns = outputs * (SPECTRUM_NS * length**2 + KERNEL_NS * (2 * half_size) ** 2)
        for blocks in range(1, 5):
            extent = SimGrid(
                sensor.rows, sensor.cols, stride, period, length, half_size, cells
            ).extent
            finer = tuple(
                max(count, -(-size // (blocks * largest)))
                for count, size in zip(cells, extent, strict=True)
            )
            if any(n * 2 * stride > size for n, size in zip(finer, extent, strict=True)):
                continue
            grid = SimGrid(sensor.rows, sensor.cols, stride, period, length, half_size, finer)
            planes = needed(grid)
            most = max(planes.values())
            if most * node_bytes > MAX_BINDING_BYTES or 4 * most * node_bytes > BLOCK_BYTES:
                continue
            # The inverse transforms and the products of a block cost about as much as the forward
            # ones of a plane.
            transforms = sum(1 + count for count in planes.values() if count)
            at_nodes = sum(grid.planes_at(node, planes) for node in np.ndindex(grid.nodes))
            work_ns = TRANSFORM_NS * transforms * length**2 * np.log2(length) + kernel_ns * at_nodes
            if best is None or work_ns < best[0]:
                best = (work_ns, grid)
    if best is None:
        raise UserError(
            "The kernels of this lens do not fit: its PSF is too wide or changes too fast.",
            field="tolerance",
            value=f"{2 * half_size} sim samples wide, {cells[0] + 1} x {cells[1] + 1} PSF nodes",
            allowed=f"{TRANSFORMS[-1] - 8 * stride} samples, {BLOCK_BYTES >> 20} MiB of kernels "
            f"around a block, nodes at least {2 * stride} samples apart: a looser tolerance",
        )
    return best[1]
