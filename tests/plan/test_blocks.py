"""Layout of blocks: the cheapest grid, and what is refused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from optics.made import bank, scene, sensor, shapes

from gpusim.errors import UserError
from gpusim.optics.grid import SimGrid
from gpusim.plan import Accuracy, blocks, plan_optics
from gpusim.plan.blocks import Memory, Needed, cheapest_grid, planes_at_nodes
from gpusim.plan.costs import LAVAPIPE, Costs

LENS = bank(coma_um=0.5, falloff=0.1)
COLOURED = scene(shapes())


@dataclass(frozen=True)
class Even:
    """Transforms of three channels, of which all blocks need as many planes."""

    planes: int
    costs: Costs

    def needed(self, grid: SimGrid) -> Needed:
        """Return the planes that each block needs."""
        return dict.fromkeys(np.ndindex(grid.blocks), self.planes)

    def seconds(self, grid: SimGrid, needed: Needed) -> dict[str, float]:
        """Return the seconds of the transforms."""
        return self.costs.transforms(grid, 3, np.array(list(needed.values())))

    def kernels_s(self, grid: SimGrid, needed: Needed) -> float:
        """Return the seconds of all nodes' kernels."""
        nodes = 3 * planes_at_nodes(grid, needed).sum()
        sampled = self.costs.seconds("kernels", nodes * (2 * grid.half_size) ** 2)
        return sampled + self.costs.seconds("spectra", nodes * grid.length**2)

    def memory(self, grid: SimGrid, needed: Needed) -> Memory:
        """Return what the kernels of four nodes take."""
        node = 3 * max(needed.values()) * grid.length**2 * 4
        return Memory(4 * node, node)


def layouts(
    planes: int,
    cells: tuple[int, int],
    rows: int = 1520,
    cols: int = 2028,
    costs: Costs = LAVAPIPE,
) -> SimGrid:
    camera = sensor().model_copy(update={"rows": rows, "cols": cols})
    return cheapest_grid(camera, Even(planes, costs), 31.0, cells, stride=4, period=2).grid


# By the table two ways to cut are nearly a tie, and the one node more than cells decides.
CHEAP_KERNELS = replace(LAVAPIPE, ns=LAVAPIPE.ns | {"kernels": 3.0, "spectra": 0.75})


def test_blocks_are_full_where_more_nodes_cost_less_than_more_transforms():
    """A photograph in three planes, of which all blocks need all: 176 samples of 256 - 2 x 40."""
    grid = layouts(3, (16, 12), costs=CHEAP_KERNELS)
    # Two blocks of 132 samples for each cell took 1.8 times as many transforms.
    assert (grid.block, grid.cells, grid.blocks) == ((176, 176), (24, 18), (24, 18))
    # Where cells of the tolerance hold whole blocks, no node is added; nor where nodes are dear.
    assert layouts(3, (12, 9), costs=CHEAP_KERNELS).cells == (12, 9)
    dear = replace(LAVAPIPE, ns=LAVAPIPE.ns | {"kernels": 3e3, "spectra": 750.0})
    assert layouts(3, (16, 12), costs=dear).cells == (16, 12)


def test_what_memory_holds_all_kernels_does_not_bound_the_frame():
    """12 and 48 megapixels are cut as 3 are: the kernels of all their nodes take gigabytes."""
    small = layouts(3, (16, 12), costs=CHEAP_KERNELS)
    for factor in (2, 4):
        cells, size = (16 * factor, 12 * factor), (1520 * factor, 2028 * factor)
        grid = layouts(3, cells, *size, costs=CHEAP_KERNELS)
        assert grid.length == small.length
        assert grid.block[0] == pytest.approx(small.block[0], rel=0.05)
        assert grid.blocks[0] == pytest.approx(factor * small.blocks[0], rel=0.05)


def test_nodes_closer_than_a_few_samples_are_refused():
    assert layouts(1, (42, 34), 96, 128).block == (8, 8)
    with pytest.raises(UserError, match="changes too fast") as caught:
        layouts(1, (43, 34), 96, 128)
    assert "44 x 35 PSF nodes" in caught.value.value
    assert "at least 8 samples apart" in caught.value.allowed


def test_a_psf_wider_than_the_longest_transform_is_refused(monkeypatch):
    monkeypatch.setattr(blocks, "TRANSFORMS", (36,))
    with pytest.raises(UserError, match="too wide") as caught:
        plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), method="fft")
    assert "sim samples wide" in caught.value.value and "4 samples" in caught.value.allowed
