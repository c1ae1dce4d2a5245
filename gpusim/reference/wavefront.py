"""The wavefront at the nodes of a grid of directions, from one ray near each node."""

from __future__ import annotations

import numpy as np


def wavefront(
    first: tuple[float, float],
    step: tuple[float, float],
    waves_per_mm: float,
    opd: np.ndarray,
    directions: np.ndarray,
) -> np.ndarray:
    """Carry W from each ray to its node, along the slope of W: minus where the ray lands.

    Parameters
    ----------
    first, step : (float, float)
        Direction cosines alpha and beta of node (0, 0), and from node to node.
    waves_per_mm : float
        1 / wavelength.
    opd : ndarray (A, B, 4)
        W (waves), reach, landing point x and y (mm from the chief ray's).
    directions : ndarray (A, B, 4)
        alpha, beta of each ray, and two that do not count.

    Returns
    -------
    ndarray (A, B, 2), float64
        W at the node, and reach: 0 where the ray leaves half a step off its node or more.
    """
    opd, directions = np.asarray(opd, np.float64), np.asarray(directions, np.float64)
    nodes = np.empty((*opd.shape[:2], 2))
    for a in range(opd.shape[0]):
        for b in range(opd.shape[1]):
            off_a = first[0] + a * step[0] - directions[a, b, 0]
            off_b = first[1] + b * step[1] - directions[a, b, 1]
            slope_a, slope_b = -waves_per_mm * opd[a, b, 2:]
            near = abs(off_a) < step[0] / 2 and abs(off_b) < step[1] / 2
            nodes[a, b] = opd[a, b, 0] + slope_a * off_a + slope_b * off_b, near * opd[a, b, 1]
    return nodes
