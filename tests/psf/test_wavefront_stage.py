"""The wavefront at the nodes, on the device: against its twin and against a quadratic wavefront.

Tolerance of W: the node is a sum of a product (two roundings of numbers below 1), the difference
from the ray one more, so each miss is off by 3 * 2^-24; times landing * waves_per_mm. W itself,
the two products, their sum and the last sum: 6 roundings of what is added.
"""

import numpy as np
import pytest
from harness import assert_close, run_stage, unwritten
from optics.made import ULP

from gpusim.reference.wavefront import wavefront

GRIDS = np.array(
    [  # first, step, origin, chief ray, cell, waves per mm
        [0.5 / 512, -0.25 + 0.5 / 256, 1 / 512, 1 / 256, 0.0, 0.0, 0.0, 0.0, 1e-3, 1 / 550e-6],
        [1 / 512, 0.125, 1 / 256, 1 / 512, 0.0, 0.2, 0.0, 0.1, 1e-3, 1 / 400e-6],
    ],
    np.float32,
)


def rays(na: int, nb: int, off: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what trace gives for rays up to ``off`` steps beside their nodes, of both grids."""
    rng = np.random.default_rng(nb)
    opd = rng.uniform(-1, 1, (2, na, nb, 4)) * [30.0, 1.0, 0.05, 0.05]
    directions = np.full((2, na, nb, 4), np.nan)
    for pair, grid in enumerate(GRIDS.astype(float)):
        a, b = np.meshgrid(np.arange(na), np.arange(nb), indexing="ij")
        node = grid[:2] + np.stack([a, b], axis=-1) * grid[2:4]
        directions[pair, ..., :2] = node + rng.uniform(-off, off, node.shape) * grid[2:4]
    return opd.astype(np.float32), directions.astype(np.float32)


def on_device(opd: np.ndarray, directions: np.ndarray, pairs: int = 2) -> np.ndarray:
    _, na, nb, _ = opd.shape
    return run_stage(
        "psf/wavefront",
        (-(-nb // 64), na, pairs),
        {"na": na, "nb": nb},
        {"grids": GRIDS, "opd": opd, "directions": directions},
        {"nodes": ((2, na, nb, 2), np.float32)},
    )["nodes"]


def reference(opd: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return np.array(
        [
            wavefront(grid[:2], grid[2:4], grid[9], opd[pair], directions[pair])
            for pair, grid in enumerate(GRIDS.astype(float))
        ]
    )


def tolerance(opd: np.ndarray, directions: np.ndarray) -> np.ndarray:
    waves = GRIDS[:, 9].astype(float)[:, None, None]
    landing = np.abs(opd[..., 2:].astype(float)).sum(axis=-1) * waves
    steps = GRIDS[:, None, None, 2:4].max(axis=-1)
    return 3 * ULP * landing + 6 * ULP * (np.abs(opd[..., 0].astype(float)) + landing * steps)


@pytest.mark.parametrize(("na", "nb"), [(3, 130), (5, 64), (1, 65), (2, 1)])
def test_nodes_are_those_of_the_reference(na: int, nb: int):
    opd, directions = rays(na, nb, 0.49)
    found, expected = on_device(opd, directions), reference(opd, directions)
    assert_close(found[..., 1], opd[..., 1].astype(float), atol=0)
    bound = tolerance(opd, directions)
    assert_close(found[..., 0], expected[..., 0], atol=bound)
    # W as the ray has it, and with the slope turned over, are out of tolerance.
    for planted in (opd[..., 0].astype(float), 2 * opd[..., 0] - expected[..., 0]):
        with pytest.raises(AssertionError, match="elements are bad"):
            assert_close(planted, expected[..., 0], atol=bound)


def test_a_ray_half_a_step_off_says_nothing_of_its_node():
    opd, directions = rays(4, 100, 0.75)
    found, expected = on_device(opd, directions), reference(opd, directions)
    known = expected[..., 1] != 0
    assert 0.3 < known.mean() < 0.6  # (2/3)^2
    assert_close(found[..., 1], expected[..., 1], atol=0)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sign", [1, -1])
def test_half_a_step_is_the_limit_on_either_side_and_axis(axis: int, sign: int):
    # Dyadic steps: exactly half a step is lost, one unit less is kept.
    opd, directions = rays(4, 7, 0.0)
    directions[..., axis] += sign * GRIDS[:, None, None, 2 + axis] / 2
    assert_close(on_device(opd, directions)[..., 1], np.zeros((2, 4, 7)), atol=0)
    nearer = directions.copy()
    nearer[..., axis] -= sign * 2.0**-20
    assert_close(on_device(opd, nearer)[..., 1], opd[..., 1].astype(float), atol=0)


def test_a_quadratic_wavefront_is_met_to_second_order():
    # W = k (alpha^2 + beta^2) / 2 waves; landing -k (alpha, beta) lambda. The node is half the
    # second derivative times the square of the miss away: k off^2 / 2.
    _, directions = rays(4, 90, 0.4)
    k = 100.0
    cosines = directions[..., :2].astype(float)
    landing = -k * cosines / GRIDS[:, None, None, 9:].astype(float)
    w = 0.5 * k * (cosines**2).sum(axis=-1, keepdims=True)
    opd = np.concatenate([w, np.ones_like(w), landing], axis=-1).astype(np.float32)
    found = on_device(opd, directions)[..., 0]
    a, b = np.meshgrid(np.arange(4), np.arange(90), indexing="ij")
    for pair, grid in enumerate(GRIDS.astype(float)):
        node = grid[:2] + np.stack([a, b], axis=-1) * grid[2:4]
        off2 = ((cosines[pair] - node) ** 2).sum(axis=-1)
        exact = 0.5 * k * (node**2).sum(axis=-1) - 0.5 * k * off2
        bound = tolerance(opd, directions)[pair] + ULP * np.abs(w[pair, ..., 0])
        assert_close(found[pair], exact, atol=bound)
        assert (0.5 * k * off2).max() > 3 * bound.max()


def test_a_beam_that_is_not_dispatched_is_left_alone():
    found = on_device(*rays(2, 70, 0.4), pairs=1)
    assert unwritten(found[1]).all()
    assert not unwritten(found[0]).any()
