"""Sequential trace of real rays through surfaces of revolution, in float64.

Coordinates: z along the axis in the direction of light, the first vertex at z = 0; the field lies
in the y-z plane, so that a field angle theta > 0 sends the chief ray to y > 0 in the image. All
lengths in mm. Ray arrays have the shape (L, R): wavelengths, rays. A ray that misses a surface or
is totally reflected gets ``ok = False`` and keeps finite, meaningless numbers: never NaN.

The rays of a field start on a plane perpendicular to it (``Launch``), never on the plane of the
first vertex: of objects at infinity tan(theta) appears nowhere, and fields of 90 deg and more are
like any other. Those of a point of an object plane start there along the way from that point.

A surface that is decentred or tilted is met in its own frame; the others cost nothing more.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from gpusim.lens.throughput import Crossings


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
    decentre : ndarray, shape (S, 2)
        x and y of each vertex, mm.
    rotation : ndarray, shape (S, 3, 3)
        From the frame of each surface to that of the lens.
    object_z : float
        Place of the object plane, mm before the first vertex as a number < 0; -inf: at infinity.
    field_z : float
        Point of the axis, the paraxial entrance pupil's, at which the angle of a point of the
        object plane is its field. It means nothing where the object is at infinity.
    """

    curvature: np.ndarray
    conic: np.ndarray
    asphere: np.ndarray
    vertex_z: np.ndarray
    stop: int
    decentre: np.ndarray
    rotation: np.ndarray
    object_z: float = -np.inf
    field_z: float = 0.0

    @functools.cached_property
    def moved(self) -> np.ndarray:
        """Which surfaces are decentred or tilted, shape (S,)."""
        return self.decentre.any(axis=1) | (self.rotation != np.eye(3)).any(axis=(1, 2))

    def centred(self) -> Geometry:
        """Return the same surfaces, all on the axis."""
        identity = np.broadcast_to(np.eye(3), self.rotation.shape)
        return replace(self, decentre=np.zeros_like(self.decentre), rotation=identity)

    def source(self, theta: float, azimuth: float = 0.0) -> np.ndarray | None:
        """Return the point of the object plane, shape (3,), of a field; None at infinity."""
        if np.isinf(self.object_z):
            return None
        height = (self.object_z - self.field_z) * np.tan(theta)
        return np.array([height * np.sin(azimuth), height * np.cos(azimuth), self.object_z])


@dataclass(frozen=True)
class Launch:
    """The plane from which the rays of one field start, across its chief rays.

    A ray starts at E + px e1 + py e2. From infinity it goes along d = (0, sin theta, cos theta),
    with e1 = (1, 0, 0) and e2 = (0, cos theta, -sin theta); an azimuth turns all three about the
    axis, from y towards x. From a point of the object plane it goes along the way from that point,
    and d is the way to E. Paths are those from the wavefront through E: a plane, or a sphere.

    Attributes
    ----------
    theta : float
        Field angle, rad; any from -pi to pi.
    base : ndarray, shape (3, L)
        E of each wavelength, mm. ``launch_field`` puts it where the chief ray meets the first
        surface, so that (px, py) = 0 is the chief ray.
    azimuth : float
        Azimuth of the field, rad: 0 in the y-z plane, which is all that a centred lens needs.
    source : ndarray, shape (3,), or None
        Point of the object, mm; None where it is at infinity.
    """

    theta: float
    base: np.ndarray
    azimuth: float = 0.0
    source: np.ndarray | None = None

    @property
    def direction(self) -> np.ndarray:
        """Direction cosines d of the chief rays, shape (3, L)."""
        if self.source is None:
            field = self._turned(0.0, np.sin(self.theta), np.cos(self.theta))
            return np.broadcast_to(field[:, None], self.base.shape)
        way = self.base - self.source[:, None]
        return way / np.sqrt((way * way).sum(0))

    @property
    def e1(self) -> np.ndarray:
        """Unit vector of px, shape (3, L)."""
        across = self._turned(1.0, 0.0, 0.0)[:, None]
        if self.source is None:
            return np.broadcast_to(across, self.base.shape)
        d = self.direction
        across = across - (across * d).sum(0) * d
        return across / np.sqrt((across * across).sum(0))

    @property
    def e2(self) -> np.ndarray:
        """Unit vector of py, shape (3, L)."""
        if self.source is None:
            field = self._turned(0.0, np.cos(self.theta), -np.sin(self.theta))
            return np.broadcast_to(field[:, None], self.base.shape)
        return np.cross(self.direction, self.e1, axis=0)

    def _turned(self, x: float, y: float, z: float) -> np.ndarray:
        c, s = np.cos(self.azimuth), np.sin(self.azimuth)
        return np.array([c * x + s * y, c * y - s * x, z])

    def points(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """Return where rays start, shape (3, L, R), for px and py of shape (L, R)."""
        e1, e2 = self.e1[:, :, None], self.e2[:, :, None]
        return self.base[:, :, None] + px * e1 + py * e2

    def rays(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rays' starts and directions, (3, L, R), and their paths to there, (L, R)."""
        point = self.points(px, py)
        if self.source is None:
            direction = np.broadcast_to(self.direction[:, :, None], point.shape)
            return point, direction, np.zeros(px.shape)
        way, chief = (one - self.source[:, None, None] for one in (point, self.base[:, :, None]))
        far, chief_far = (np.sqrt((one * one).sum(0)) for one in (way, chief))
        # The difference of the two, of which nothing cancels: the plane is across the chief ray.
        return point, way / far, (px * px + py * py) / (far + chief_far)


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


# The walk from the axis to a field takes steps of at most 5 deg and at least 5 / 2^5 deg.
WALK_STEP = np.radians(5.0)
WALK_HALVINGS = 5
# A miss of 1e-9 of the stop radius moves the chief ray by about 1e-9 f: 1e-5 um at f = 8 mm.
AIM_TOLERANCE = 1e-9
AIM_ITERATIONS = 15  # Newton: 3 to 5 on real lenses


def launch_field(
    geometry: Geometry,
    index: np.ndarray,
    theta: float,
    tolerance_mm: float,
    azimuth: float = 0.0,
    *,
    start: Launch | None = None,
) -> tuple[Launch, np.ndarray]:
    """Find the real chief rays of a field and the launch plane on them.

    The chief ray is walked out from the axis: each step turns the last one about the point where
    it met the one before, which is the real entrance pupil, and Newton does the rest. A step that
    loses the ray is halved.

    Parameters
    ----------
    geometry, index
        As for ``trace``.
    theta : float
        Field angle, rad.
    tolerance_mm : float
        Accepted miss at the centre of the stop.
    azimuth : float
        Azimuth of the field, rad.
    start : Launch, optional
        A field's of the same azimuth, from which the walk begins in place of the axis.

    Returns
    -------
    launch : Launch
        Its base is where the chief ray of each wavelength meets the first surface.
    found : ndarray of bool, shape (L,)
        False where no chief ray was found; the base means nothing then.
    """
    zero = np.zeros((index.shape[1], 1))

    def chief(guess: Launch) -> tuple[Launch, np.ndarray]:
        px, py, found = _newton(geometry, index, guess, zero, zero, 0.0, 0.0, tolerance_mm)
        return replace(guess, base=guess.points(px, py)[:, :, 0]), found[:, 0]

    def field(angle: float) -> Launch:
        return Launch(angle, pivot, azimuth, geometry.source(angle, azimuth))

    pivot = np.zeros((3, index.shape[1]))
    pivot[2] = entrance_pupil(geometry, index)[0]
    if start is None:
        launch, found = chief(field(0.0))
    else:
        launch, found, pivot = start, np.ones(index.shape[1], bool), start.base
    step = WALK_STEP
    while found.all() and launch.theta != theta:
        left = theta - launch.theta
        angle = theta if abs(left) <= step else launch.theta + np.copysign(step, left)
        trial, reached = chief(field(angle))
        if reached.all():
            # Where the new chief ray crosses the old one, seen along the old field.
            e2, along = launch.e2, trial.direction
            apart = (e2 * (trial.base - launch.base)).sum(0) / (e2 * along).sum(0)
            pivot = trial.base - apart * along
            launch, step = trial, min(2 * step, WALK_STEP)
        elif step > WALK_STEP / 2**WALK_HALVINGS:
            step /= 2
        else:
            found = reached
    launch = replace(launch, theta=theta, source=geometry.source(theta, azimuth))
    rays = trace(geometry, index, launch, zero, zero, through=1)
    return replace(launch, base=rays.point[:, :, 0]), found & rays.ok[:, 0]


def aim(
    geometry: Geometry,
    index: np.ndarray,
    launch: Launch,
    stop_x: np.ndarray,
    stop_y: np.ndarray,
    tolerance_mm: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the rays that meet the stop surface at given points, by Newton on real rays.

    Parameters
    ----------
    geometry, index
        As for ``trace``.
    launch : Launch
        From ``launch_field``: the search starts at the chief ray.
    stop_x, stop_y : ndarray, shape (R,)
        Wanted intersections with the stop surface, from its own vertex, mm.
    tolerance_mm : float
        Accepted miss at the stop.

    Returns
    -------
    px, py : ndarray, shape (L, R)
        Where they cross the launch plane.
    ok : ndarray of bool, shape (L, R)
        False where no such ray was found.
    """
    zero = np.zeros((index.shape[1], 1))
    chief_x, chief_y, slopes, _ = _at_stop(geometry, index, launch, zero, zero, tolerance_mm)
    px, py, _ = _correction(slopes, stop_x - chief_x, stop_y - chief_y)
    return _newton(geometry, index, launch, px, py, stop_x, stop_y, tolerance_mm)


def _at_stop(geometry, index, launch, px, py, tolerance_mm):
    """Return where rays meet the stop, the derivatives of that, and which could be traced.

    The derivatives dx/dpx, dx/dpy, dy/dpx, dy/dpy are forward differences: their step only sets
    the rate of convergence; the miss is that of the real ray.
    """
    step = 1e5 * tolerance_mm  # 1e-4 of the stop's radius
    rays = trace(
        geometry,
        index,
        launch,
        np.concatenate([px, px + step, px], axis=1),
        np.concatenate([py, py, py + step], axis=1),
        through=geometry.stop + 1,
    )
    x0, x1, x2 = np.split(rays.own_x[-1], 3, axis=1)
    y0, y1, y2 = np.split(rays.own_y[-1], 3, axis=1)
    slopes = ((x1 - x0) / step, (x2 - x0) / step, (y1 - y0) / step, (y2 - y0) / step)
    return x0, y0, slopes, np.split(rays.ok, 3, axis=1)


def _correction(slopes, need_x, need_y):
    """Return the change of (px, py) that moves rays by the need at the stop, and where it exists.

    It is 0 where the derivatives are singular.
    """
    a, b, c, d = slopes
    det = a * d - b * c
    usable = np.abs(det) > 1e-9
    det = np.where(usable, det, np.inf)
    return (d * need_x - b * need_y) / det, (a * need_y - c * need_x) / det, usable


def _newton(geometry, index, launch, px, py, wanted_x, wanted_y, tolerance_mm):
    """Return px, py and success of the rays to wanted points of the stop, from a first guess."""
    px, py = px.copy(), py.copy()
    wanted_x, wanted_y = (np.broadcast_to(w, px.shape) for w in (wanted_x, wanted_y))
    found = np.zeros(px.shape, dtype=bool)
    for _ in range(AIM_ITERATIONS):
        open_ = ~found.all(axis=0)
        x, y, slopes, traced = _at_stop(
            geometry, index, launch, px[:, open_], py[:, open_], tolerance_mm
        )
        need_x, need_y = wanted_x[:, open_] - x, wanted_y[:, open_] - y
        hit = traced[0] & (np.hypot(need_x, need_y) < tolerance_mm)
        found[:, open_] = hit
        if found.all():
            break
        step_x, step_y, usable = _correction(slopes, need_x, need_y)
        usable &= traced[0] & traced[1] & traced[2]
        for p, step in ((px, step_x), (py, step_y)):
            old = p[:, open_]
            # A start that does not reach the stop is drawn half-way to the chief ray.
            p[:, open_] = np.where(hit, old, np.where(usable, old + step, old / 2))
    return px, py, found
