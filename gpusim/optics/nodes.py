"""Kernels at the PSF nodes of a grid, and what they are made for: what all methods share."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, product

import numpy as np

from gpusim.gpu import Array, Device, Resident, Use
from gpusim.gpu.pool import size_class
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernels import FieldKernels
from gpusim.optics.sampling import node_kernels, sampled_kernels
from gpusim.sensor.aperture import Response

Node = tuple[int, int]  # x, y of a PSF node
CROSS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))  # nodes from which `node_kernels` makes one
# Kernels at nodes that are kept on the host: what was made above the axis serves below it. Those of
# the demonstration take 70 MiB.
POINTS_BYTES = 256 << 20


@dataclass(frozen=True)
class Scale:
    """A part of the kernels, and the sim grid on which it is convolved.

    Attributes
    ----------
    name : str
    grid : SimGrid
    pitch_um : float
        Pitch of the sim grid.
    sigma : float
        Gaussian low-pass of the sampled scene, sim samples.
    kernels : FieldKernels
    method : str
        One of gpusim.optics.methods.METHODS.
    support : int
        With the direct sum: sim samples from a photosite's centre to the last tap.
    map_cells : (int, int)
        With modes: cells of their maps in x and in y.
    rank_error : float
        With modes: the error of an edge response that decides how many modes are kept.
    """

    name: str
    grid: SimGrid
    pitch_um: float
    sigma: float
    kernels: FieldKernels
    method: str = "fft"
    support: int = 0
    map_cells: tuple[int, int] = (1, 1)
    rank_error: float = 0.0


@dataclass(frozen=True)
class Rates:
    """Where the light of blocks is added up: the planes of the CFA sites of a rectangle.

    Attributes
    ----------
    planes : Array (S, rows, cols), f32
        Electrons/s, by cell of the CFA.
    rect : (row0, col0, rows, cols)
        Rectangle of pixels, aligned to the CFA period.
    """

    planes: Array
    rect: tuple[int, int, int, int]

    def cells(self, period: int) -> tuple[int, int, int, int]:
        """Return the rectangle in cells of the CFA: first row and column, rows and columns."""
        row0, col0, rows, cols = (-(-value // period) for value in self.rect)
        return row0, col0, rows, cols


@dataclass(frozen=True)
class Outputs:
    """What kernels are made for, and how the photosites of the CFA period find theirs.

    Attributes
    ----------
    places : list of (channel, shift_x, shift_y)
        For each kernel: its colour channel, and where the pixel's centre lies, sim samples.
    step : int
        Samples from a site to the next; 0 where each site has a kernel of its own.
    of_site : list of int
        Index of each site's kernel.
    """

    places: list[tuple[int, float, float]]
    step: int
    of_site: list[int]


def own_kernels(stride: int, period: int, layers: int, channels: int) -> bool:
    """Return whether each site has a kernel of its own.

    Where a site lies whole samples from the next, shaders/optics/fft_columns shifts those of up to
    four channels.
    """
    return layers > 1 or stride % period != 0 or channels > 4


def outputs_of(grid: SimGrid, site_channels: list[int], channels: int) -> Outputs:
    """Choose what the kernels are made for: channels, or sites that have kernels of their own."""
    # A pixel's centre, in samples from the centre of its first sample.
    first = (grid.oversampling - 1) / 2
    if not own_kernels(grid.stride, grid.period, grid.layers, channels):
        places = [(channel, first, first) for channel in range(channels)]
        return Outputs(places, grid.stride // grid.period, list(site_channels))
    places = [
        (
            channel,
            *(first + grid.oversampling * k for k in (site % grid.period, site // grid.period)),
        )
        if grid.layers == 1
        else (channel, first, first)
        for site, channel in enumerate(site_channels)
    ]
    return Outputs(places, 0, list(range(len(site_channels))))


def folds_of(
    grid: SimGrid, mirrored: bool, aperture: float | Response, step: int
) -> tuple[bool, bool]:
    """Return whether blocks beyond the middle are mirror images of others, in x and in y.

    Parameters
    ----------
    grid : SimGrid
    mirrored : bool
        See `FieldKernels`.
    aperture : float or Response
    step : int
        See `Outputs`: kernels that lie beside the pixel's centre have no mirror image.
    """
    even = mirrored and (not isinstance(aperture, Response) or aperture.even)
    if not even or (grid.period > 1 and step == 0):
        return False, False
    # Blocks are whole photosites: where they lie symmetrically, so does the filter pattern.
    return grid.mirrored(0), grid.mirrored(1)


class KernelStore:
    """Kernels that come onto the device with `load`, and stay there until `shed` or `release`.

    A node is what is loaded at once: the kernels of a PSF node, or what all blocks share.

    Attributes
    ----------
    nodes : dict of Resident
        Kernels on the device by node, the last used last.
    made : int
        Kernels of how many nodes were made so far.
    use : Use
        As what the shaders read kernels.
    """

    use = Use.DATA

    def __init__(self, device: Device) -> None:
        self.device = device
        self.nodes: dict[Node, Resident] = {}
        self.made = 0

    def nodes_of(self, blocks: Iterable[tuple[int, int]]) -> set[Node]:
        """Return the nodes that blocks use."""
        raise NotImplementedError

    def node_bytes(self, node: Node) -> int:
        """Return the device memory that the kernels of a node take."""
        raise NotImplementedError

    def block_bytes(self, planes: int) -> int:
        """Return the device memory that the kernels of one block of so many planes take."""
        raise NotImplementedError

    def make(self, nodes: list[Node]) -> Iterator[tuple[Node, np.ndarray]]:
        """Yield nodes, given row by row, with their kernels as the shaders read them."""
        raise NotImplementedError

    def load_bytes(self, blocks: Iterable[tuple[int, int]]) -> int:
        """Return the device memory that the kernels of blocks take together."""
        return sum(map(self.node_bytes, self.nodes_of(blocks)))

    def missing_bytes(self, blocks: Iterable[tuple[int, int]]) -> int:
        """Return the device memory that `load` takes in addition."""
        return sum(map(self.node_bytes, self.nodes_of(blocks) - self.nodes.keys()))

    @property
    def held_bytes(self) -> int:
        """Device memory that kernels take now."""
        return sum(size_class(kernels.nbytes, self.use) for kernels in self.nodes.values())

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
            Called after each node.
        """
        wanted = sorted(self.nodes_of(blocks), key=lambda node: node[::-1])
        for node, kernels in self.make([node for node in wanted if node not in self.nodes]):
            label = f"node {node[0]},{node[1]}"
            self.nodes[node] = self.device.resident(label, kernels.view(np.float32), self.use)
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

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in self.nodes.values():
            resident.destroy()
        self.nodes.clear()


class NodeStore(KernelStore):
    """Kernels at the PSF nodes of a grid, made where blocks around them need planes.

    Parameters
    ----------
    device : Device
    scale : Scale
    needed : dict
        Coefficient planes that each block needs; where none of the blocks around a node needs a
        plane, its kernels have no such plane.
    folds : (bool, bool)
        Whether blocks beyond the middle are convolved as mirror images, with the nodes of the
        others: in x, in y.
    """

    half_size: int  # kernels are sampled as far, sim samples
    plane_bytes: int  # of one plane of a node's kernels on the device

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        folds: tuple[bool, bool] = (False, False),
    ) -> None:
        super().__init__(device)
        self.scale, self.grid, self.folds = scale, scale.grid, folds
        self.needed: dict[tuple[int, int], int] = defaultdict(int)
        for block, planes in needed.items():
            folded, _ = self.grid.folded(block, folds)
            self.needed[folded] = max(self.needed[folded], planes)
        self._points: dict[Node, np.ndarray] = {}  # kernels at nodes, to make others of them

    def made_of(self, kernels: np.ndarray) -> np.ndarray:
        """Return what kernels (planes, C, 2 half_size, 2 half_size) become on the device."""
        raise NotImplementedError

    def nodes_of(self, blocks: Iterable[tuple[int, int]]) -> set[Node]:
        """Return the PSF nodes around blocks."""
        grid = self.grid
        cells = {grid.cell_of(grid.folded(block, self.folds)[0]) for block in blocks}
        return {(x + dx, y + dy) for x, y in cells for dx in (0, 1) for dy in (0, 1)}

    def node_bytes(self, node: Node) -> int:
        """Return the device memory that the kernels of a node take."""
        return size_class(self.grid.planes_at(node, self.needed) * self.plane_bytes, self.use)

    def block_bytes(self, planes: int) -> int:
        """Return the device memory that the kernels of one block of so many planes take."""
        return 4 * size_class(planes * self.plane_bytes, self.use)

    def make(self, nodes: list[Node]) -> Iterator[tuple[Node, np.ndarray]]:
        """Yield nodes, given row by row, with their kernels as the shaders read them."""
        grid, scale = self.grid, self.scale
        points = self._points

        def sample(index: Node) -> np.ndarray:
            x_um, y_um = (np.array(grid.node_position(index)) - grid.centre) * scale.pitch_um
            size, planes = self.half_size, self._planes[index]
            kernels = sampled_kernels(
                scale.kernels, x_um, y_um, scale.pitch_um, size, planes=planes
            )
            return kernels.astype(np.float32)

        def made(node: Node, planes: int) -> np.ndarray:
            def point(dx: int, dy: int) -> np.ndarray:
                index = (node[0] + dx, node[1] + dy)
                folded = self._folded(index)
                kernels = points[folded][:planes]
                for axis, one, other in zip((-1, -2), index, folded, strict=True):
                    if one != other:
                        kernels = _flipped(kernels, axis)
                return kernels

            return self.made_of(node_kernels(point))

        # SciPy and NumPy let go of the interpreter in their loops.
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for y, of_row in groupby(nodes, key=lambda node: node[1]):
                row = {node: grid.planes_at(node, self.needed) for node in of_row}
                wanted = {self._folded((x + dx, y + dy)) for x, _ in row for dx, dy in CROSS}
                self._forget(self._folded((0, y))[1])
                lacking = wanted - points.keys()
                points.update(zip(lacking, pool.map(sample, lacking), strict=True))
                # A few at a time: the spectra of a whole row may be gigabytes.
                step = 2 * (os.cpu_count() or 1)
                for first in range(0, len(row), step):
                    part = dict(list(row.items())[first : first + step])
                    yield from zip(part, pool.map(made, part, part.values()), strict=True)

    def _folded(self, index: Node) -> Node:
        """Return the node whose kernels are those of a node, or their mirror image.

        In each direction that of lower index, of two that lie symmetrically about the axis.
        """
        return tuple(
            min(i, cells - i) if mirrored else i
            for i, cells, mirrored in zip(index, self.grid.cells, self._mirrored, strict=True)
        )

    @cached_property
    def _mirrored(self) -> tuple[bool, bool]:
        return tuple(self.scale.kernels.mirrored and self.grid.mirrored(axis) for axis in (0, 1))

    @cached_property
    def _planes(self) -> dict[Node, int]:
        """Return how many planes kernels have at a node: what is wanted around it, or mirrored."""
        across, down = self.grid.nodes
        planes: dict[Node, int] = defaultdict(int)
        for x, y in product(range(across), range(down)):
            count = self.grid.planes_at((x, y), self.needed)
            for dx, dy in CROSS:
                index = self._folded((x + dx, y + dy))
                planes[index] = max(planes[index], count)
        return planes

    def _forget(self, y: int) -> None:
        """Drop kernels at nodes, first those farthest from a row, until few enough are kept."""
        held = sum(kernels.nbytes for kernels in self._points.values())
        for index in sorted(self._points, key=lambda index: -abs(index[1] - y)):
            if held <= POINTS_BYTES or abs(index[1] - y) <= 1:  # those a row needs are around it
                break
            held -= self._points.pop(index).nbytes

    def release(self) -> None:
        """Give the device's memory back."""
        super().release()
        self._points.clear()


def _flipped(kernels: np.ndarray, axis: int) -> np.ndarray:
    """Return kernels mirrored about the source sample, R of 2 R; the first has no partner."""
    return np.roll(np.flip(kernels, axis), 1, axis)
