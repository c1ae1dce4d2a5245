"""Geometry of blocks, windows and nodes, against what the words say, over grids of many sizes."""

import itertools
import math

import numpy as np
import pytest
from harness import assert_close

from gpusim.optics.grid import SimGrid

# rows, cols, stride, period, length, half_size, cells
GRIDS = [
    SimGrid(96, 128, 4, 2, 256, 32, (2, 1)),
    SimGrid(51, 77, 4, 2, 256, 100, (3, 2)),
    SimGrid(33, 1, 8, 2, 512, 64, (1, 1)),
    SimGrid(1, 45, 1, 1, 256, 17, (1, 2)),
    SimGrid(64, 70, 8, 4, 1024, 408, (5, 3)),
    SimGrid(31, 43, 1, 2, 256, 9, (1, 3)),  # half a sample a pixel
    SimGrid(1520, 2028, 4, 2, 512, 176, (4, 3)),
]
EVERY = pytest.mark.parametrize("grid", GRIDS, ids=lambda grid: f"{grid.cols}x{grid.rows}")


def spans(grid: SimGrid, axis: int) -> list[range]:
    """Return the samples of each block along an axis."""
    firsts = [grid.block_origin((i, i))[axis] for i in range(grid.blocks[axis])]
    return [range(first, first + grid.block[axis]) for first in firsts]


@EVERY
def test_each_sample_lies_in_one_block(grid: SimGrid):
    for axis, pixels in enumerate((grid.cols, grid.rows)):
        samples = list(itertools.chain(*spans(grid, axis)))
        assert samples == list(range(samples[0], samples[-1] + 1))
        # The source region: the sensor and the kernels' reach on both sides; what is beyond it is
        # shared out evenly, to one step of the alignment on both sides together.
        before = -grid.half_size - samples[0]
        after = samples[-1] + 1 - math.ceil(pixels * grid.oversampling) - grid.half_size
        assert before >= 0 and 0 <= after - before < 2 * grid.alignment
        assert grid.mirrored(axis) == (samples[0] + samples[-1] + 1 == pixels * grid.oversampling)


@EVERY
def test_windows_hold_what_a_block_spreads_and_begin_on_a_photosite(grid: SimGrid):
    for axis in (0, 1):
        # A kernel spans 2 R samples: beyond T the transform would wrap into the window.
        assert grid.block[axis] + 2 * grid.half_size <= grid.length
        for i, span in enumerate(spans(grid, axis)):
            assert grid.window_origin((i, i))[axis] * grid.stride == span.start - grid.half_size
    assert grid.window * grid.stride == grid.length
    assert grid.sites == grid.period**2


@EVERY
def test_the_axis_is_the_middle_of_the_sensor(grid: SimGrid):
    first, last = np.array([0.0, 0.0]), np.array([grid.cols, grid.rows]) * grid.stride / grid.period
    assert_close(np.array(grid.centre), (first + last) / 2, atol=0)


@EVERY
def test_weights_rise_evenly_from_node_to_node(grid: SimGrid):
    """Cell plus weight is a straight line over all blocks, through the nodes' positions."""
    for axis in (0, 1):
        at, seen = [], []
        for i, span in enumerate(spans(grid, axis)):
            first, step = grid.node_weights((i, i))[axis]
            at += list(span)
            seen += list(grid.cell_of((i, i))[axis] + first + step * np.arange(len(span)))
        nodes = [grid.node_position((i, i))[axis] for i in range(grid.nodes[axis])]
        assert len(nodes) == grid.cells[axis] + 1
        expected = np.interp(np.array(at) + 0.5, nodes, np.arange(len(nodes)))
        assert_close(np.array(seen), expected, atol=1e-12)  # rounding of float64
        assert nodes[0] == at[0] and nodes[-1] == at[-1] + 1


@EVERY
def test_blocks_of_a_rectangle_are_those_whose_light_reaches_it(grid: SimGrid):
    rng = np.random.default_rng(grid.rows)
    rects = [(0, 0, grid.rows, grid.cols), (0, 0, 1, 1), (grid.rows - 1, grid.cols - 1, 1, 1)]
    for _ in range(10):
        row, col = rng.integers(0, (grid.rows, grid.cols))
        rects.append((row, col, *rng.integers(1, (grid.rows - row + 1, grid.cols - col + 1))))
    for row0, col0, rows, cols in rects:
        touching = []
        for y, x in itertools.product(range(grid.blocks[1]), range(grid.blocks[0])):
            hit = True
            for axis, first, count in ((0, col0, cols), (1, row0, rows)):
                window = grid.window_origin((x, y))[axis] * grid.stride
                low, high = first * grid.oversampling, (first + count) * grid.oversampling
                reached = grid.block[axis] + 2 * grid.half_size
                hit &= window < high and window + reached > low
            if hit:
                touching.append((x, y))
        found = grid.blocks_for(row0, col0, rows, cols)
        assert sorted(found, key=lambda block: block[::-1]) == touching
        cells = [grid.cell_of(block) for block in found]
        assert cells == sorted(cells, key=lambda cell: cell[::-1]), "cell by cell"


@EVERY
@pytest.mark.parametrize("folds", [(True, False), (False, True), (True, True)])
def test_a_folded_block_is_the_mirror_image_of_one_in_a_cell_before_the_middle(grid, folds):
    met = [set(), set()]
    for block in np.ndindex(grid.blocks):
        folded, mirrored = grid.folded(block, folds)
        for axis in (0, 1):
            cell = grid.cell_of(block)[axis]
            assert mirrored[axis] == (folds[axis] and cell > (grid.cells[axis] - 1) / 2)
            turned = grid.blocks[axis] - 1 - block[axis]
            assert folded[axis] == (turned if mirrored[axis] else block[axis])
            met[axis].add(grid.cell_of(folded)[axis])
    for axis in (0, 1):
        near = (grid.cells[axis] + 1) // 2 if folds[axis] else grid.cells[axis]
        assert met[axis] == set(range(near))
    assert grid.folded((0, 0), (False, False)) == ((0, 0), (False, False))


@EVERY
def test_a_node_needs_what_the_blocks_around_it_need(grid: SimGrid):
    rng = np.random.default_rng(3)
    needed = {block: int(rng.integers(0, 9)) for block in np.ndindex(grid.blocks)}
    for node in np.ndindex(grid.nodes):
        around = [
            planes
            for block, planes in needed.items()
            if all(n - 1 <= c <= n for n, c in zip(node, grid.cell_of(block), strict=True))
        ]
        assert grid.planes_at(node, needed) == max(around)


def test_cells_give_several_blocks_where_a_transform_is_too_short():
    grid = GRIDS[1]
    # 256 - 200 = 56 samples a block; 154 + 200 samples in 3 cells: 3 blocks each of 40.
    assert grid.blocks_per_cell[0] == 3 and grid.block[0] == 40 and grid.blocks == (9, 6)
