"""Kernels at PSF nodes: of mirrored nodes by mirroring, and few kept on the host."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import at_lines, bank

from gpusim.gpu import Device
from gpusim.optics import nodes as optics_nodes
from gpusim.optics.grid import SimGrid
from gpusim.optics.images import field_images
from gpusim.optics.kernels import FieldKernels, field_kernels
from gpusim.optics.nodes import NodeStore, Scale
from gpusim.plan.blocks import planes_at_nodes, planes_at_points

GRID = SimGrid(96, 128, 4, 2, 256, 64, (3, 2))
WEIGHTS = np.random.default_rng(31).uniform(1, 5, (2, 3, 3))
NODES = [(x, y) for y in range(3) for x in range(4)]


class Store(NodeStore):
    """Kernels as they are."""

    half_size = 24

    def made_of(self, kernels: np.ndarray) -> np.ndarray:
        """Return them."""
        return kernels


def kernels(skew_um: float = 0.0) -> FieldKernels:
    lens = bank(skew_um=skew_um)
    images, places = field_images(lens, at_lines(lens, WEIGHTS), 1e9)
    return field_kernels(images, places, 0.5, 0.775, np.ones(images.shape[-2:]))


def made(device: Device, of: FieldKernels, grid: SimGrid = GRID, planes: int = 2) -> tuple:
    """Return the kernels of all nodes, and at how many they were sampled."""
    needed = dict.fromkeys(np.ndindex(grid.blocks), planes)
    store = Store(device, Scale("test", grid, 0.775, 0.0, of), needed)
    found = dict(store.make(NODES))
    return found, len(store._points)


def test_nodes_of_a_symmetric_lens_are_mirrored(device: Device):
    assert GRID.mirrored(0) and GRID.mirrored(1)
    found, sampled = made(device, kernels())
    expected, singly = made(device, replace(kernels(), mirrored=False))
    # There are 4 x 3 nodes and those around them, in a cross. Mirrored, 2 x 2 of them remain, and 2
    # + 2 beyond them.
    assert (sampled, singly) == (8, 26)
    for node in NODES:
        # Splines of rotated samples: float32 and rounding of the azimuth.
        assert_close(found[node], expected[node], atol=4e-6 * np.abs(expected[node]).max())
        assert np.abs(expected[node] - expected[node][..., ::-1]).max() > 0.01


def test_nodes_of_a_skew_lens_are_not_mirrored(device: Device):
    assert made(device, kernels(skew_um=2.0))[1] == 26


def test_nodes_of_an_uneven_grid_are_not_mirrored(device: Device):
    grid = replace(GRID, cols=127)
    assert not grid.mirrored(0) and grid.mirrored(1)
    assert made(device, kernels(), grid)[1] == 16  # 2 rows of 6 and the 4 above them


@pytest.mark.parametrize(
    ("skew_um", "cols", "points"), [(0.0, 128, 8), (2.0, 128, 26), (0.0, 127, 16)]
)
def test_the_planner_counts_the_points_that_are_sampled(
    device: Device, skew_um: float, cols: int, points: int
):
    grid, of = replace(GRID, cols=cols), kernels(skew_um)
    at_nodes = planes_at_nodes(grid, dict.fromkeys(np.ndindex(grid.blocks), 2))
    symmetric = tuple(of.mirrored and grid.mirrored(axis) for axis in (0, 1))
    assert made(device, of, grid)[1] == points
    assert planes_at_points(at_nodes, symmetric) == 2 * points


@pytest.mark.parametrize("cells", [(3, 2), (4, 5), (1, 1)])
@pytest.mark.parametrize("folds", [(True, False), (False, True), (True, True)])
def test_the_planner_counts_the_nodes_that_are_left_of_mirror_images(device, cells, folds):
    grid = replace(GRID, cells=cells)
    rng = np.random.default_rng(5)
    needed = {block: int(rng.integers(0, 4)) for block in np.ndindex(grid.blocks)}
    store = Store(device, Scale("test", grid, 0.775, 0.0, kernels()), needed, folds)
    at_nodes = planes_at_nodes(grid, needed, folds)
    lit = [block for block, planes in needed.items() if planes]
    assert {node for node in np.ndindex(grid.nodes) if at_nodes[node]} == store.nodes_of(lit)
    for node in np.ndindex(grid.nodes):
        assert grid.planes_at(node, store.needed) == at_nodes[node]


def test_the_planner_counts_the_planes_of_the_neediest():
    """One node of 4 x 3 with a second plane: itself and four beside it; mirrored, all fold."""
    at_nodes = np.ones((4, 3), int)
    at_nodes[3, 2] = 2
    assert planes_at_points(at_nodes, (False, False)) == 26 + 5
    # Folded to x -1, 0, 1 and y -1, 0, 1: 0, 0 with four beside it.
    assert planes_at_points(at_nodes, (True, True)) == 8 + 5
    assert planes_at_points(np.zeros((4, 3), int), (True, False)) == 0


def test_what_is_kept_on_the_host_changes_nothing(device: Device, monkeypatch: pytest.MonkeyPatch):
    every, held = made(device, kernels(2.0))
    monkeypatch.setattr(optics_nodes, "POINTS_BYTES", 0)
    few, left = made(device, kernels(2.0))
    assert left < held
    for node in NODES:
        assert np.array_equal(every[node], few[node])


def test_a_mirrored_node_has_the_planes_of_the_neediest(device: Device):
    needed = dict.fromkeys(np.ndindex(GRID.blocks), 1)
    needed[GRID.blocks[0] - 1, GRID.blocks[1] - 1] = 2
    store = Store(device, Scale("test", GRID, 0.775, 0.0, kernels()), needed)
    found = dict(store.make(NODES))
    assert {node: len(found[node]) for node in ((0, 0), (3, 2))} == {(0, 0): 1, (3, 2): 2}
