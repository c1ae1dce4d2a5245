"""The cost model: what it counts, and that it follows the rates."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.optics.grid import SimGrid
from gpusim.plan.costs import LAVAPIPE, UNITS, Costs

GRID = SimGrid(248, 248, stride=4, period=2, length=512, half_size=88, cells=(2, 2))


def only(name: str, length: float = 1.0) -> Costs:
    """Return costs in which everything is free but one thing, which takes a second."""
    return Costs("", dict.fromkeys(UNITS, 0.0) | {name: 1e9}, {512: length})


def test_the_table_has_a_rate_for_everything():
    assert LAVAPIPE.ns.keys() == UNITS.keys() and min(LAVAPIPE.ns.values()) > 0


def test_work_is_counted_by_the_shaders_loops():
    planes = np.array([3, 0, 1])  # of three blocks, of which one is dark
    block = GRID.block[1]

    def found(name: str) -> dict[str, float]:
        return only(name).transforms(GRID, 3, planes)

    # FFT of rows: every row of every plane is one transform of 512.
    assert found("fft rows") == {
        "fft rows": 4 * block * 512 * 9,
        "fft columns": 0,
        "inverse fft": 0,
    }
    # FFT of columns: 256 lines, for the upper and the lower nodes each; 4 nodes, 3 channels.
    lines = 256 * 512
    assert found("fft columns")["fft columns"] == 4 * 2 * lines
    assert found("products")["fft columns"] == 4 * 4 * 3 * lines
    # Back to the photosites: two pairs of sites, in the two blocks that are lit.
    assert found("inverse columns")["fft columns"] == 2 * 2 * lines / 4
    assert found("inverse fft") == {
        "fft rows": 0,
        "fft columns": 0,
        "inverse fft": 2 * 2 * 128**2 * 7,
    }


def test_modes_share_transforms_in_pairs():
    planes = np.array([3, 0, 1])

    def found(name: str, rank: int) -> dict[str, float]:
        return only(name).transforms(GRID, 3, planes, rank)

    # 9 and 3 lines of three modes: 5 and 2 pairs, each transformed once.
    lines = 256 * 512
    assert found("modes", 3)["modes"] == 7 * GRID.block[1] * 512 * 9
    assert found("fft columns", 3)["fft columns"] == 7 * lines
    assert found("products", 3)["fft columns"] == 2 * 7 * 3 * lines
    assert found("fft rows", 3) == {"modes": 0, "fft columns": 0, "inverse fft": 0}
    # One mode of one plane has no other to pair with: one product each.
    alone = only("products").transforms(GRID, 3, np.array([1, 1]), 1)
    assert alone["fft columns"] == 2 * 3 * lines


def test_a_length_may_be_slower():
    once, twice = (only("fft rows", slow).transforms(GRID, 3, np.array([1])) for slow in (1.0, 2.0))
    assert twice["fft rows"] == 2 * once["fft rows"] > 0


def test_rates_are_nanoseconds():
    assert LAVAPIPE.seconds("adc", 1e9) == pytest.approx(LAVAPIPE.ns["adc"])
