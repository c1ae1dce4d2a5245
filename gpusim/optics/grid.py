"""Geometry of the simulation: the sim grid, its blocks and PSF nodes. Integers only, no device.

Lengths are in sim samples (pixel pitch / N, N = D / P) from the sensor's upper left corner unless a
name says otherwise. The source region is the sensor plus the reach of the kernels on every side; it
is cut into cells between PSF nodes, and each cell into equal blocks. A block's window is the block
plus the reach of the kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class SimGrid:
    """Sim grid of a frame, at one scale.

    Attributes
    ----------
    rows, cols : int
        Pixels of the frame.
    stride : int
        Sim samples D from a photosite to the next of the same CFA site: 1, 2, 4, 8 or 16.
    period : int
        Rows and columns P of the CFA pattern: 1, 2 or 4.
    length : int
        Transform length T, a power of two from 256 to 1024.
    half_size : int
        Reach R of the kernels: they span 2 R samples; a multiple of `stride`.
    cells : (int, int)
        Cells between PSF nodes in x and in y.
    layers : int
        Planes of each site: 1, or where P = 1 one for each colour channel.
    """

    rows: int
    cols: int
    stride: int
    period: int
    length: int
    half_size: int
    cells: tuple[int, int]
    layers: int = 1

    @property
    def oversampling(self) -> float:
        """Sim samples per pixel N."""
        return self.stride / self.period

    @property
    def centre(self) -> tuple[float, float]:
        """x, y of the optical axis."""
        return (self.oversampling * self.cols / 2, self.oversampling * self.rows / 2)

    @property
    def sites(self) -> int:
        """Planes of photosites: the sites of the CFA period, or the layers of the only one."""
        return self.layers * self.period**2

    @property
    def sites_across(self) -> int:
        """Sites side by side; layers count as such, at the same place."""
        return self.layers * self.period

    @property
    def window(self) -> int:
        """Photosites M of one site across a block's window."""
        return self.length // self.stride

    @property
    def seen(self) -> tuple[int, int]:
        """Photosites of one site across and down which a block's light reaches: of its window."""
        return tuple((side + 2 * self.half_size) // self.stride for side in self.block)

    @property
    def alignment(self) -> int:
        """Samples of which blocks hold whole numbers: photosites, and vec4f of the direct sum."""
        return max(self.stride, 4)

    @cached_property
    def extent(self) -> tuple[int, int]:
        """Width and height of the source region."""
        return tuple(
            math.ceil(self.oversampling * pixels) + 2 * self.half_size
            for pixels in (self.cols, self.rows)
        )

    @property
    def largest_block(self) -> int:
        """Largest side of a block."""
        return (self.length - 2 * self.half_size) // self.alignment * self.alignment

    @cached_property
    def blocks_per_cell(self) -> tuple[int, int]:
        """Blocks across and down one cell."""
        return tuple(
            math.ceil(extent / cells / self.largest_block)
            for extent, cells in zip(self.extent, self.cells, strict=True)
        )

    @cached_property
    def block(self) -> tuple[int, int]:
        """Width and height of a block: a multiple of `alignment`.

        Where they fit, blocks are larger by one `alignment` if nodes then lie symmetrically.
        """
        sides = []
        for extent, count in zip(self.extent, self.blocks, strict=True):
            side = math.ceil(extent / count / self.alignment) * self.alignment
            uneven = (count * side - extent) % (2 * self.alignment) == self.alignment
            if uneven and count % 2 == 1 and side < self.largest_block:
                side += self.alignment
            sides.append(side)
        return tuple(sides)

    @cached_property
    def blocks(self) -> tuple[int, int]:
        """Blocks across and down the source region."""
        return tuple(c * b for c, b in zip(self.cells, self.blocks_per_cell, strict=True))

    @cached_property
    def start(self) -> tuple[int, int]:
        """x, y of the first sample of the first block.

        What the blocks hold beyond the source region is shared out to both sides: PSF nodes then
        lie symmetrically about the axis wherever whole steps of `alignment` allow.
        """
        return tuple(
            -self.half_size - (count * side - extent) // (2 * self.alignment) * self.alignment
            for count, side, extent in zip(self.blocks, self.block, self.extent, strict=True)
        )

    def block_origin(self, index: tuple[int, int]) -> tuple[int, int]:
        """Return x, y of the first sample of a block."""
        return tuple(
            first + i * side for first, i, side in zip(self.start, index, self.block, strict=True)
        )

    def window_origin(self, index: tuple[int, int]) -> tuple[int, int]:
        """Return x, y of the first photosite of a block's window, in photosites of one site."""
        return tuple((o - self.half_size) // self.stride for o in self.block_origin(index))

    def node_position(self, index: tuple[int, int]) -> tuple[int, int]:
        """Return x, y of a PSF node."""
        return self.block_origin(
            tuple(i * count for i, count in zip(index, self.blocks_per_cell, strict=True))
        )

    def mirrored(self, axis: int) -> bool:
        """Return whether PSF nodes lie symmetrically about the optical axis, in x (0) or y (1)."""
        return 2 * self.start[axis] + self.blocks[axis] * self.block[axis] == 2 * self.centre[axis]

    @property
    def nodes(self) -> tuple[int, int]:
        """PSF nodes across and down."""
        return (self.cells[0] + 1, self.cells[1] + 1)

    def cell_of(self, index: tuple[int, int]) -> tuple[int, int]:
        """Return the cell in which a block lies; its upper left node has the same index."""
        return tuple(i // blocks for i, blocks in zip(index, self.blocks_per_cell, strict=True))

    def folded(
        self, index: tuple[int, int], folds: tuple[bool, bool]
    ) -> tuple[tuple[int, int], tuple[bool, bool]]:
        """Return the block whose mirror image a block is, and whether in x and in y.

        A block in a cell beyond the middle one, where `folds` allows; any other is itself.
        """
        mirrored = tuple(
            fold and 2 * cell >= cells
            for fold, cell, cells in zip(folds, self.cell_of(index), self.cells, strict=True)
        )
        ways = zip(index, self.blocks, mirrored, strict=True)
        return tuple(count - 1 - i if other else i for i, count, other in ways), mirrored

    def planes_at(self, node: tuple[int, int], needed: dict[tuple[int, int], int]) -> int:
        """Return the most planes that a block around a node needs; `needed` by block."""
        across, down = self.blocks_per_cell
        columns = range((node[0] - 1) * across, (node[0] + 1) * across)
        rows = range((node[1] - 1) * down, (node[1] + 1) * down)
        return max(needed.get((x, y), 0) for x in columns for y in rows)

    def node_weights(
        self, index: tuple[int, int]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return where a block's first sample lies between two nodes (0..1), and the step; x, y."""
        result = []
        for axis in (0, 1):
            cell = self.blocks_per_cell[axis] * self.block[axis]
            first = (index[axis] % self.blocks_per_cell[axis]) * self.block[axis]
            result.append(((first + 0.5) / cell, 1 / cell))
        return tuple(result)

    def blocks_for(self, row0: int, col0: int, rows: int, cols: int) -> list[tuple[int, int]]:
        """Return the blocks whose windows touch a rectangle of pixels, row by row of cells.

        Those of a cell follow one another: they use the same kernels, which then still lie in the
        processor's cache.
        """
        chosen = []
        for axis, first, count in ((0, col0, cols), (1, row0, rows)):
            start = self.start[axis] - self.half_size
            origins = [start + i * self.block[axis] for i in range(self.blocks[axis])]
            low, high = first * self.oversampling, (first + count) * self.oversampling
            size = self.seen[axis] * self.stride
            chosen.append([i for i, o in enumerate(origins) if o < high and o + size > low])
        blocks = [(x, y) for y in chosen[1] for x in chosen[0]]
        return sorted(blocks, key=lambda block: (*self.cell_of(block)[::-1], *block[::-1]))
