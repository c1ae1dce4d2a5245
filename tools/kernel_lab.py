#!/usr/bin/env python
"""Time the methods of the space-variant convolution side by side: check first, time second.

All blur one frame of noise with the same PSF everywhere, given to each as the method wants it: at
PSF nodes, as modes that sum up to it, as taps. So all must agree; and as the time depends on sizes
alone, so would PSFs that change. Printed is each method's time for a pixel and a plane, and its
ratio to the first line. On a busy machine long runs are interrupted more often than short ones, and
where the device is the processor the ratio of processor times holds better. tools/record.md keeps
what was found.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator

import numpy as np

from gpusim.gpu import Device, Recording, default_device
from gpusim.optics.convolve import Convolve
from gpusim.optics.direct import Direct
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.modes import Decomposition, Modes
from gpusim.optics.nodes import Rates, Scale
from gpusim.optics.sampling import sampled_kernels
from gpusim.psf.places import Heights

SITES = [0, 1, 1, 2]
PITCH_UM = 0.775
RUNS = 10  # the best counts
# Share of the largest rate: what the supports cut off, and what splines lose when they are turned.
AGREE = 2e-3


def scale_of(grid: SimGrid, planes: int, sigma_um: float) -> Scale:
    """Return a scale with Gaussian PSFs, alike over the field."""
    line = (np.arange(192) - 96) * 0.5
    blob = np.exp(-(line**2 + line[:, None] ** 2) / (2 * sigma_um**2)).astype(np.float32)
    kernels = np.tile(blob, (4, planes, 3, 1, 1))
    heights = Heights(np.array([0.0, 1e4, 2e4]))  # any place is made of four fields
    return Scale("lab", grid, PITCH_UM, 0.0, FieldKernels(kernels, heights, 0.5))


def stages(device: Device, pixels: int, planes: int, reach: int) -> Iterator[tuple[str, object]]:
    """Yield each method's name and the method, ready to record."""

    def on(length: int, half_size: int, cells: int) -> tuple:
        grid = SimGrid(pixels, pixels, 4, 2, length, half_size, (cells, cells))
        needed = dict.fromkeys(np.ndindex(grid.blocks), planes)
        return device, scale_of(grid, planes, reach * PITCH_UM / 5), needed, PITCH_UM, SITES

    half = -(-(reach + 8) // 4) * 4
    for length in (256, 512):
        cells = -(-(2 * pixels + 2 * half) // (length - 2 * half))
        yield f"four nodes, T {length}", Convolve(*on(length, half, cells))
    for length in (256, 512):
        for rank in (1, 2, 4, 8):
            arguments = on(length, half, 1)
            parts = parts_of(arguments[1], rank, planes)
            yield f"{rank} modes, T {length}", Modes(*arguments, decomposition=parts)
    close = -(-(reach + 2) // 4) * 4
    for cells in (8, 2):
        name = f"direct, {2 * reach} taps, {cells} x {cells} cells"
        yield name, Direct(*on(1024, close, cells), support=reach)


def parts_of(scale: Scale, rank: int, planes: int) -> Decomposition:
    """Return equal parts of the PSF as modes."""
    kernel = sampled_kernels(scale.kernels, 0.0, 0.0, PITCH_UM, scale.grid.half_size, planes=planes)
    parts = np.stack([kernel.astype(np.float32) / rank] * rank)
    return Decomposition(parts, np.ones((rank, 9, 9)), np.ones(rank), np.ones(rank))


def recorded(device: Device, stage, planes: int, noise: np.ndarray) -> tuple[Recording, str]:
    """Return what blurs a frame of noise, and the label of its rates."""
    grid = stage.grid
    # The scene ends with the sensor: sources around it stay dark, however far the blocks reach.
    margin = -min(grid.start)
    source = np.pad(noise.astype(np.float32), ((0, 0), (margin, 2 * margin), (margin, 2 * margin)))
    stage.load(grid.blocks_for(0, 0, grid.rows, grid.cols))
    rec = Recording(device)
    rates = rec.buffer("rates", (grid.sites, grid.rows // 2, grid.cols // 2), np.float32)
    rec.clear(rates)
    scratch = stage.scratch(rec, planes)
    frame = (0, 0, grid.rows, grid.cols)
    for block in grid.blocks_for(*frame):
        x, y = (origin + margin for origin in grid.block_origin(block))
        part = source[:, y : y + grid.block[1], x : x + grid.block[0]]
        whole = np.zeros(scratch.planes.shape, np.float32)
        whole[:, : part.shape[1], : part.shape[2]] = part
        rec.upload(scratch.planes, whole)
        stage.record(rec, block, planes, scratch, Rates(rates, frame))
    return rec, rec.download(rates)


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pixels", type=int, default=512, help="side of the frame")
    parser.add_argument("--planes", type=int, default=1)
    parser.add_argument("--reach", type=int, default=8, help="of the PSF, sim samples")
    options = parser.parse_args()
    device = default_device()
    shape = (options.planes, 2 * options.pixels, 2 * options.pixels)
    noise = np.random.default_rng(1).random(shape)
    made = {}
    first = None
    for name, stage in stages(device, options.pixels, options.planes, options.reach):
        rec, label = recorded(device, stage, options.planes, noise)
        made[name] = rec
        rates = rec.run()[label]
        first = rates if first is None else first
        error = np.abs(rates - first).max() / first.max()
        if error > AGREE:
            print(f"{name} differs from the first by {error:.1e} of {AGREE}", file=sys.stderr)
            return 1
    best: dict[str, dict[str, float]] = {}
    busy: dict[str, float] = {}
    for _ in range(RUNS):  # in turns, so that all see the same load
        for name, rec in made.items():
            started = time.process_time()
            times = rec.run().times_s
            spent = time.process_time() - started
            best[name] = min(best.get(name, times), times, key=lambda one: sum(one.values()))
            busy[name] = min(busy.get(name, spent), spent)
    reference, first_busy = sum(next(iter(best.values())).values()), next(iter(busy.values()))
    for name, times in best.items():
        seconds = sum(times.values())
        parts = ", ".join(f"{k.rpartition('/')[2]} {v * 1e3:.1f}" for k, v in times.items())
        each = seconds / options.pixels**2 / options.planes * 1e9
        print(
            f"{name:38} {each:8.1f} ns  ratio {seconds / reference:5.2f}, "
            f"of processor time {busy[name] / first_busy:5.2f}  ({parts} ms)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
