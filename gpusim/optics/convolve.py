"""Space-variant convolution of one frame: rows, columns and lattice, block after block.

Scatter: every source sample is spread by the PSF that belongs to *it*, interpolated bilinearly
between the four PSF nodes of its cell. The weights separate in x and y, so two row spectra and four
column spectra serve the four nodes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels, kernel_spectra, node_kernels, sampled_kernels

# Of a line of so many samples, for shaders/common/line_fft: length = FIRST_RADIX 8^k.
FIRST_RADIX = {32: 4, 64: 8, 128: 2, 256: 4, 512: 8, 1024: 2}


@dataclass(frozen=True)
class Scale:
    """A part of the kernels, and the sim grid on which it is convolved.

    Attributes
    ----------
    name : str
    grid : SimGrid
    pitch_um : float
        Of the sim grid.
    sigma : float
        Gaussian low-pass of the sampled scene, sim samples.
    kernels : FieldKernels
    """

    name: str
    grid: SimGrid
    pitch_um: float
    sigma: float
    kernels: FieldKernels


class Scratch:
    """What one block needs on the device; the next block of the same scale uses it again."""

    def __init__(self, rec: Recording, name: str, grid: SimGrid, planes: int) -> None:
        length = grid.length
        self.planes = rec.buffer(
            f"planes {name}", (planes, grid.block[1], grid.block[0]), np.float32
        )
        self.spectra = rec.buffer(f"spectra {name}", (planes, grid.block[1], length, 2), np.float32)
        pairs = -(-grid.sites // 2)
        self.folded = rec.buffer(
            f"folded {name}", (pairs, grid.window // 2 + 1, grid.window, 2, 2), np.float32
        )


class Convolve:
    """Channel kernels of one scale on the device, and the passes that use them.

    Parameters
    ----------
    device : Device
    scale : Scale
    needed : dict
        Coefficient planes that each block needs; where none of the blocks around a node needs a
        plane, its kernels are left out.
    aperture_um : float
        Side of the pixel aperture.
    site_channels : list of int
        Colour channel of each CFA site, row by row.
    progress : callable, optional
        Called after each PSF node.
    """

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        aperture_um: float,
        site_channels: list[int],
        progress: Callable[[], None] | None = None,
    ) -> None:
        self.grid = grid = scale.grid
        outputs, step = self._outputs(site_channels, scale.kernels.splines.shape[2])
        line = {"T": grid.length, "LANES": grid.length // 8}
        radix = FIRST_RADIX[grid.length]
        lattice = {"D": grid.stride, "M": grid.window, "SITE_RADIX": FIRST_RADIX[grid.window]}
        self.rows = Kernel(
            "optics/rows", **line, FIRST_RADIX=radix, BX=grid.block[0], BY=grid.block[1]
        )
        self.columns = Kernel(
            "optics/columns",
            **line,
            FIRST_RADIX=radix,
            BY=grid.block[1],
            C=len(outputs),
            **lattice,
            PERIOD=grid.period,
            STEP=step,
            PAIRS=-(-grid.sites // 2),
        )
        self.lattice = Kernel("optics/lattice", **line, **lattice, S=grid.sites)
        turns = np.exp(-2j * np.pi * np.arange(grid.length) / grid.length)
        self.twiddle = device.resident("twiddle", turns.astype(np.complex64).view(np.float32))
        self.nodes = {}
        for node, spectra in self._spectra(scale, needed, aperture_um / scale.pitch_um, outputs):
            if spectra is not None:
                label = f"node {node[0]},{node[1]}"
                self.nodes[node] = device.resident(label, spectra.view(np.float32))
            if progress is not None:
                progress()

    def _spectra(
        self,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        width: float,
        outputs: list[tuple[int, float, float]],
    ) -> Iterator[tuple[tuple[int, int], np.ndarray | None]]:
        """Yield every node with its kernels' spectra, None where no block needs them."""
        grid = self.grid
        cross = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
        points: dict[tuple[int, int], np.ndarray] = {}

        def sample(index: tuple[int, int], planes: int) -> np.ndarray:
            x_um, y_um = (np.array(grid.node_position(index)) - grid.centre) * scale.pitch_um
            size = grid.half_size
            return sampled_kernels(scale.kernels, x_um, y_um, scale.pitch_um, size, planes)

        def transform(node: tuple[int, int], planes: int) -> np.ndarray | None:
            if not planes:
                return None
            x, y = node
            kernels = node_kernels(lambda dx, dy: points[x + dx, y + dy][:planes])
            return kernel_spectra(kernels, grid.length, width, scale.sigma, outputs)

        # SciPy and NumPy let go of the interpreter in their loops.
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for y in range(grid.nodes[1]):
                # A node needs its neighbours' kernels: those of three rows are at hand at a time.
                points = {index: kernel for index, kernel in points.items() if index[1] >= y - 1}
                row = {(x, y): grid.planes_at((x, y), needed) for x in range(grid.nodes[0])}
                wanted: dict[tuple[int, int], int] = {}
                for (x, _), planes in row.items():
                    for dx, dy in cross if planes else ():
                        index = (x + dx, y + dy)
                        wanted[index] = max(wanted.get(index, 0), planes)
                lacking = {i: n for i, n in wanted.items() if len(points.get(i, ())) < n}
                found = pool.map(sample, lacking.keys(), lacking.values())
                points.update(zip(lacking, found, strict=True))
                yield from zip(row, pool.map(transform, row.keys(), row.values()), strict=True)

    def _outputs(
        self, site_channels: list[int], channels: int
    ) -> tuple[list[tuple[int, float, float]], int]:
        """Choose what the kernels are made for, and the samples from a site to the next.

        Where a site lies whole samples from the next, the shader shifts one kernel per channel;
        else each site has a kernel of its own.
        """
        grid = self.grid
        first = (
            grid.oversampling - 1
        ) / 2  # a pixel's centre, in samples from the centre of its first sample
        words = [0, 0, 0, 0]
        whole = grid.stride % grid.period == 0
        for site, channel in enumerate(site_channels):
            words[site // 8] |= (channel if whole else site) << (4 * (site % 8))
        self.site_channels = words
        if whole:
            return [(c, first, first) for c in range(channels)], grid.stride // grid.period
        places = [
            (
                channel,
                *(first + grid.oversampling * k for k in (site % grid.period, site // grid.period)),
            )
            for site, channel in enumerate(site_channels)
        ]
        return places, 0

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in (self.twiddle, *self.nodes.values()):
            resident.destroy()

    def record(
        self,
        rec: Recording,
        block: tuple[int, int],
        needed: int,
        scratch: Scratch,
        rates: Array,
        rect: tuple[int, int, int, int],
    ) -> None:
        """Add one block to the planes of the CFA sites.

        Parameters
        ----------
        rec : Recording
        block : (int, int)
        needed : int
            Planes that are not zero in the block.
        scratch : Scratch
            Its planes hold the block's source.
        rates : buffer (S, rows, cols)
            Of the rectangle; electrons/s are added to it.
        rect : (row0, col0, rows, cols)
            Rectangle of pixels, aligned to the CFA period.
        """
        grid = self.grid
        (first_x, step_x), (first_y, step_y) = grid.node_weights(block)
        self.rows.record(
            rec,
            groups=(-(-grid.block[1] // 2), needed, 1),
            params={"first_s": first_x, "step_s": step_x},
            twiddle=self.twiddle,
            planes=scratch.planes,
            spectra=scratch.spectra,
        )
        x, y = grid.cell_of(block)
        self.columns.record(
            rec,
            groups=(grid.window // 2 + 1, 1, 1),
            params={
                "first_s": first_y,
                "step_s": step_y,
                "planes": needed,
                "site_channels": self.site_channels,
            },
            twiddle=self.twiddle,
            spectra=scratch.spectra,
            kernels_00=self.nodes[x, y],
            kernels_10=self.nodes[x + 1, y],
            kernels_01=self.nodes[x, y + 1],
            kernels_11=self.nodes[x + 1, y + 1],
            folded=scratch.folded,
        )
        row0, col0, rows, cols = (-(-value // grid.period) for value in rect)
        origin = grid.window_origin(block)
        self.lattice.record(
            rec,
            groups=(grid.window // grid.stride, -(-grid.sites // 4), 1),
            params={"origin": (origin[0] - col0, origin[1] - row0), "size": (cols, rows)},
            twiddle=self.twiddle,
            folded=scratch.folded,
            rates=rates,
        )
