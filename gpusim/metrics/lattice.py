"""Marks of a regular chart, counted: which column and row of the chart each one is.

From a mark amid the picture the count goes on from neighbour to neighbour: where the next one
should lie follows from the last step in that direction, so that the lattice may bend as a lens with
much distortion bends it.
"""

from __future__ import annotations

import heapq

import numpy as np
from scipy.spatial import cKDTree

from gpusim.errors import UserError

NEAR = 0.3  # of a step: how far from where it should be a mark may lie
LEAST_MARKS = 20  # of a lattice: the fits of distortion have up to 14 parameters
LEAST_SIDE = 4  # columns and rows
SEEDS = 12  # marks from which the count is begun, the one that reaches most holds


def count_marks(
    x: np.ndarray, y: np.ndarray, least: int = LEAST_MARKS, side: int = LEAST_SIDE
) -> tuple[np.ndarray, np.ndarray]:
    """Return the marks that are part of the chart's lattice, and their columns and rows.

    Parameters
    ----------
    x, y : ndarray (N,)
        Pixels.
    least, side : int
        How many marks a lattice has at least, and how many columns and rows.

    Returns
    -------
    which : ndarray (M,) of int
        Marks of the lattice.
    cell : ndarray (M, 2) of int
        Column, to the right in the picture, and row, downwards; the mark in the middle is (0, 0).

    Raises
    ------
    UserError
        The marks are too few, or no lattice.
    """
    places = np.stack([x, y], 1)
    best: dict[int, tuple[int, int]] = {}
    if len(places) >= least:
        tree = cKDTree(places)
        middle = np.median(places, axis=0)
        order = np.argsort(np.hypot(*(places - middle).T))
        for seed in order[:SEEDS]:
            cells = _from(int(seed), places, tree)
            if len(cells) > len(best):
                best = cells
            if len(best) > 0.8 * len(places):
                break
    which = np.array(sorted(best), int)
    cell = np.array([best[one] for one in which], int).reshape(-1, 2)
    if len(which) < least or np.ptp(cell, axis=0).min() + 1 < side:
        raise UserError(
            "There is no lattice of marks in the picture.",
            field="PICTURE",
            value=f"{len(places)} corners or dots, {len(which)} of them in rows and columns",
            allowed=f"{least} or more, {side} or more in each row and column",
        )
    return which, cell


def _from(seed: int, places: np.ndarray, tree: cKDTree) -> dict[int, tuple[int, int]]:
    """Count from one mark on; return the cell of each mark that was reached."""
    steps = _first_steps(seed, places, tree)
    if steps is None:
        return {}
    cells = {seed: (0, 0)}
    taken = {(0, 0): seed}
    own = {seed: steps}  # steps to the right and down at each mark
    waiting: list[tuple[float, int, int, int]] = []

    def offer(mark: int) -> None:
        for axis in (0, 1):
            for sign in (1, -1):
                step = sign * own[mark][axis]
                far, at = tree.query(places[mark] + step)
                miss = far / np.hypot(*step)
                if miss < NEAR and at not in cells:
                    heapq.heappush(waiting, (miss, mark, int(at), 2 * axis + (sign < 0)))

    offer(seed)
    while waiting:  # the surest first
        _, mark, at, way = heapq.heappop(waiting)
        axis, sign = way // 2, -1 if way % 2 else 1
        cell = list(cells[mark])
        cell[axis] += sign
        if at in cells or tuple(cell) in taken:
            continue
        cells[at] = tuple(cell)
        taken[tuple(cell)] = at
        found = [step.copy() for step in own[mark]]
        found[axis] = sign * (places[at] - places[mark])
        other = 1 - axis
        for beside in (1, -1):  # the other step from a neighbour of the new mark, where it is known
            near = list(cell)
            near[other] += beside
            if tuple(near) in taken:
                found[other] = beside * (places[taken[tuple(near)]] - places[at])
        own[at] = found
        offer(at)
    return cells


def _first_steps(seed: int, places: np.ndarray, tree: cKDTree) -> list[np.ndarray] | None:
    """Return the steps to the right and down at a mark: to its neighbours, across each other."""
    _, near = tree.query(places[seed], k=min(9, len(places)))
    steps = places[near[1:]] - places[seed]
    first = steps[0]
    across = np.abs(first[0] * steps[:, 1] - first[1] * steps[:, 0])
    across /= np.hypot(*first) * np.hypot(*steps.T)
    beside = np.flatnonzero(across > np.sin(np.radians(50)))
    if not beside.size:
        return None
    pair = [first, steps[beside[0]]]
    pair.sort(key=lambda step: -abs(step[0]) + abs(step[1]))
    return [pair[0] * np.sign(pair[0][0] or 1), pair[1] * np.sign(pair[1][1] or 1)]
