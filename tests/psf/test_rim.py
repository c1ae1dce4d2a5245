"""The rim of a pupil: what lies right beyond it follows from what lies within."""

import numpy as np

from gpusim.psf.rim import CONTINUED, beside, continued


def test_cubics_are_continued_exactly():
    # Along a row or column that is not the sum of products, each way by itself.
    a, b = np.meshgrid(np.arange(12.0), np.arange(20.0), indexing="ij")
    w = 3 - 0.2 * b + 0.03 * b**2 - 0.004 * b**3
    whole = np.stack([w, 5 + 0 * a], axis=-1)[None].astype(np.float32)
    known = (b >= 7) & (b < 12)
    nodes = np.where(known[None, ..., None], whole, 0)
    found = continued(nodes)
    filled = (b >= 7 - CONTINUED) & (b < 12 + CONTINUED)
    # Rounded nodes: what is off grows with the fourth difference, as the cube of the steps, times
    # 15 roundings of 2^-24 of 35.
    grown = 15 * CONTINUED**3 * 35 * 2.0**-24
    np.testing.assert_allclose(found[0][filled], whole[0][filled], rtol=0, atol=grown)
    np.testing.assert_array_equal(found[0][~filled], 0)
    np.testing.assert_array_equal(found[0][known], nodes[0][known])


def test_along_alpha_the_mirrored_half_takes_part():
    # Even in alpha, known at the first two rows alone: only with their mirror images are there
    # four in a row.
    a = np.meshgrid(np.arange(8) + 0.5, np.arange(6), indexing="ij")[0]
    whole = np.stack([1 + 0.1 * a**2, 2 + 0.02 * a**2], axis=-1)[None].astype(np.float32)
    nodes = np.where((a < 2)[None, ..., None], whole, 0)
    found = continued(nodes)
    reached = a < 2 + CONTINUED
    np.testing.assert_allclose(
        found[0][reached], whole[0][reached], rtol=15 * CONTINUED**3 * 2.0**-24
    )
    np.testing.assert_array_equal(found[0][~reached], 0)


def test_nothing_comes_round_from_the_other_edge():
    nodes = np.zeros((1, 9, 12, 2), np.float32)
    nodes[0, :, 8:] = 1.0  # to the last column
    found = continued(nodes)
    np.testing.assert_array_equal(found[0, :, 8 - CONTINUED :], 1)
    np.testing.assert_array_equal(found[0, :, : 8 - CONTINUED], 0)


def test_beside_is_two_nodes_around():
    reach = np.zeros((1, 9, 9))
    reach[0, 4, 5] = 0.5
    reach[0, 0, 0] = 1.5  # outside the pupil
    near = np.zeros((9, 9), bool)
    near[2:7, 3:8] = True
    np.testing.assert_array_equal(beside(reach)[0], near)
    edge = np.zeros((1, 5, 5))
    edge[0, 0, 4] = 0.5
    assert beside(edge)[0].sum() == 9
