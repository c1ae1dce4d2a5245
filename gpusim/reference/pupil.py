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


def edge_share(h: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the share of the unit square about the origin where a u + b v < h.

    The mean, over the side along the smaller slope, of the length that lies inside on the other
    side: a straight line in u, cut to 0..1.
    """
    h, a, b = (np.asarray(one, np.float64) for one in (h, a, b))
    small, large = np.minimum(abs(a), abs(b)), np.maximum(abs(a), abs(b))
    # Any edge that passes the square has its middle within -0.5..1.5.
    with np.errstate(all="ignore"):
        middle = np.where(large > 0, np.clip(h / large + 0.5, -1, 2), h > 0)
        half = np.where(large > 0, small / large / 2, 0)
    flat = half < 1e-9
    half = np.where(flat, 0.5, half)
    low, high = middle - half, middle + half
    cut_low, cut_high = np.clip(low, 0, 1), np.clip(high, 0, 1)
    whole = np.maximum(high, 1) - np.maximum(low, 1)  # where all of the length lies inside
    mean = ((cut_high - cut_low) * (cut_high + cut_low) / 2 + whole) / (high - low)
    return np.where(flat, np.clip(middle, 0, 1), mean)


def _interpolated(
    nodes: np.ndarray,
    exponent: np.ndarray,
    place: tuple[np.ndarray, np.ndarray],
    low: tuple[np.ndarray, np.ndarray],
    step: tuple[float, float],
    *,
    mirrored: bool,
) -> tuple[np.ndarray, ...]:
    """Interpolate by cubics at points of the pupil; what is not said is as for `pupil`.

    Parameters
    ----------
    nodes, exponent
    place : two ndarrays (P,)
        Along alpha and beta, in nodes from node (0, 0).
    low : two ndarrays of int (P,)
        Numbers of the nodes below.
    step, mirrored

    Returns
    -------
    value, d_alpha, d_beta : ndarray (P, 2)
        W and reach, and their slopes.
    known : ndarray of bool (P,)
        Whether all nodes around are.
    filtered : ndarray (P,)
        The exponent.
    """
    whole, half = (np.concatenate([nodes[::-1], nodes]), len(nodes)) if mirrored else (nodes, 0)
    (x, y), (low_a, low_b) = place, low
    cubic = _lagrange()
    slope = [one.deriv() for one in cubic]
    value, d_alpha, d_beta = np.zeros((3, len(x), 2))
    known = np.ones(len(x), dtype=bool)
    for m, node_a in enumerate(_NODES):
        for n, node_b in enumerate(_NODES):
            node = whole[half + low_a + node_a, low_b + node_b]
            known &= node[:, 1] != 0
            in_a, in_b = cubic[m](x - low_a), cubic[n](y - low_b)
            value += (in_a * in_b)[:, None] * node
            d_alpha += (slope[m](x - low_a) * in_b)[:, None] * node / step[0]
            d_beta += (in_a * slope[n](y - low_b))[:, None] * node / step[1]
    filtered = np.zeros(len(x))
    filters = np.concatenate([exponent[::-1], exponent]) if mirrored else exponent
    filters = filters.astype(np.float64)
    for m, node_a in enumerate(_NODES):
        for n, node_b in enumerate(_NODES):
            in_a, in_b = cubic[m](x - low_a), cubic[n](y - low_b)
            filtered += in_a * in_b * filters[half + low_a + node_a, low_b + node_b]
    return value, d_alpha, d_beta, known, filtered


def pupil(
    nodes: np.ndarray,
    *,
    first: tuple[float, float],
    step: tuple[float, float],
    origin: tuple[float, float],
    cell: float,
    chief: tuple[float, float],
    waves_per_mm: float,
    length: int,
    rows: int,
    fade_um: float,
    fold_um: float,
    focus_mm: float,
    exponent: np.ndarray,
    mirrored: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Interpolate W and reach, and fill the cells of half the pupil, alpha > 0, or of all of it.

    Parameters
    ----------
    nodes : ndarray (A, B, 2)
        W (waves) and reach at the nodes; reach 0: not known.
    first, step : (float, float)
        alpha and beta of node (0, 0), and from node to node.
    origin, cell : (float, float), float
        Cell (i, j) lies at alpha = (i + 1/2) cell, beta = (j - T/2 + 1/2) cell, from there.
    chief, waves_per_mm : (float, float), float
        Direction cosines of the chief ray behind the lens; 1 / wavelength.
    length, rows : int
        T, and the rows that are wanted.
    fade_um, fold_um : float
        Rays that land farther out than the latter in x or y are left out of the field; from the
        former on they fade, as the quintic with two derivatives of 0 at both ends does.
    focus_mm : float
        Shift of the image plane.
    exponent : ndarray (A, B)
        -ln of the amplitude at the nodes: of what enters there, and of what passes of it.
    mirrored : bool
        Whether the other half of the pupil mirrors this one: node -1 - i is node i.

    Returns
    -------
    field : ndarray (rows, T), complex128
        A exp(2 pi i W).
    sums : ndarray (rows, 2), float64
        Sums over each row: of the light that each cell passes; of that whose rays are left out.
    """
    nodes = np.asarray(nodes, np.float64)
    down, across = nodes.shape[:2]
    alpha = (origin[0] + (np.arange(rows) + 0.5) * cell)[:, None]
    beta = (origin[1] + (np.arange(length) - length / 2 + 0.5) * cell)[None]
    x, y = (alpha - first[0]) / step[0], (beta - first[1]) / step[1]
    low_a, low_b = np.floor(x).astype(int), np.floor(y).astype(int)
    first_a = -1 if mirrored else 1
    here = (low_a >= first_a) & (low_a + 2 < down) & (low_b >= 1) & (low_b + 2 < across)
    x, y, low_a, low_b = (np.broadcast_to(one, here.shape)[here] for one in (x, y, low_a, low_b))
    alpha, beta = np.broadcast_to(alpha, here.shape)[here], np.broadcast_to(beta, here.shape)[here]

    value, d_alpha, d_beta, known, filtered = _interpolated(
        nodes, exponent, (x, y), (low_a, low_b), step, mirrored=mirrored
    )
    passed = np.exp(-filtered)
    share = known * edge_share(1 - value[:, 1], d_alpha[:, 1] * cell, d_beta[:, 1] * cell)

    # The plane moves by focus_mm and the chief ray's point in it by focus_mm times its slope; the
    # path to the foot of the perpendicular grows by what that is along the ray.
    chief_gamma = np.sqrt(1 - chief[0] ** 2 - chief[1] ** 2)
    slope_x, slope_y = chief[0] / chief_gamma, chief[1] / chief_gamma
    gamma = np.sqrt(np.maximum(1 - alpha**2 - beta**2, 1e-6))
    along_ray = alpha * slope_x + beta * slope_y + gamma
    along_chief = chief[0] * slope_x + chief[1] * slope_y + chief_gamma
    w = value[:, 0] + focus_mm * (along_ray - along_chief) * waves_per_mm
    # dW is minus the landing; a shift moves a ray's landing, and the chief ray's, by their slopes.
    land_x = focus_mm * (alpha / gamma - slope_x) - d_alpha[:, 0] / waves_per_mm
    land_y = focus_mm * (beta / gamma - slope_y) - d_beta[:, 0] / waves_per_mm
    folds = 1e3 * np.maximum(abs(land_x), abs(land_y)) > fold_um
    fading = Polynomial([0, 0, 0, 10, -15, 6])
    kept = np.ones(len(x))
    for land in (land_x, land_y):
        kept *= 1 - fading(np.clip((1e3 * abs(land) - fade_um) / (fold_um - fade_um), 0, 1))

    field = np.zeros(here.shape, np.complex128)
    field[here] = share * passed * kept * np.exp(2j * np.pi * w)
    light, folded = np.zeros((2, *here.shape))
    light[here], folded[here] = share * passed**2, share * passed**2 * folds
    return field, np.stack([light.sum(axis=1), folded.sum(axis=1)], axis=-1)
