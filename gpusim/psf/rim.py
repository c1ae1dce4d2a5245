"""The rim of a pupil on its nodes: shares of their squares, and what lies right beyond."""

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
