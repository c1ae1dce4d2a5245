"""Real rays of a field: aimed at points of the stop, traced to the image plane.

Each has its direction cosines there and its W: see `gpusim.lens.wavefront`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.aim import AIM_TOLERANCE, aim, launch_field
from gpusim.lens.entering import Entering
from gpusim.lens.launch import Launch
from gpusim.lens.model import LensModel
from gpusim.lens.throughput import Crossings, along_axis, goes_with_the_ray, throughput
from gpusim.lens.trace import trace

if TYPE_CHECKING:
    from gpusim.lens.system import System

# Rays are traced to 1.04 times every rim. With RAYS_ACROSS their spacing is 0.026 of the stop's
# radius, so that their convex hull reaches 1.04 - 0.026 sqrt(2) = 1.003: the rim is interpolated.
# Beyond its rim a strong asphere runs wild: at 1.12, W of a phone lens reaches 800 waves and no
# polynomial follows it (residual 1e-2 waves); at 1.04 the residual is 1e-4 waves.
RAY_OVERSIZE = 1.04
# Rays across the stop: 81 x 41 on the half pupil, 26 rays per coefficient of degree 18.
RAYS_ACROSS = 81
COARSE_ACROSS = 21  # rays that tell which part of the stop a field uses
# Rings and their spokes: four rays a coefficient of degree 18. The outermost ring is so far beyond
# the rim that pupils of other wavelengths are within it, and two nodes of a grid across the rim.
RINGS, SPOKES, RINGS_OVERSIZE = 16, 48, 1.06
# Where the rim lies is first told by polynomials through coarse rays that pass within so much of
# it: to a percent.
ROUGH_DEGREE, ROUGHLY_WITHIN = 4, 1.3
PAD = ((0, 0), (1, 0))  # the chief ray goes before the others


@dataclass(frozen=True)
class Losses:
    """What is lost of each ray on its way through a lens, by wavelength.

    Attributes
    ----------
    prescription : LensModel
    index : ndarray, shape (S + 1, L)
    crossings : Crossings
    """

    prescription: LensModel
    index: np.ndarray
    crossings: Crossings

    def exponent(self, line: int, wavelength_nm: float) -> np.ndarray:
        """Return -ln of the amplitude of the rays of one wavelength over that of the axis, (R,)."""
        at, index = np.array([wavelength_nm]), self.index[:, [line]]
        rays = Crossings(*(one[:, [line]] for one in self.crossings))
        passed = throughput(self.prescription, index, at, rays)[0]
        return -0.5 * np.log(passed / along_axis(self.prescription, index, at))


@dataclass(frozen=True)
class Samples:
    """Real rays of one field: half of the pupil (alpha >= 0) where it is symmetric.

    Attributes
    ----------
    chief_x_mm, chief_y_mm : ndarray, shape (L,)
        Where the chief ray lands in the image plane.
    chief_direction : ndarray, shape (L, 2)
        Its direction cosines there.
    alpha, beta, opd_mm : ndarray, shape (L, R)
        Direction cosines and W.
    landing_x_mm, landing_y_mm : ndarray, shape (L, R)
        Where each ray lands, from the chief ray's point.
    margin : ndarray, shape (S + 1, L, R)
        (height / clear semi-diameter)^2 - 1 at each surface, and at the diaphragm: negative inside.
    ok : ndarray of bool, shape (L, R)
    half : bool
        Whether the rays stand for their mirror images too: of a centred lens, azimuth 0.
    apodisation : float
        G: the diaphragm passes the amplitude exp(-G (height / semi-diameter)^2).
    losses : Losses, or None
        Where losses go with the ray.
    entering : Entering
    """

    chief_x_mm: np.ndarray
    chief_y_mm: np.ndarray
    chief_direction: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    opd_mm: np.ndarray
    landing_x_mm: np.ndarray
    landing_y_mm: np.ndarray
    margin: np.ndarray
    ok: np.ndarray
    entering: Entering
    half: bool = True
    apodisation: float = 0.0
    losses: Losses | None = None

    @property
    def inside(self) -> np.ndarray:
        """Rays that pass every aperture, shape (L, R)."""
        return self.ok & (self.margin < 0).all(axis=0)


def sample_rays(
    system: System,
    index: np.ndarray,
    theta: float,
    stop_x: np.ndarray,
    stop_y: np.ndarray,
    *,
    azimuth: float = 0.0,
    whole: bool = False,
) -> Samples:
    """Aim real rays at points of the stop and trace them to the image plane.

    Parameters
    ----------
    system : System
    index : ndarray, shape (S + 1, L)
    theta : float
        Field angle, rad.
    stop_x, stop_y : ndarray, shape (R,)
        Points of the stop surface, mm.
    azimuth : float
        Azimuth of the field, from y towards x, rad.
    whole : bool
        Keep each ray on its own side of the meridional plane, also where that is one of symmetry.

    Raises
    ------
    UserError
        Where the chief ray does not reach the image.
    """
    launch = field_launch(system, index, theta, azimuth)
    return _sample(system, index, launch, stop_x, stop_y, whole=whole)


def field_launch(
    system: System,
    index: np.ndarray,
    theta: float,
    azimuth: float = 0.0,
    start: Launch | None = None,
) -> Launch:
    """Return the launch plane of a field, on its chief rays.

    Parameters
    ----------
    system, index, theta, azimuth
        As for ``sample_rays``.
    start : Launch, optional
        That of a field nearby, from which chief rays are sought; by default from the axis.

    Raises
    ------
    UserError
        Where the chief ray does not reach the stop.
    """
    if np.isfinite(system.geometry.object_z) and abs(theta) >= np.pi / 2:
        raise no_chief_ray(system, theta)
    tolerance = AIM_TOLERANCE * system.stop_radius_mm
    launch, found = launch_field(system.geometry, index, theta, tolerance, azimuth, start=start)
    if not found.all():
        raise no_chief_ray(system, theta)
    return launch


def no_chief_ray(system: System, theta: float) -> UserError:
    """Return the error of a field whose chief ray does not pass the lens."""
    return UserError(
        f"the chief ray does not pass the lens at {np.degrees(theta):.4g} deg",
        file=system.prescription.file,
        field="max_field_deg",
        value=f"{np.degrees(theta):.4g}",
        allowed="a smaller field",
    )


def _sample(
    system: System,
    index: np.ndarray,
    launch: Launch,
    stop_x: np.ndarray,
    stop_y: np.ndarray,
    *,
    whole: bool = False,
) -> Samples:
    """Do what ``sample_rays`` promises, for a field whose launch plane is known."""
    tolerance = AIM_TOLERANCE * system.stop_radius_mm
    px, py, found = aim(system.geometry, index, launch, stop_x, stop_y, tolerance_mm=tolerance)
    # As aimed: a ray that failed before the stop has a place there too.
    aimed2 = np.broadcast_to(np.append(0.0, stop_x**2 + stop_y**2), np.pad(found, PAD).shape)
    return _arrived(system, index, launch, (px, py), found, stop2=aimed2, whole=whole)


def _arrived(
    system: System,
    index: np.ndarray,
    launch: Launch,
    p_mm: tuple[np.ndarray, np.ndarray],
    found: np.ndarray,
    *,
    stop2: np.ndarray | None = None,
    whole: bool,
) -> Samples:
    """Trace rays (L, R) from the launch plane, the chief rays with them.

    ``stop2``, shape (L, R + 1): their (height at the stop)^2, mm^2; by default as traced.
    """
    geometry, (px, py) = system.geometry, p_mm
    # The chief ray goes first.
    lossy = goes_with_the_ray(system.prescription)
    rays = trace(geometry, index, launch, np.pad(px, PAD), np.pad(py, PAD), crossings=lossy)
    ok = np.pad(found, PAD, constant_values=True) & rays.ok & (rays.direction[2] > 0)
    if not ok[:, 0].all():
        raise no_chief_ray(system, launch.theta)
    alpha, beta, gamma = rays.direction
    to_image = (system.image_z_mm - rays.point[2]) / np.where(ok, gamma, 1.0)
    land_x = rays.point[0] + to_image * alpha
    land_y = rays.point[1] + to_image * beta
    chief_x, chief_y = land_x[:, :1].copy(), land_y[:, :1].copy()
    land_x, land_y = land_x - chief_x, land_y - chief_y
    half = _is_symmetric(system, launch) and not whole
    if half:
        # By symmetry each ray has a mirror image: keep the one with alpha >= 0.
        side = np.where(alpha < 0, -1.0, 1.0)
        alpha, land_x = side * alpha, side * land_x
    path = rays.path + to_image - alpha * land_x - beta * land_y
    height2 = rays.own_x**2 + rays.own_y**2
    margin = height2 / system.semi_diameter_mm[:, None, None] ** 2 - 1
    diaphragm = (height2[geometry.stop] if stop2 is None else stop2) / system.stop_radius_mm**2 - 1
    return Samples(
        chief_x_mm=chief_x[:, 0],
        chief_y_mm=chief_y[:, 0],
        chief_direction=np.stack([alpha[:, 0], beta[:, 0]], axis=-1),
        alpha=alpha[:, 1:],
        beta=beta[:, 1:],
        opd_mm=(path - path[:, :1])[:, 1:],
        landing_x_mm=land_x[:, 1:],
        landing_y_mm=land_y[:, 1:],
        margin=np.concatenate([margin, diaphragm[None]])[:, :, 1:],
        ok=ok[:, 1:],
        entering=Entering(geometry, system.stop_radius_mm, index, launch, px, py),
        half=half,
        apodisation=system.prescription.gaussian_apodisation,
        losses=Losses(
            system.prescription, index, Crossings(*(one[:, :, 1:] for one in rays.crossings))
        )
        if lossy
        else None,
    )


def _is_symmetric(system: System, launch: Launch) -> bool:
    """Whether everything is symmetric about the y-z plane, by the axis of the lens."""
    return launch.azimuth == 0 and not system.geometry.moved.any()


def sample_field(system: System, index: np.ndarray, theta: float, azimuth: float = 0.0) -> Samples:
    """Trace rays spread evenly over the part of the stop that the field uses.

    Parameters
    ----------
    system, index, theta, azimuth
        As for ``sample_rays``.

    Raises
    ------
    UserError
        Where no ray of some wavelength passes the lens at this field.
    """
    radius = system.stop_radius_mm
    launch = field_launch(system, index, theta, azimuth)
    half = _is_symmetric(system, launch)

    def grid(x_low, x_high, y_low, y_high, across):
        x, y = np.meshgrid(
            np.linspace(x_low, x_high, across // 2 + 1 if half else across),
            np.linspace(y_low, y_high, across),
        )
        keep = x**2 + y**2 <= (RAY_OVERSIZE * radius) ** 2
        return x[keep], y[keep]

    rim = RAY_OVERSIZE * radius
    coarse = COARSE_ACROSS
    x, y = grid(0.0 if half else -rim, rim, -rim, rim, coarse)
    lit = _sample(system, index, launch, x, y).inside
    if not lit.any(axis=1).all():
        raise no_light(system, theta)
    inside = lit.any(axis=0)
    # The rim lies within one coarse spacing of the last ray inside; one more reaches beyond it.
    spare = 2 * (2 * rim / (coarse - 1))
    x_low, x_high = max(-rim, x[inside].min() - spare), min(rim, x[inside].max() + spare)
    y_low, y_high = max(-rim, y[inside].min() - spare), min(rim, y[inside].max() + spare)
    box = (0.0 if half else x_low, x_high, y_low, y_high)
    return _sample(system, index, launch, *grid(*box, RAYS_ACROSS))


def no_light(system: System, theta: float) -> UserError:
    """Return the error of a field, rad, at which nothing passes the lens."""
    return UserError(
        f"no light passes the lens at {np.degrees(theta):.4g} deg",
        file=system.prescription.file,
        field="max_field_deg",
        value=f"{np.degrees(theta):.4g}",
        allowed="a smaller field",
    )


def sample_rings(
    system: System, index: np.ndarray, theta: float, azimuth: float, line: int
) -> Samples:
    """Trace rays on rings about the middle of the light, the last one beyond its rim.

    They are fewer than those of `sample_field`, and are aimed at one wavelength alone. At the
    others rays go where those cross the launch plane, from their own chief ray: to nearly the same
    points of the stop, and what a ray tells is told by where it goes.

    Parameters
    ----------
    system, index, theta, azimuth
        As for ``sample_rays``.
    line : int
        The wavelength that rays are aimed at.

    Raises
    ------
    UserError
        Where no ray of some wavelength passes the lens at this field.
    """
    radius = system.stop_radius_mm
    launch = field_launch(system, index, theta, azimuth)
    alone = replace(launch, base=launch.base[:, [line]])

    def sample(x: np.ndarray, y: np.ndarray) -> Samples:
        tolerance = AIM_TOLERANCE * radius
        aimed = aim(system.geometry, index[:, [line]], alone, x, y, tolerance_mm=tolerance)
        px, py, found = (np.repeat(one, index.shape[1], axis=0) for one in aimed)
        return _arrived(system, index, launch, (px, py), found, whole=True)

    side = np.linspace(-RAY_OVERSIZE, RAY_OVERSIZE, COARSE_ACROSS)
    x, y = (one.ravel() for one in np.meshgrid(side, side))
    keep = np.hypot(x, y) <= RAY_OVERSIZE
    x, y = x[keep], y[keep]
    coarse = sample(radius * x, radius * y)
    lit = coarse.inside
    if not lit.any(axis=1).all():
        raise no_light(system, theta)
    inside = lit.any(axis=0)
    middle = np.array([x[inside].mean(), y[inside].mean()])
    turn = 2 * np.pi * np.arange(2 * SPOKES) / (2 * SPOKES)
    way = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    rim = _rim_along(coarse, line, np.stack([x, y]), middle, way)
    # As dense towards the rim as Chebyshev's points; every other ring is turned by half a step.
    rings = np.arange(RINGS)
    share = RINGS_OVERSIZE * np.sin(np.pi / 2 * (rings + 0.5) / (RINGS - 0.5))
    spokes = (2 * np.arange(SPOKES) + rings[:, None] % 2) % (2 * SPOKES)
    at = middle + (share[:, None] * rim[spokes])[..., None] * way[spokes]
    return sample(*(radius * at.reshape(-1, 2)).T)


def _rim_along(
    coarse: Samples, line: int, at: np.ndarray, middle: np.ndarray, way: np.ndarray
) -> np.ndarray:
    """Return how far from a point of the stop the rim lies in some directions (A, 2), of radii.

    ``at``, shape (2, R): where the coarse rays meet the stop. Polynomials follow each surface's
    margin between them; that of the stop itself is known.
    """
    margin = coarse.margin[:-1, line]
    known = coarse.ok[line] & (margin < ROUGHLY_WITHIN**2 - 1).all(axis=0)
    clipping = margin[:, known].max(axis=1) > 0
    far = np.linspace(0.0, 2.0, 201)
    x, y = np.moveaxis(middle + far[:, None, None] * way, -1, 0)
    outside = np.hypot(x, y) >= 1
    if clipping.any():
        design = _monomials(*at[:, known])
        terms = np.linalg.lstsq(design, margin[clipping][:, known].T, rcond=None)[0]
        outside |= (_monomials(x, y) @ terms >= 0).any(axis=-1)
    first = np.maximum(outside.argmax(axis=0), 1)
    return far[first]


def _monomials(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the products x^i y^j up to ROUGH_DEGREE in all, along a new last axis."""
    degrees = range(ROUGH_DEGREE + 1)
    return np.stack([x**i * y**j for i in degrees for j in degrees if i + j in degrees], axis=-1)
