"""Sequential trace of real rays through rotationally symmetric surfaces, in float64.

Coordinates: z along the axis in the direction of light, the first vertex at z = 0; the field lies
in the y-z plane, so that a field angle theta > 0 sends the chief ray to y > 0 in the image. All
lengths in mm. Ray arrays have the shape (L, R): wavelengths, rays. A ray that misses a surface or
is totally reflected gets ``ok = False`` and keeps finite, meaningless numbers: never NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Geometry:
    """Shapes and places of S surfaces.

    Attributes
    ----------
    curvature, conic, vertex_z : ndarray, shape (S,)
        1/mm, conic constant, mm.
    asphere : ndarray, shape (S, 15)
        a2 ... a30, mm^(1-k).
    stop : int
        Index of the stop surface, from 0.
    """

    curvature: np.ndarray
    conic: np.ndarray
    asphere: np.ndarray
    vertex_z: np.ndarray
    stop: int


@dataclass(frozen=True)
class Rays:
    """Where rays met the surfaces, and what they are behind the last one traced.

    Attributes
    ----------
    x, y : ndarray, shape (S, L, R)
        Intersection with each surface that was traced, mm.
    point, direction : ndarray, shape (3, L, R)
        Last intersection (z absolute) and direction cosines behind it.
    path : ndarray, shape (L, R)
        Optical path from the wavefront through the origin to ``point``, mm.
    ok : ndarray of bool, shape (L, R)
    """

    x: np.ndarray
    y: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    path: np.ndarray
    ok: np.ndarray


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
    theta: float,
    px: np.ndarray,
    py: np.ndarray,
    *,
    through: int | None = None,
) -> Rays:
    """Trace parallel rays from infinity.

    Parameters
    ----------
    geometry : Geometry
    index : ndarray, shape (S + 1, L)
        Refractive index before the first surface and behind each.
    theta : float
        Field angle in rad.
    px, py : ndarray, shape (L, R)
        Where each ray crosses the plane z = 0 of the first vertex, mm.
    through : int, optional
        Number of surfaces to trace (all of them).

    Returns
    -------
    Rays
    """
    count = len(geometry.curvature) if through is None else through
    point = np.stack([px, py, np.zeros_like(px)])
    direction = np.empty_like(point)
    direction[0], direction[1], direction[2] = 0.0, np.sin(theta), np.cos(theta)
    path = index[0][:, None] * py * np.sin(theta)
    ok = np.ones(px.shape, dtype=bool)
    xs, ys = np.empty((2, count, *px.shape))
    with np.errstate(all="ignore"):  # failed rays run on with clipped numbers
        for s in range(count):
            n1, n2 = index[s][:, None], index[s + 1][:, None]
            local = point.copy()
            local[2] -= geometry.vertex_z[s]
            t, normal, met = _meet(
                local, direction, geometry.curvature[s], geometry.conic[s], geometry.asphere[s]
            )
            ratio = n1 / n2
            cos_in = (direction * normal).sum(0)
            square = 1 - ratio * ratio * (1 - cos_in * cos_in)
            # Snell's law in vector form (Welford 1986, ch. 4); total reflection: square < 0.
            good = met & (cos_in > 0) & (square >= 0) & np.isfinite(t)
            cos_out = np.sqrt(np.maximum(square, 0))
            bent = ratio * direction + (cos_out - ratio * cos_in) * normal
            ok &= good
            # A failed ray stays where it was, so that its numbers remain finite.
            point = np.where(ok, point + t * direction, point)
            path = np.where(ok, path + n1 * t, path)
            direction = np.where(ok, bent, direction)
            xs[s], ys[s] = point[0], point[1]
    return Rays(xs, ys, point, direction, path, ok)


def paraxial(geometry: Geometry, index: np.ndarray, y: float, u: float) -> np.ndarray:
    """Trace one paraxial ray; returns heights and angles, shape (2, S + 1, L).

    Entry 0 is before the first surface, entry s + 1 at and behind surface s.
    """
    height = np.full(index.shape[1], y, dtype=float)
    angle = np.full(index.shape[1], u, dtype=float)
    rows = [(height, angle)]
    for s in range(len(geometry.curvature)):
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
    stop = geometry.stop
    if stop == 0:
        return np.full(index.shape[1], geometry.vertex_z[0]), np.ones(index.shape[1])
    before = Geometry(
        geometry.curvature[:stop],
        geometry.conic[:stop],
        geometry.asphere[:stop],
        geometry.vertex_z[:stop],
        stop,
    )
    gap = geometry.vertex_z[stop] - geometry.vertex_z[stop - 1]
    at_stop = []
    for y, u in ((1.0, 0.0), (0.0, 1.0)):
        heights, angles = paraxial(before, index[: stop + 1], y, u)
        at_stop.append(heights[-1] + gap * angles[-1])
    magnification, per_angle = at_stop
    return per_angle / magnification, magnification


def aim(
    geometry: Geometry,
    index: np.ndarray,
    theta: float,
    stop_x: np.ndarray,
    stop_y: np.ndarray,
    tolerance_mm: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the rays that meet the stop surface at given points, by Newton on real rays.

    Parameters
    ----------
    geometry, index, theta
        As for ``trace``.
    stop_x, stop_y : ndarray, shape (R,)
        Wanted intersections with the stop surface, mm.
    tolerance_mm : float
        Accepted miss at the stop.

    Returns
    -------
    px, py : ndarray, shape (L, R)
        Where they cross the plane z = 0.
    ok : ndarray of bool, shape (L, R)
        False where no such ray was found.
    """
    wavelengths = index.shape[1]
    pupil_z, magnification = entrance_pupil(geometry, index)
    zero = np.zeros((wavelengths, 1))

    def solve(theta, px, py, wanted_x, wanted_y):
        """Newton with a forward-difference Jacobian, all rays at once."""
        # The Jacobian's step only sets the rate of convergence; the miss is that of the real ray.
        step = 1e-4 * max(float(np.max(np.abs(stop_x))), float(np.max(np.abs(stop_y))), 1e-3)
        count = geometry.stop + 1
        safe_x, safe_y = px[:, :1], py[:, :1]
        for _ in range(15):
            offsets = [(0.0, 0.0), (step, 0.0), (0.0, step)]
            rays = trace(
                geometry,
                index,
                theta,
                np.concatenate([px + dx for dx, _ in offsets], axis=1),
                np.concatenate([py + dy for _, dy in offsets], axis=1),
                through=count,
            )
            x0, x1, x2 = np.split(rays.x[-1], 3, axis=1)
            y0, y1, y2 = np.split(rays.y[-1], 3, axis=1)
            ok = np.split(rays.ok, 3, axis=1)
            traced = ok[0] & ok[1] & ok[2]
            miss_x, miss_y = x0 - wanted_x, y0 - wanted_y
            found = ok[0] & (np.hypot(miss_x, miss_y) < tolerance_mm)
            if found.all():
                break
            a, b, c, d = (x1 - x0) / step, (x2 - x0) / step, (y1 - y0) / step, (y2 - y0) / step
            det = a * d - b * c
            usable = traced & (np.abs(det) > 1e-9)
            det = np.where(usable, det, 1.0)
            new_x = px - (d * miss_x - b * miss_y) / det
            new_y = py - (a * miss_y - c * miss_x) / det
            # A start that does not reach the stop is drawn half-way to the chief ray.
            px = np.where(found, px, np.where(usable, new_x, (px + safe_x) / 2))
            py = np.where(found, py, np.where(usable, new_y, (py + safe_y) / 2))
        return px, py, found

    # The chief ray, walked out from the axis in steps of at most 5 deg.
    chief_y, previous = zero, 0.0
    for step_theta in np.linspace(0, theta, 1 + int(np.ceil(theta / np.radians(5.0))))[1:]:
        shift = pupil_z[:, None] * (np.tan(step_theta) - np.tan(previous))
        _, chief_y, _ = solve(step_theta, zero, chief_y - shift, zero, zero)
        previous = step_theta
    first_x = np.concatenate([zero, zero + stop_x / magnification[:, None]], axis=1)
    first_y = np.concatenate([chief_y, chief_y + stop_y / magnification[:, None]], axis=1)
    wanted_x = np.concatenate([[0.0], stop_x])
    wanted_y = np.concatenate([[0.0], stop_y])
    px, py, found = solve(theta, first_x, first_y, wanted_x, wanted_y)
    return px[:, 1:], py[:, 1:], found[:, 1:]
