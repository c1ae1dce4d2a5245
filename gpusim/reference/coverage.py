"""Exact areas of chart primitives inside small quadrilaterals, for the exact model."""

from __future__ import annotations

from typing import Any

import numpy as np

NOTHING = 1e-9  # of a square: an area without a centre of mass


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the z component of the cross product of plane vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def area(polygons: np.ndarray) -> np.ndarray:
    """Return the areas of polygons (N, V, 2), by the shoelace formula, never negative."""
    return np.abs(np.sum(cross(polygons, np.roll(polygons, -1, axis=1)), axis=1)) / 2


def clip(polygons: np.ndarray, normal: np.ndarray, limit: float) -> np.ndarray:
    """Clip polygons by the half-plane normal . p <= limit.

    A vertex outside is moved onto the line along the normal, and each crossing edge gains its
    crossing point: what then lies outside the clipped polygon lies on the line, and has no area.

    Parameters
    ----------
    polygons : ndarray (N, V, 2)
    normal : ndarray (2,) or (N, 2)
        Unit vector.
    limit : float

    Returns
    -------
    ndarray (N, V or 2 V, 2)
    """
    normal = np.atleast_2d(normal)[:, None]
    height = polygons[..., 0] * normal[..., 0] + polygons[..., 1] * normal[..., 1] - limit
    if not (height > 0).any():
        return polygons
    kept = polygons - np.maximum(height, 0)[..., None] * normal
    following = np.roll(polygons, -1, axis=1)
    next_height = np.roll(height, -1, axis=1)
    crosses = (height > 0) != (next_height > 0)
    fraction = np.where(crosses, height / np.where(crosses, height - next_height, 1.0), 0.0)
    meeting = polygons + fraction[..., None] * (following - polygons)
    points = np.stack([kept, np.where(crosses[..., None], meeting, kept)], axis=2)
    return points.reshape(len(polygons), 2 * polygons.shape[1], 2)


def centroid(polygons: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return the centres of mass (N, 2) of polygons (N, V, 2), `otherwise` of those that have none.

    The weighted mean of the triangles between the edges and `otherwise`, by their areas.
    """
    start = polygons - otherwise[:, None]
    end = np.roll(start, -1, axis=1)
    doubled = cross(start, end)
    total = doubled.sum(axis=1)
    there = np.abs(total) > NOTHING * np.abs(doubled).sum(axis=1)
    moment = np.einsum("nvk,nv->nk", start + end, doubled) / 3
    return otherwise + np.where(there[:, None], moment / np.where(there, total, 1.0)[:, None], 0.0)


def part_of(quads: np.ndarray, shape: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of small quadrilaterals inside a primitive, and its centre of mass.

    The share is exact for a disc. The centre of mass takes the outline as straight.

    Parameters
    ----------
    quads : ndarray (N, 4, 2)
    shape : gpusim.scene.chart.Rect, Disc or Polygon

    Returns
    -------
    share : ndarray (N,)
    centre of mass : ndarray (N, 2)
    """
    centre, middle = np.array([shape.cx, shape.cy]), quads.sum(axis=1) / 4
    whole = area(quads)
    if hasattr(shape, "radius"):
        outward = middle - centre
        outward /= np.maximum(np.hypot(*outward.T), 1e-12)[:, None]
        inside = clip(quads - centre, outward, shape.radius)
        return disc_area(quads, centre, shape.radius) / whole, centre + centroid(
            inside, middle - centre
        )
    if hasattr(shape, "points"):
        return _part_of_polygon(quads - centre, np.asarray(shape.points) - centre, centre)
    c, s = np.cos(shape.angle_rad), np.sin(shape.angle_rad)
    turn = np.array([[c, -s], [s, c]])
    inside, local = (quads - centre) @ turn, (middle - centre) @ turn
    for axis, half in enumerate((shape.half_w, shape.half_h)):
        e = np.eye(2)[axis]
        inside = clip(clip(inside, e, half), -e, half)
    return area(inside) / whole, centre + centroid(inside, local) @ turn.T


def _part_of_polygon(
    quads: np.ndarray, corners: np.ndarray, centre: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the same of a convex polygon, both from its centre; the results not.

    Quadrilaterals that the same sides cut are clipped together: each clip doubles the vertices.
    """
    ways = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([ways[:, 1], -ways[:, 0]], axis=1) / np.hypot(*ways.T)[:, None]
    outward *= np.sign(np.sum(outward * corners, axis=1))[:, None]
    limits = np.sum(outward * corners, axis=1)
    cut = (np.einsum("nvk,sk->nsv", quads, outward) > limits[:, None]).any(axis=2)
    share, mass = np.zeros(len(quads)), np.zeros((len(quads), 2))
    for which in np.unique(cut, axis=0):
        own = np.flatnonzero((cut == which).all(axis=1))
        inside = quads[own]
        for side in np.flatnonzero(which):
            inside = clip(inside, outward[side], limits[side])
        share[own] = area(inside) / area(quads[own])
        mass[own] = centre + centroid(inside, quads[own].mean(axis=1))
    return share, mass


def disc_area(quads: np.ndarray, centre: tuple[float, float], radius: float) -> np.ndarray:
    """Return the area of each convex quadrilateral (N, 4, 2) inside a disc."""
    local = quads - np.asarray(centre)
    distance = np.hypot(local[..., 0], local[..., 1])
    inside = np.all(distance <= radius, axis=1)
    # Farther from the nearest corner than the longest side: the disc does not reach in.
    side = np.hypot(*np.moveaxis(np.roll(local, -1, axis=1) - local, -1, 0)).max(axis=1)
    cut = ~inside & (distance.min(axis=1) <= radius + side)
    result = np.where(inside, area(quads), 0.0)
    result[cut] = _disc_area(local[cut], radius)
    return result


def _disc_area(start: np.ndarray, radius: float) -> np.ndarray:
    """Return the area of polygons (N, V, 2) inside a disc about the origin.

    Green's theorem along the edges: the part of an edge inside the circle spans a triangle with the
    centre, a part outside spans a sector.
    """
    edge = np.roll(start, -1, axis=1) - start
    a = np.sum(edge**2, axis=-1)
    b = np.sum(start * edge, axis=-1)
    c = np.sum(start**2, axis=-1) - radius**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0))
    enter = np.clip((-b - root) / a, 0, 1)[..., None]
    leave = np.clip((-b + root) / a, 0, 1)[..., None]
    stops = [start, start + enter * edge, start + leave * edge, start + edge]

    def sector(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        return radius**2 / 2 * np.arctan2(cross(p, q), np.sum(p * q, axis=-1))

    total = sector(stops[0], stops[1]) + cross(stops[1], stops[2]) / 2 + sector(stops[2], stops[3])
    return np.abs(total.sum(axis=1))
