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
from numpy.polynomial import chebyshev
from scipy.fft import fft2, next_fast_len
from scipy.spatial import ConvexHull

OVERSIZE = 1.04  # rays are traced to so many radii of each rim, so that the rim is interpolated
MARGIN = 1.02  # the grid is so much wider than the pupil
RAYS_ACROSS = 81
DEGREES = (14, 18)  # of the polynomials in p; above 18 the normal equations are singular in float64
GOOD_FIT_WAVES = 1e-4
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
    bundle = _through(system, index, point, back, steep > 0, -1)
    return replace(bundle, direction=-bundle.direction)


def _through(system, index, point, direction, ok, sense):
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


def _aim(system, index, image, guess, stop):
    """Return direction cosines of rays to points (2, R) of the stop, and which were found."""

    def arrive(cosines, rays):
        there = image[:, rays] if image.shape[1] > 1 else image
        lines = index[:, rays] if index.shape[1] > 1 else index
        return trace_back(system, lines, there, cosines)

    # A start that does not reach the stop goes half-way to the first of all, the chief ray.
    return _newton(system, arrive, guess, stop, 1e-5, guess[:, :1])


def _newton(system, send, guess, stop, step, retreat):
    """Return what sends rays to points (2, R) of the stop, and which were found."""
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
        found, ok = _aim(system, index, at * image[:, None], here + (at - last) * slope, middle)
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


@dataclass(frozen=True)
class Frame:
    """A plane across the light that one image point sees, in object space.

    Attributes
    ----------
    along, e1, e2 : ndarray (3,)
        Direction of the reference wavelength's chief ray, and unit vectors across it.
    origin : ndarray (3,)
        Where that ray meets the first surface, mm.
    focal_mm : float
    per_um : ndarray (2, 2)
        X (rows) per movement of the image point along x, y (columns), um per um.
    flat : bool
        Whether the scene lies on a plane, or else by angle.
    """

    along: np.ndarray
    e1: np.ndarray
    e2: np.ndarray
    origin: np.ndarray
    focal_mm: float
    per_um: np.ndarray
    flat: bool = True

    def ideal(self, x1: np.ndarray, x2: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the ideal plane's x, y (um) of X = f w (um), and the angle off the axis, rad.

        The height there is f tan(angle) where the scene is ``flat``, or else f times the angle.
        """
        w1, w2 = x1 / (1e3 * self.focal_mm), x2 / (1e3 * self.focal_mm)
        w3 = np.sqrt(np.maximum(1 - w1**2 - w2**2, 0.0))
        x, y, z = (
            w1 * a + w2 * b + w3 * c for a, b, c in zip(self.e1, self.e2, self.along, strict=True)
        )
        across = np.hypot(x, y)
        angle = np.arctan2(across, z)
        if self.flat:
            over = 1 / np.maximum(z, 1e-6)
        else:
            over = np.where(across > 0, angle / np.maximum(across, 1e-300), 1.0)
        scale = 1e3 * self.focal_mm * over
        return x * scale, y * scale, angle

    def of_ideal(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return X (um) of points of the ideal plane (um), and which lie on this side."""
        scale = 1e3 * self.focal_mm
        if self.flat:
            way = np.stack([x, y, np.full(np.shape(x), scale)])
            way = way / np.sqrt((way**2).sum(axis=0))
        else:
            angle = np.hypot(x, y) / scale
            across = np.sinc(angle / np.pi) / scale
            way = np.stack([x * across, y * across, np.cos(angle)])
        return scale * (self.e1 @ way), scale * (self.e2 @ way), self.along @ way > 0


def frame_of(system, index: np.ndarray, image: np.ndarray, focal_mm: float) -> Frame:
    """Return the frame of an image point (2,) in mm, by the reference wavelength (S + 1, 1)."""
    there = chief_back(system, index, image)
    chief = trace_back(system, index, image[:, None], there)
    along = chief.direction[:, 0]
    e1 = np.array([1.0, 0, 0]) - along[0] * along
    e1 /= np.sqrt(e1 @ e1)
    e2 = np.cross(along, e1)
    columns, step = [], 1e-3
    for one in np.eye(2) * step:
        ends = []
        for end in (image + one, image - one):
            aimed, _ = _aim(system, index, end[:, None], there, np.zeros((2, 1)))
            ends.append(trace_back(system, index, end[:, None], aimed))
        moved = (ends[0].direction - ends[1].direction)[:, 0] / (2 * step)
        columns.append(focal_mm * np.array([e1 @ moved, e2 @ moved]))
    return Frame(along, e1, e2, chief.point[:, 0], focal_mm, np.stack(columns, axis=1))


@dataclass(frozen=True)
class Rays:
    """The bundle of one image point and wavelength: rays to the stop, over all of it that is lit.

    Attributes
    ----------
    p : ndarray (2, R)
        Over the focal length, on the frame's plane.
    landing_um : ndarray (2, R)
        X = f w of each.
    path_mm : ndarray (R,)
    cosines : ndarray (2, R)
        At the image.
    margin : ndarray (S + 1, R)
        (height / clear semi-diameter)^2 - 1 of each surface and of the diaphragm.
    """

    p: np.ndarray
    landing_um: np.ndarray
    path_mm: np.ndarray
    cosines: np.ndarray
    margin: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Which pass."""
        return (self.margin < 0).all(axis=0)


def rays_of(system, index: np.ndarray, image: np.ndarray, chief: np.ndarray, frame: Frame) -> Rays:
    """Trace the bundle of an image point (2,), mm, at one wavelength (S + 1, 1).

    Parameters
    ----------
    system, index, image, frame
    chief : ndarray (2, 1)
        As `chief_back` returns it.

    Raises
    ------
    ValueError
        Where no light passes.
    """
    radius, rim = system.stop_radius_mm, OVERSIZE * system.stop_radius_mm
    limit = (-rim, rim, -rim, rim)
    for across in (25, RAYS_ACROSS):
        x, y = np.meshgrid(np.linspace(*limit[:2], across), np.linspace(*limit[2:], across))
        keep = np.hypot(x, y) <= rim
        stop = np.stack([x[keep], y[keep]])
        stop = np.concatenate([np.zeros((2, 1)), stop], axis=1)
        # A first guess: linear in the stop, by what the chief ray's neighbours do.
        step = 1e-4
        near = chief + step * np.array([[0, 1, 0], [0, 0, 1]])
        there = trace_back(system, index, image[:, None], near).own[system.geometry.stop]
        slopes = np.stack([there[:, 1] - there[:, 0], there[:, 2] - there[:, 0]], axis=1) / step
        guess = chief + np.linalg.solve(slopes, stop)
        cosines, found = _aim(system, index, image[:, None], guess, stop)
        bundle = trace_back(system, index, image[:, None], cosines)
        good = found & bundle.ok
        margin = (bundle.own**2).sum(axis=1) / system.semi_diameter_mm[:, None] ** 2 - 1
        diaphragm = (stop**2).sum(axis=0) / radius**2 - 1
        margin = np.concatenate([margin, diaphragm[None]])
        lit = good & (margin < 0).all(axis=0)
        if not lit.any():
            raise ValueError(f"no light arrives at {image} mm")
        spare = 2 * 2 * rim / (across - 1)
        limit = tuple(
            float(np.clip(end, -rim, rim))
            for axis in stop
            for end in (axis[lit].min() - spare, axis[lit].max() + spare)
        )
    keep = good & (margin <= OVERSIZE**2 - 1 + 1e-12).all(axis=0)
    start, way = bundle.point[:, keep], bundle.direction[:, keep]
    # Back to the plane through the frame's origin.
    left = frame.along @ (start - frame.origin[:, None]) / (frame.along @ way)
    on_plane = start - left * way - frame.origin[:, None]
    across = np.stack([frame.e1, frame.e2])
    return Rays(
        across @ on_plane / frame.focal_mm,
        1e3 * frame.focal_mm * (across @ way),
        bundle.path[keep] + left,
        cosines[:, keep],
        margin[:, keep],
    )


def field_rays(
    system, index: np.ndarray, image: np.ndarray, chief: np.ndarray, frame: Frame
) -> Rays:
    """Trace, along the light, the field whose chief ray lands on an image point (2,), mm.

    Its rays land elsewhere, by the aberrations; places and paths are left out.
    """
    middle = trace_back(system, index, image[:, None], chief)
    along = middle.direction
    e1 = frame.e1 - (frame.e1 @ along) * along[:, 0]
    e1 /= np.sqrt(e1 @ e1)
    sides = np.stack([e1, np.cross(along[:, 0], e1)])
    rim = OVERSIZE * system.stop_radius_mm
    x, y = np.meshgrid(*2 * [np.linspace(-rim, rim, RAYS_ACROSS)])
    keep = np.hypot(x, y) <= rim
    stop = np.stack([x[keep], y[keep]])

    def launched(p, _=None):
        # From well before the lens: where a ray starts along its own direction changes nothing.
        start = middle.point + sides.T @ p - 10 * rim * along
        sent = np.broadcast_to(along, start.shape)
        return _through(system, index, start, sent, np.ones(p.shape[1], bool), 1)

    nothing = np.zeros_like(stop)
    at, found = _newton(system, launched, nothing, stop, 1e-4 * rim, nothing[:, :1])
    here = launched(at)
    found &= here.ok
    margin = (here.own**2).sum(axis=1) / system.semi_diameter_mm[:, None] ** 2 - 1
    diaphragm = (stop**2).sum(axis=0) / system.stop_radius_mm**2 - 1
    margin = np.concatenate([margin, diaphragm[None]])
    keep = found & (margin <= OVERSIZE**2 - 1 + 1e-12).all(axis=0)
    nothing = np.zeros(int(keep.sum()))
    return Rays(
        at[:, keep] / frame.focal_mm,
        np.stack([nothing, nothing]),
        nothing,
        here.direction[:2, keep],
        margin[:, keep],
    )


@dataclass(frozen=True)
class Aperture:
    """What one image point's light fills of the frame's plane, on a uniform grid.

    Attributes
    ----------
    p1, p2 : ndarray (A,), (B,)
        Over the focal length.
    field : ndarray of complex (A, B)
        A exp(i k V).
    solid_angle_sr : float
        Solid angle of the light that arrives, in direction cosines at the image.
    residual_waves : float
        RMS misfit of the polynomial to the rays' paths.
    """

    p1: np.ndarray
    p2: np.ndarray
    field: np.ndarray
    solid_angle_sr: float
    residual_waves: float


def _design(u, v, degree):
    i, j = (part.ravel() for part in np.indices((degree + 1, degree + 1)))
    used = i + j <= degree
    return chebyshev.chebvander(u, degree)[:, i[used]] * chebyshev.chebvander(v, degree)[:, j[used]]


def aperture_of(
    rays: Rays, wavelength_nm: float, half_um: float, gaussian: float = 0.0
) -> Aperture:
    """Fit what the rays sample, on a grid so fine that its image repeats every 2 `half_um`."""
    low, high = rays.p.min(axis=1), rays.p.max(axis=1)
    middle, half = (low + high) / 2, MARGIN * (high - low) / 2
    spacing = wavelength_nm * 1e-3 / (2 * half_um)
    grids = []
    for centre, extent in zip(middle, half, strict=True):
        count = int(np.ceil(extent / spacing))
        grids.append(centre + spacing * (np.arange(2 * count) + 0.5 - count))
    active = [m for m in range(len(rays.margin)) if rays.margin[m].max() > 0]
    last = len(rays.margin) - 1
    if gaussian and last not in active:
        active.append(last)
    mean = rays.path_mm[rays.inside].mean()
    targets = np.column_stack([rays.path_mm - mean, *rays.cosines, *rays.margin[active]])
    u, v = (rays.p - middle[:, None]) / half[:, None]
    for degree in DEGREES:
        design = _design(u, v, degree)
        terms = np.linalg.lstsq(design, targets, rcond=None)[0]
        misfit = float(np.std((design @ terms[:, 0] - targets[:, 0])[rays.inside]))
        residual = misfit / (wavelength_nm * 1e-6)
        if residual < GOOD_FIT_WAVES:
            break
    i, j = (part.ravel() for part in np.indices((degree + 1, degree + 1)))
    used = i + j <= degree
    left, right = (
        chebyshev.chebvander((grid - centre) / extent, degree)
        for grid, centre, extent in zip(grids, middle, half, strict=True)
    )

    def on_grid(column):
        square = np.zeros((degree + 1, degree + 1))
        square[i[used], j[used]] = column
        return left @ square @ right.T

    path, alpha, beta, *margins = (on_grid(column) for column in terms.T)
    cover = _within_hull(rays.p, *grids).astype(float)
    for number, margin in zip(active, margins, strict=True):
        if rays.margin[number].max() > 0:
            cover = np.minimum(cover, _share_below(margin))
    (a1, a2), (b1, b2) = np.gradient(alpha), np.gradient(beta)
    density = np.abs(a1 * b2 - a2 * b1) / spacing**2  # d alpha d beta per cell of p / f
    passed = 1.0
    if gaussian:
        passed = np.exp(-gaussian * np.maximum(1 + margins[active.index(last)], 0))
    light = cover * density * passed**2
    wave = np.exp(2j * np.pi / (wavelength_nm * 1e-6) * path)
    return Aperture(
        *grids, np.sqrt(density) * passed * cover * wave, float(light.sum()) * spacing**2, residual
    )


def _within_hull(points, grid_1, grid_2):
    """Return which nodes lie within the convex hull of the rays."""
    within = np.ones((len(grid_1), len(grid_2)), bool)
    for a, b, offset in ConvexHull(points.T).equations:
        within &= (a * grid_1)[:, None] + (b * grid_2)[None] + offset <= 1e-12
    return within


def _share_below(margin):
    """Return the share of each cell where a smooth function is negative, by its tangent plane."""
    slope_1, slope_2 = np.gradient(margin)
    # 4 x 4 points of the tangent plane, each with a ramp of a quarter of a cell.
    at = (np.arange(4) - 1.5) / 4
    size = np.maximum(np.hypot(slope_1, slope_2), 1e-300)
    share = np.zeros_like(margin)
    near = np.abs(margin) < size
    m, s1, s2, size = margin[near], slope_1[near], slope_2[near], size[near]
    total = sum(np.clip(0.5 - 4 * (m + a * s1 + b * s2) / size, 0, 1) for a in at for b in at)
    share[near] = total / 16
    share[margin <= -np.maximum(np.hypot(slope_1, slope_2), 0)] = 1.0
    return share


def core_of(
    aperture: Aperture, wavelength_nm: float, at_1: np.ndarray, at_2: np.ndarray
) -> np.ndarray:
    """Return |F|^2 per unit of X = f w at places (um), as share of the light per um^2."""
    k = 2 * np.pi / (wavelength_nm * 1e-3)
    rows = np.exp(1j * k * np.outer(at_1, aperture.p1))
    columns = np.exp(1j * k * np.outer(aperture.p2, at_2))
    amplitude = rows @ aperture.field @ columns
    cell = (aperture.p1[1] - aperture.p1[0]) * (aperture.p2[1] - aperture.p2[0])
    # Parseval: the integral over X is lambda^2 times that of |A|^2, which is the solid angle.
    scale = cell**2 / ((wavelength_nm * 1e-3) ** 2 * aperture.solid_angle_sr)
    return scale * np.square(np.abs(amplitude))


def wide_of(aperture: Aperture, edges: np.ndarray) -> np.ndarray:
    """Return the share of the light in cells between `edges` (um, one period of the grid).

    The image of the sampled pupil repeats every lambda / spacing, which is the period.
    """
    # Twice as many samples as nodes: |F|^2 has twice the field's bandwidth.
    count = next_fast_len(2 * max(aperture.field.shape))
    image = np.square(np.abs(fft2(np.conj(aperture.field), (count, count))))
    # The transform has exp(-i k ...): of the conjugate it is the conjugate of what is wanted.
    image = np.fft.fftshift(image)
    period = edges[-1] - edges[0]
    pitch = period / count
    places = (np.arange(count) - count // 2) * pitch
    low, high = places[:, None] - pitch / 2, places[:, None] + pitch / 2
    inside = np.clip(np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1]), 0, None) / pitch
    # Half a sample sticks out on the left: it is the period's right end.
    inside[0, -1] += 1 - inside[0].sum()
    cell = (aperture.p1[1] - aperture.p1[0]) * (aperture.p2[1] - aperture.p2[0])
    total = aperture.solid_angle_sr / cell * count**2
    return inside.T @ image @ inside / total
