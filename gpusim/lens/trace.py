"""Sequential trace of real rays through surfaces of revolution, in float64.

Coordinates: z along the axis in the direction of light, the first vertex at z = 0; the field lies
in the y-z plane, so that a field angle theta > 0 sends the chief ray to y > 0 in the image. All
lengths in mm. Ray arrays have the shape (L, R): wavelengths, rays. A ray that misses a surface or
is totally reflected gets ``ok = False`` and keeps finite, meaningless numbers: never NaN.

The rays of a field start on a plane perpendicular to it: see `gpusim.lens.launch`.

A surface that is decentred or tilted is met in its own frame; the others cost nothing more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.lens.geometry import Geometry
from gpusim.lens.launch import Launch
from gpusim.lens.throughput import Crossings


@dataclass(frozen=True)
class Rays:
    """Where rays met the surfaces, and what they are behind the last one traced.

    Attributes
    ----------
    x, y, z : ndarray, shape (S, L, R)
        Intersection with each surface that was traced, mm; z from the first vertex.
    own_x, own_y : ndarray, shape (S, L, R)
        The same from the surface's own vertex, along its own axes: what its aperture sees.
    point, direction : ndarray, shape (3, L, R)
        Last intersection and direction cosines behind it.
    path : ndarray, shape (L, R)
        Optical path from the launch plane to ``point``, mm.
    ok : ndarray of bool, shape (L, R)
    crossings : Crossings, or None
        Where they were asked for.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    own_x: np.ndarray
    own_y: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    path: np.ndarray
    ok: np.ndarray
    crossings: Crossings | None = None


def _sag(r2: np.ndarray, c: float, conic: float, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sag of conic plus even polynomial, and its derivative with respect to r^2."""
    root = np.sqrt(np.maximum(1 - (1 + conic) * c * c * r2, 1e-12))
    sag = c * r2 / (1 + root)
    slope = c / (2 * root)
    power = np.ones_like(r2)
    for i, coefficient in enumerate(a, start=1):
        slope = slope + i * coefficient * power
        power = power * r2
        sag = sag + coefficient * power
    return sag, slope


def _meet(
    point: np.ndarray, direction: np.ndarray, c: float, conic: float, a: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance to a surface whose vertex is the origin, its unit normal there, and success.

    Conics in closed form: the root nearest the vertex of A t^2 - 2 B t + C = 0 (Welford,
    Aberrations of Optical Systems, 1986, ch. 4); even aspheres by Newton from the conic.
    """
    x, y, z = point
    dx, dy, dz = direction
    k = c * (1 + conic)
    quad_a = c * (dx * dx + dy * dy) + k * dz * dz
    quad_b = dz - c * (x * dx + y * dy) - k * z * dz
    quad_c = c * (x * x + y * y) + k * z * z - 2 * z
    square = quad_b * quad_b - quad_a * quad_c
    ok = square >= 0
    t = quad_c / (quad_b + np.sqrt(np.maximum(square, 0)))
    if a.any():
        # Newton starts from the conic or from the vertex's plane, whichever is nearer to the
        # surface there: a ray may miss the conic, or meet it far from the asphere.
        plane = -z / dz
        gaps = [
            np.abs(z + s * dz - _sag((x + s * dx) ** 2 + (y + s * dy) ** 2, c, conic, a)[0])
            for s in (t, plane)
        ]
        t = np.where(ok & (gaps[0] < gaps[1]), t, plane)
        ok = np.isfinite(t)
        for _ in range(20):  # quadratic convergence: 4 to 6 are enough on real lenses
            px, py = x + t * dx, y + t * dy
            sag, slope = _sag(px * px + py * py, c, conic, a)
            step = (z + t * dz - sag) / (dz - 2 * slope * (px * dx + py * dy))
            t = t - step
            if np.max(np.abs(step), initial=0, where=ok) < 1e-14 * (1 + np.max(np.abs(t))):
                break
        px, py = x + t * dx, y + t * dy
        r2 = px * px + py * py
        sag, slope = _sag(r2, c, conic, a)
        # 1e-10 mm is 2e-7 waves; what has not converged there is no intersection.
        ok = ok & (np.abs(z + t * dz - sag) < 1e-10) & ((1 + conic) * c * c * r2 < 1)
        normal = np.stack([-2 * slope * px, -2 * slope * py, np.ones_like(t)])
    else:
        px, py, pz = x + t * dx, y + t * dy, z + t * dz
        normal = np.stack([-c * px, -c * py, 1 - k * pz])
        ok = ok & (normal[2] > 0)  # the sheet that carries the vertex
    return t, normal / np.sqrt((normal * normal).sum(0)), ok


def trace(
    geometry: Geometry,
    index: np.ndarray,
    launch: Launch,
    px: np.ndarray,
    py: np.ndarray,
    *,
    through: int | None = None,
    crossings: bool = False,
) -> Rays:
    """Trace the rays of one field.

    Parameters
    ----------
    geometry : Geometry
    index : ndarray, shape (S + 1, L)
        Refractive index before the first surface and behind each.
    launch : Launch
        The field.
    px, py : ndarray, shape (L, R)
        Where each ray crosses the launch plane, mm.
    through : int, optional
        Number of surfaces to trace (all of them).
    crossings : bool
        Whether to keep angles and legs.

    Returns
    -------
    Rays
    """
    count = len(geometry.curvature) if through is None else through
    point, direction, path = launch.rays(px, py)
    ok = np.ones(px.shape, dtype=bool)
    places = np.empty((count, *point.shape))
    moved = geometry.moved[:count].any()
    own = np.empty((count, 2, *px.shape)) if moved else places[:, :2]
    kept = Crossings(*np.ones((3, count, *px.shape))) if crossings else None
    with np.errstate(all="ignore"):  # failed rays run on with clipped numbers
        for s in range(count):
            n1, n2 = index[s][:, None], index[s + 1][:, None]
            local, towards = point.copy(), direction
            local[2] -= geometry.vertex_z[s]
            if geometry.moved[s]:
                local[:2] -= geometry.decentre[s][:, None, None]
                local = np.tensordot(geometry.rotation[s].T, local, 1)
                towards = np.tensordot(geometry.rotation[s].T, direction, 1)
            t, normal, met = _meet(
                local, towards, geometry.curvature[s], geometry.conic[s], geometry.asphere[s]
            )
            ratio = n1 / n2
            cos_in = (towards * normal).sum(0)
            square = 1 - ratio * ratio * (1 - cos_in * cos_in)
            # Snell's law in vector form (Welford 1986, ch. 4); total reflection: square < 0.
            good = met & (cos_in > 0) & (square >= 0) & np.isfinite(t)
            cos_out = np.sqrt(np.maximum(square, 0))
            if geometry.moved[s]:
                normal = np.tensordot(geometry.rotation[s], normal, 1)
            bent = ratio * direction + (cos_out - ratio * cos_in) * normal
            ok &= good
            # A failed ray stays where it was, so that its numbers remain finite.
            point = np.where(ok, point + t * direction, point)
            path = np.where(ok, path + n1 * t, path)
            direction = np.where(ok, bent, direction)
            places[s] = point
            if kept is not None:
                for of, value in zip(kept, (cos_in, cos_out, t), strict=True):
                    of[s] = np.where(ok, value, 1.0)
            if moved:
                own[s] = np.where(ok, local + t * towards, local)[:2]
    return Rays(*places.swapaxes(0, 1), *own.swapaxes(0, 1), point, direction, path, ok, kept)


def paraxial(
    geometry: Geometry, index: np.ndarray, y: float, u: float, *, through: int | None = None
) -> np.ndarray:
    """Trace one paraxial ray; returns heights and angles, shape (2, S + 1, L).

    Entry 0 is before the first surface, entry s + 1 at and behind surface s; ``through`` is the
    number of surfaces to trace (all of them).
    """
    height = np.full(index.shape[1], y, dtype=float)
    angle = np.full(index.shape[1], u, dtype=float)
    rows = [(height, angle)]
    for s in range(len(geometry.curvature) if through is None else through):
        if s:
            height = height + angle * (geometry.vertex_z[s] - geometry.vertex_z[s - 1])
        # A polynomial's r^2 term carries power: the vertex curvature is c + 2 a2.
        curvature = geometry.curvature[s] + 2 * geometry.asphere[s, 0]
        power = (index[s + 1] - index[s]) * curvature
        angle = (index[s] * angle - height * power) / index[s + 1]
        rows.append((height, angle))
    return np.array(rows).transpose(1, 0, 2)


def entrance_pupil(geometry: Geometry, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the paraxial entrance pupil: its z (mm, (L,)) and stop height per pupil height."""
    magnification, per_angle = (
        paraxial(geometry, index, y, u, through=geometry.stop + 1)[0, -1]
        for y, u in ((1.0, 0.0), (0.0, 1.0))
    )
    return per_angle / magnification, magnification
