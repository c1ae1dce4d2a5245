"""Space-variant convolution of one frame: rows, columns and lattice, block after block.

Scatter: every source sample is spread by the PSF that belongs to *it*, interpolated bilinearly
between the four PSF nodes of its cell. The weights separate in x and y, so two row spectra and four
column spectra serve the four nodes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, Resident
from gpusim.gpu.pool import size_class
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels, kernel_spectra, node_kernels, sampled_kernels

Node = tuple[int, int]  # x, y of a PSF node
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
        self.planes, self.spectra, self.folded = (
            rec.buffer(f"{label} {name}", shape, np.float32)
            for label, shape in self.shapes(grid, planes).items()
        )

    @staticmethod
    def shapes(grid: SimGrid, planes: int) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array, of floats."""
        pairs = -(-grid.sites // 2)
        return {
            "planes": (planes, grid.block[1], grid.block[0]),
            "spectra": (planes, grid.block[1], grid.length, 2),
            "folded": (pairs, grid.window // 2 + 1, grid.window, 2, 2),
        }

    @classmethod
    def nbytes(cls, grid: SimGrid, planes: int) -> int:
        """Return the device memory that the arrays take."""
        return sum(size_class(4 * math.prod(s)) for s in cls.shapes(grid, planes).values())


class Convolve:
    """Channel kernels of one scale, and the passes that use them.

    Kernels come onto the device with `load`, and stay there until `shed` or `release`.

    Parameters
    ----------
    device : Device
    scale : Scale
    needed : dict
        Coefficient planes that each block needs; where none of the blocks around a node needs a
        plane, its kernels have no such plane.
    aperture_um : float
        Side of the pixel aperture.
    site_channels : list of int
        Colour channel of each CFA site, row by row.

    Attributes
    ----------
    nodes : dict of Resident
        Kernels on the device by PSF node, the last used last.
    made : int
        Kernels of how many nodes were made so far.
    """

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        aperture_um: float,
        site_channels: list[int],
    ) -> None:
        self.device, self.scale, self.needed = device, scale, needed
        self.grid = grid = scale.grid
        self.outputs, step = self._outputs(site_channels, scale.kernels.splines.shape[2])
        self.aperture = aperture_um / scale.pitch_um  # sim samples
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
            C=len(self.outputs),
            **lattice,
            PERIOD=grid.period,
            STEP=step,
            PAIRS=-(-grid.sites // 2),
        )
        self.lattice = Kernel("optics/lattice", **line, **lattice, S=grid.sites)
        turns = np.exp(-2j * np.pi * np.arange(grid.length) / grid.length)
        self.twiddle = device.resident("twiddle", turns.astype(np.complex64).view(np.float32))
        self.nodes: dict[Node, Resident] = {}
        self.made = 0
        self._points: dict[Node, np.ndarray] = {}  # kernels at nodes, to make others of them

    def nodes_of(self, blocks: Iterable[tuple[int, int]]) -> set[Node]:
        """Return the PSF nodes around blocks."""
        cells = {self.grid.cell_of(block) for block in blocks}
        return {(x + dx, y + dy) for x, y in cells for dx in (0, 1) for dy in (0, 1)}

    def node_bytes(self, node: Node) -> int:
        """Return the device memory that the kernels of a node take."""
        length, planes = self.grid.length, self.grid.planes_at(node, self.needed)
        return size_class(planes * len(self.outputs) * (length // 2 + 1) * length * 8)

    def load_bytes(self, blocks: Iterable[tuple[int, int]]) -> int:
        """Return the device memory that the kernels of blocks take together."""
        return sum(map(self.node_bytes, self.nodes_of(blocks)))

    def missing_bytes(self, blocks: Iterable[tuple[int, int]]) -> int:
        """Return the device memory that `load` takes in addition."""
        return sum(map(self.node_bytes, self.nodes_of(blocks) - self.nodes.keys()))

    def block_bytes(self, planes: int) -> int:
        """Return the device memory that the kernels of one block of so many planes take."""
        length = self.grid.length
        return 4 * size_class(planes * len(self.outputs) * (length // 2 + 1) * length * 8)

    @property
    def held_bytes(self) -> int:
        """Device memory that kernels take now."""
        return sum(size_class(kernels.nbytes) for kernels in self.nodes.values())

    def load(
        self,
        blocks: Iterable[tuple[int, int]],
        progress: Callable[[], None] | None = None,
    ) -> None:
        """Make those kernels of blocks that are not on the device.

        Parameters
        ----------
        blocks : iterable of (int, int)
            Each of them needs a plane.
        progress : callable, optional
            Called after each PSF node.
        """
        wanted = sorted(self.nodes_of(blocks), key=lambda node: node[::-1])
        for node, spectra in self._spectra([node for node in wanted if node not in self.nodes]):
            label = f"node {node[0]},{node[1]}"
            self.nodes[node] = self.device.resident(label, spectra.view(np.float32))
            self.made += 1
            if progress is not None:
                progress()
        for node in wanted:
            self.nodes[node] = self.nodes.pop(node)

    def shed(self, nbytes: int, blocks: Iterable[tuple[int, int]] = ()) -> int:
        """Drop kernels that blocks do not use, until so many bytes are free; return how many are.

        The last used first: frames are worked through in the same order again and again, and what
        was used just now is what will be wanted last.
        """
        wanted, freed = self.nodes_of(blocks), 0
        for node in [node for node in reversed(self.nodes) if node not in wanted]:
            if freed >= nbytes:
                break
            freed += self.node_bytes(node)
            self.nodes.pop(node).destroy()
        return freed

    def _spectra(self, nodes: list[Node]) -> Iterator[tuple[Node, np.ndarray]]:
        """Yield nodes, given row by row, with their kernels' spectra."""
        grid, scale = self.grid, self.scale
        cross = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
        points = self._points

        def sample(index: tuple[int, int], planes: int) -> np.ndarray:
            x_um, y_um = (np.array(grid.node_position(index)) - grid.centre) * scale.pitch_um
            size = grid.half_size
            return sampled_kernels(scale.kernels, x_um, y_um, scale.pitch_um, size, planes)

        def transform(node: Node, planes: int) -> np.ndarray:
            x, y = node
            kernels = node_kernels(lambda dx, dy: points[x + dx, y + dy][:planes])
            return kernel_spectra(kernels, grid.length, self.aperture, scale.sigma, self.outputs)

        # SciPy and NumPy let go of the interpreter in their loops.
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for y, of_row in groupby(nodes, key=lambda node: node[1]):
                # A node needs its neighbours' kernels: those of three rows are at hand at a time.
                for index in [index for index in points if abs(index[1] - y) > 1]:
                    del points[index]
                row = {node: grid.planes_at(node, self.needed) for node in of_row}
                wanted: dict[Node, int] = {}
                for (x, _), planes in row.items():
                    for dx, dy in cross:
                        index = (x + dx, y + dy)
                        wanted[index] = max(wanted.get(index, 0), planes)
                lacking = {i: n for i, n in wanted.items() if len(points.get(i, ())) < n}
                found = pool.map(sample, lacking.keys(), lacking.values())
                points.update(zip(lacking, found, strict=True))
                # A few at a time: the spectra of a whole row may be gigabytes.
                step = 2 * (os.cpu_count() or 1)
                for first in range(0, len(row), step):
                    part = dict(list(row.items())[first : first + step])
                    yield from zip(part, pool.map(transform, part, part.values()), strict=True)

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
        self.nodes.clear()
        self._points.clear()

    def record(
        self,
        rec: Recording,
        block: tuple[int, int],
        needed: int,
        scratch: Scratch,
        rates: Array,
        rect: tuple[int, int, int, int],
    ) -> None:
        """Add one block to the planes of the CFA sites; its kernels are loaded.

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
