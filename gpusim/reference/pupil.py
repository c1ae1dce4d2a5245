"""The field in the pupil on the grid of the transform, from the wavefront at coarser nodes."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial

_NODES = (-1, 0, 1, 2)


def _lagrange() -> list[Polynomial]:
    """Return the cubics that are 1 at one of the nodes -1, 0, 1, 2 and 0 at the others."""
    return [
        Polynomial.fromroots([other for other in _NODES if other != node])
        / np.prod([float(node - other) for other in _NODES if other != node])
        for node in _NODES
    ]


def _at(weights: list[Polynomial], t: float) -> np.ndarray:
    """Return the value of each weight."""
    return np.array([one(t) for one in weights])


def edge_share(h: float, a: float, b: float) -> float:
    """Return the share of the unit square about the origin where a u + b v < h.

    The mean, over the side along the smaller slope, of the length that lies inside on the other
    side: a straight line in u, cut to 0..1.
    """
    small, large = sorted((abs(a), abs(b)))
    if large == 0:
        return float(h > 0)
    middle, half = h / large + 0.5, small / large / 2
    low, high = middle - half, middle + half
    if half < 1e-9:
        return float(np.clip(middle, 0, 1))
    cut_low, cut_high = np.clip([low, high], 0, 1)
    whole = max(high, 1.0) - max(low, 1.0)  # where all of the length lies inside
    return float(((cut_high - cut_low) * (cut_high + cut_low) / 2 + whole) / (high - low))


def pupil(
    nodes: np.ndarray,
    *,
    first: tuple[float, float],
    step: tuple[float, float],
    centre: float,
    cell: float,
    chief_beta: float,
    waves_per_mm: float,
    length: int,
    rows: int,
    fold_um: float,
    focus_mm: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate W and reach, and fill the cells of half the pupil, alpha > 0.

    Parameters
    ----------
    nodes : ndarray (A, B, 2)
        W (waves) and reach at the nodes; reach 0: not known.
    first, step : (float, float)
        alpha and beta of node (0, 0), and from node to node. The other half of the pupil mirrors
        this one: node -1 - i is node i.
    centre, cell : float
        Cell (i, j) lies at alpha = (i + 1/2) cell, beta = centre + (j - T/2 + 1/2) cell.
    chief_beta, waves_per_mm : float
        Of the chief ray behind the lens; 1 / wavelength.
    length, rows : int
        T, and the rows that are wanted.
    fold_um, focus_mm : float
        Rays that land farther out than this in x or y fold; shift of the image plane.

    Returns
    -------
    field : ndarray (rows, T), complex128
        A exp(2 pi i W).
    sums : ndarray (rows, 2), float64
        Sums over each row: of A; of A where rays fold.
    """
    nodes = np.asarray(nodes, np.float64)
    half, across = nodes.shape[:2]
    cubic = _lagrange()
    slope = [one.deriv() for one in cubic]
    field = np.zeros((rows, length), np.complex128)
    sums = np.zeros((rows, 2))
    chief_slope = chief_beta / np.sqrt(1 - chief_beta**2)
    for i in range(rows):
        alpha = (i + 0.5) * cell
        x = (alpha - first[0]) / step[0]
        low_a = int(np.floor(x))
        at_a = x - low_a
        if low_a + 2 >= half:
            continue
        lines = [low_a + node if low_a + node >= 0 else -1 - (low_a + node) for node in _NODES]
        for j in range(length):
            beta = centre + (j - length / 2 + 0.5) * cell
            y = (beta - first[1]) / step[1]
            low_b = int(np.floor(y))
            if low_b < 1 or low_b + 2 >= across:
                continue
            stencil = nodes[lines, low_b - 1 : low_b + 3]
            if (stencil[..., 1] == 0).any():
                continue

            at_b = y - low_b
            w, reach = np.einsum("a,b,abv->v", _at(cubic, at_a), _at(cubic, at_b), stencil)
            w_a, reach_a = np.einsum("a,b,abv->v", _at(slope, at_a), _at(cubic, at_b), stencil)
            w_b, reach_b = np.einsum("a,b,abv->v", _at(cubic, at_a), _at(slope, at_b), stencil)
            share = edge_share(1 - reach, reach_a * cell / step[0], reach_b * cell / step[1])
            # The plane moves by focus_mm and the chief ray's point in it by focus_mm times its
            # slope; the path to the foot of the perpendicular grows by what that is along the ray.
            moved = np.array([chief_slope, 1.0]) * focus_mm
            gamma = np.sqrt(max(1 - alpha**2 - beta**2, 1e-6))
            longer = moved @ [beta, gamma] - moved @ [chief_beta, np.sqrt(1 - chief_beta**2)]
            land_x = focus_mm * alpha / gamma - w_a / step[0] / waves_per_mm
            land_y = focus_mm * (beta / gamma - chief_slope) - w_b / step[1] / waves_per_mm
            field[i, j] = share * np.exp(2j * np.pi * (w + longer * waves_per_mm))
            folds = 1e3 * max(abs(land_x), abs(land_y)) > fold_um
            sums[i] += share, share * folds
    return field, sums
