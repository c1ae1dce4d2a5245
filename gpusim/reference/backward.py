"""What one point of the image sees through a lens: rays traced backwards from it, in float64.

Light that arrives at a point x of the image, by the direction w in object space that it comes from:

    E(x) = integral L(w) |F(w)|^2 / lambda^2 d^2 w,
    F(w) = integral A(p) exp(i k (V(p) + w . p)) d^2 p

with p on a plane across the light in object space, V the optical path from p to x (a point
characteristic; Born & Wolf, sec. 4.1) and A^2 d^2 p = d alpha d beta, direction cosines at x: by
the radiance theorem every direction that arrives carries the scene's radiance. Where the path is
stationary, w is the direction of the ray through p. So the scene's place, distortion and lateral
colour come with the rays: no chief-ray map, and no PSF that belongs to one source point and is
taken for its neighbours'. An even scene gives L times the solid angle at x, whatever the
aberrations.

The tracer is this module's own. It shares surfaces, indices and apertures with `gpusim.lens`, and
no code that follows a ray.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

AIMED = 1e-9  # of the stop's radius
STEP, LEAST_STEP = 1 / 8, 1 / 512  # from the axis to the image point, of the way
NEWTON = 25
CLOSE_MM = 1e-12  # 2e-9 waves; Newton's next step would be its square


@dataclass(frozen=True)
class Bundle:
    """Rays from an image point back into object space.

    Attributes
    ----------
    own : ndarray (S, 2, R)
        Where they meet the surfaces, in each surface's own frame, mm.
    point, direction : ndarray (3, R)
        On the first surface, and of the light (not of the tracing) before it.
    path : ndarray (R,)
        Optical path from there to the image, mm.
    ok : ndarray of bool (R,)
    """

    own: np.ndarray
    point: np.ndarray
    direction: np.ndarray
    path: np.ndarray
    ok: np.ndarray


def trace_back(system, index: np.ndarray, image: np.ndarray, cosines: np.ndarray) -> Bundle:
    """Trace rays that arrive at an image point back through the lens.

    Parameters
    ----------
    system : gpusim.lens.system.System
    index : ndarray (S + 1, 1 or R)
        Before the lens and behind each surface.
    image : ndarray (2, 1 or R)
        x, y in the image plane, mm.
    cosines : ndarray (2, R)
        Direction cosines of the light where it arrives.
    """
    rays = cosines.shape[1]
    plane = np.full((1, rays), system.image_z_mm)
    point = np.concatenate([np.broadcast_to(image, (2, rays)), plane])
    steep = 1 - (cosines**2).sum(axis=0)
    back = -np.concatenate([cosines, np.sqrt(np.maximum(steep, 1e-12))[None]])
    bundle = through(system, index, point, back, steep > 0, sense=-1)
    return replace(bundle, direction=-bundle.direction)


def through(system, index, point, direction, ok, *, sense):
    """Trace rays through the whole lens, along the light (sense 1) or against it (-1)."""
    geometry = system.geometry
    count = len(geometry.curvature)
    path, own = np.zeros(ok.shape), np.zeros((count, 2, *ok.shape))
    with np.errstate(all="ignore"):
        for s in range(count)[::sense]:
            turn = geometry.rotation[s]
            vertex = np.array([*geometry.decentre[s], geometry.vertex_z[s]])[:, None]
            start, towards = turn.T @ (point - vertex), turn.T @ direction
            shape = geometry.curvature[s], geometry.conic[s], geometry.asphere[s]
            t, normal, met = _surface(start, towards, *shape)
            n_in, n_out = (index[s], index[s + 1])[::sense]
            ahead = sense * normal
            cos_in = (towards * ahead).sum(axis=0)
            sine2 = (n_in / n_out) ** 2 * (1 - cos_in**2)
            ok = ok & met & (cos_in > 0) & (sine2 < 1)
            cos_out = np.sqrt(np.maximum(1 - sine2, 0))
            bent = n_in / n_out * towards + (cos_out - n_in / n_out * cos_in) * ahead
            hit = start + t * towards
            own[s] = np.where(ok, hit[:2], 0.0)
            path = np.where(ok, path + n_in * t, path)
            point = np.where(ok, turn @ hit + vertex, point)
            direction = np.where(ok, turn @ bent, direction)
    return Bundle(own, point, direction, path, ok)


def _surface(start, towards, c, conic, asphere):
    """Return the way to a surface of revolution, its unit normal (z > 0) and which rays meet it."""
    dx, dy, dz = towards
    # From the vertex's plane: there the root that stays finite as the surface flattens is that of
    # the sheet which carries the vertex.
    flat = -start[2] / dz
    x, y = start[0] + flat * dx, start[1] + flat * dy
    # F = c (x^2 + y^2 + (1 + K) z^2) - 2 z = 0 along the ray: a t^2 + 2 b t + g = 0.
    kc = (1 + conic) * c
    a = c * (dx**2 + dy**2) + kc * dz**2
    b = c * (x * dx + y * dy) - dz
    g = c * (x**2 + y**2)
    root = b * b - a * g
    ok = root >= 0
    t = -g / (b + np.copysign(np.sqrt(np.maximum(root, 0)), -dz))
    if not asphere.any():
        px, py, pz = x + t * dx, y + t * dy, t * dz
        normal = np.stack([-c * px, -c * py, 1 - kc * pz])
        return flat + t, normal / np.sqrt((normal**2).sum(axis=0)), ok & (normal[2] > 0)
    asphere = np.trim_zeros(asphere, "b")
    powers = np.arange(1, len(asphere) + 1)
    sag_terms = np.concatenate([[0.0], asphere])
    slope_terms = powers * asphere

    def sag(r2):
        under = 1 - kc * c * r2
        square = np.sqrt(np.maximum(under, 1e-12))
        value = c * r2 / (1 + square) + np.polynomial.polynomial.polyval(r2, sag_terms)
        slope = c / (2 * square) + np.polynomial.polynomial.polyval(r2, slope_terms)
        return value, slope, under > 0

    # From the conic or the plane, whichever is nearer to the surface there.
    misses = [
        np.abs(one * dz - sag((x + one * dx) ** 2 + (y + one * dy) ** 2)[0]) for one in (t, 0 * t)
    ]
    t = np.where(ok & (misses[0] < misses[1]), t, 0.0)
    ok = np.isfinite(t)
    for _ in range(NEWTON):
        px, py = x + t * dx, y + t * dy
        value, slope, _ = sag(px**2 + py**2)
        step = (t * dz - value) / (dz - 2 * slope * (px * dx + py * dy))
        t = t - step
        if np.max(np.abs(step), initial=0.0, where=ok) < CLOSE_MM:
            break
    px, py = x + t * dx, y + t * dy
    value, slope, inside = sag(px**2 + py**2)
    ok = inside & (np.abs(t * dz - value) < 1e-9)
    normal = np.stack([-2 * slope * px, -2 * slope * py, np.ones_like(t)])
    return flat + t, normal / np.sqrt((normal**2).sum(axis=0)), ok


def aim(system, index, image, guess, stop):
    """Return direction cosines of rays to points (2, R) of the stop, and which were found."""

    def arrive(cosines, rays):
        there = image[:, rays] if image.shape[1] > 1 else image
        lines = index[:, rays] if index.shape[1] > 1 else index
        return trace_back(system, lines, there, cosines)

    # A start that does not reach the stop goes half-way to the first of all, the chief ray.
    return newton(system, arrive, guess, stop, step=1e-5, retreat=guess[:, :1])


def newton(system, send, guess, stop, *, step, retreat):
    """Return what sends rays to points (2, R) of the stop, and which were found.

    Jacobians come from rays a ``step`` aside; a ray that is lost goes half-way to ``retreat``.
    """
    at, found = guess.copy(), np.zeros(guess.shape[1], bool)
    stop = np.broadcast_to(stop, at.shape)
    for _ in range(NEWTON):
        rays = ~found
        here, one, two = (
            send(at[:, rays] + np.array([[a], [b]]), rays)
            for a, b in ((0, 0), (step, 0), (0, step))
        )
        place, first, second = (bundle.own[system.geometry.stop] for bundle in (here, one, two))
        miss = stop[:, rays] - place
        hit = here.ok & (np.hypot(*miss) < AIMED * system.stop_radius_mm)
        j1, j2 = (first - place) / step, (second - place) / step
        det = j1[0] * j2[1] - j1[1] * j2[0]
        usable = here.ok & one.ok & two.ok & (np.abs(det) > 0)
        det = np.where(usable, det, 1.0)
        move = (
            np.stack([miss[0] * j2[1] - miss[1] * j2[0], j1[0] * miss[1] - j1[1] * miss[0]]) / det
        )
        now = at[:, rays]
        at[:, rays] = np.where(hit, now, np.where(usable, now + move, (now + retreat) / 2))
        found[rays] = hit
        if found.all():
            break
    return at, found


def chief_back(system, index: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return the direction cosines (2, L) of the chief rays that arrive at an image point (2,).

    The point is walked out from the axis.

    Raises
    ------
    ValueError
        Where no such ray passes the lens.
    """
    middle = np.zeros((2, 1))
    way = [(0.0, np.zeros((2, index.shape[1])))]
    step, at = STEP, 0.0
    while True:
        # Straight on from the last two; where that loses a ray, half as far.
        (before, first), (last, here) = (way[-2:] * 2)[-2:]
        slope = (here - first) / (last - before) if last > before else 0.0
        found, ok = aim(system, index, at * image[:, None], here + (at - last) * slope, middle)
        if ok.all():
            way.append((at, found))
            if at == 1.0:
                return found
            step = min(2 * step, STEP)
        elif step < LEAST_STEP or at == 0.0:
            raise ValueError(f"no chief ray arrives at {image} mm")
        else:
            step /= 2
        at = min(way[-1][0] + step, 1.0)
