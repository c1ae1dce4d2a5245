"""The nodes of a pupil: shares of their squares on the rim, what lies right beyond and between."""

from __future__ import annotations

import numpy as np

# The stencil of a cell on a rim across the grid reaches two nodes beyond it in both directions, and
# the nearest node that has a ray may be one more away.
CONTINUED = 5


def rim_share(reach: np.ndarray) -> np.ndarray:
    """Return the share of each node's square (L, A, B) that lies inside the rim, reach 1.

    Next to nodes without a ray, reach 0, no slope is known: there it is all or nothing.
    """
    known = np.where(reach > 0, reach, np.nan)
    along, across = np.gradient(known, axis=(1, 2))
    depth = (1 - known) / np.maximum(np.abs(along) + np.abs(across), 1e-12)
    whole = (reach > 0) & (reach < 1)
    return np.where(np.isnan(depth), whole, np.clip(0.5 + depth, 0, 1))


def beside(reach: np.ndarray) -> np.ndarray:
    """Return which nodes (L, A, B) lie within two of one inside the pupil, 0 < reach < 1."""
    inside = (reach > 0) & (reach < 1)
    near = inside.copy()
    for shift in (1, 2):
        near[:, shift:] |= inside[:, :-shift]
        near[:, :-shift] |= inside[:, shift:]
    across = near.copy()
    for shift in (1, 2):
        near[:, :, shift:] |= across[:, :, :-shift]
        near[:, :, :-shift] |= across[:, :, shift:]
    return near


def continued(nodes: np.ndarray) -> np.ndarray:
    """Continue W and reach beyond where rays arrive, by CONTINUED nodes.

    Rays may fail right beyond a rim, where interpolation needs them. Cubic extrapolation from four
    nodes in a row, along alpha and beta, the mean of those that there are.

    Parameters
    ----------
    nodes : ndarray of float32, shape (L, A, B, 2)
        Reach 0: no ray.
    """
    # The pupil's other half, as far as extrapolation reaches.
    whole = np.concatenate([nodes[:, 3::-1], nodes], axis=1).astype(float)
    for _ in range(CONTINUED):
        known = whole[..., 1] > 0
        total, count = np.zeros_like(whole), np.zeros(known.shape)
        for axis in (1, 2):
            for sign in (1, -1):
                ahead = [np.roll(whole, -sign * step, axis) for step in (1, 2, 3, 4)]
                there = np.all([one[..., 1] > 0 for one in ahead], axis=0)
                # What rolled in from the other edge does not lie ahead.
                edge = [slice(None)] * 3
                edge[axis] = slice(-4, None) if sign > 0 else slice(0, 4)
                there[tuple(edge)] = False
                value = 4 * ahead[0] - 6 * ahead[1] + 4 * ahead[2] - ahead[3]
                there &= value[..., 1] > 0
                total += np.where(there[..., None], value, 0)
                count += there
        new = ~known & (count > 0)
        whole[new] = total[new] / count[new][:, None]
    return whole[:, 4:].astype(np.float32)


def between_nodes(nodes: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Return the wavefront (R,) at places between nodes, by cubics; NaN where a node has no ray.

    Parameters
    ----------
    nodes : ndarray (A, B, 2)
        The wavefront and the reach at the nodes of half a pupil, whose mirror image lies before
        row 0.
    place : ndarray (R, 2)
        Row and column.
    """
    low = np.floor(place).astype(int)
    weights = cubic_weights(place - low)
    rows = low[:, :1] + np.arange(-1, 3)
    rows = np.where(rows < 0, -1 - rows, rows)
    columns = low[:, 1:] + np.arange(-1, 3)
    stencil = nodes.astype(float)[rows[:, :, None], columns[:, None, :]]
    found = np.einsum("ra,rb,rab->r", weights[:, 0], weights[:, 1], stencil[..., 0])
    return np.where((stencil[..., 1] == 0).any(axis=(1, 2)), np.nan, found)


def cubic_weights(t: np.ndarray) -> np.ndarray:
    """Return the weights of the nodes -1, 0, 1, 2 for cubic interpolation at t, a new last axis."""
    a, b, c = t + 1, t - 1, t - 2
    return np.stack([-t * b * c, 3 * a * b * c, -3 * a * t * c, a * t * b], axis=-1) / 6
