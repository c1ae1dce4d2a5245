"""Real rays of a field: aimed at points of the stop, traced to the image plane.

Each has its direction cosines there and its W: see `gpusim.lens.wavefront`.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    geometry = system.geometry
    tolerance = AIM_TOLERANCE * system.stop_radius_mm
    px, py, found = aim(geometry, index, launch, stop_x, stop_y, tolerance_mm=tolerance)
    # The chief ray goes first.
    first = ((0, 0), (1, 0))
    lossy = goes_with_the_ray(system.prescription)
    rays = trace(geometry, index, launch, np.pad(px, first), np.pad(py, first), crossings=lossy)
    ok = np.pad(found, first, constant_values=True) & rays.ok & (rays.direction[2] > 0)
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
    # As aimed: a ray that failed before the stop has a place there too.
    aimed2 = np.append(0.0, stop_x**2 + stop_y**2) / system.stop_radius_mm**2
    diaphragm = np.broadcast_to(aimed2 - 1, rays.ok.shape)
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
    coarse = 21
    x, y = grid(0.0 if half else -rim, rim, -rim, rim, coarse)
    lit = _sample(system, index, launch, x, y).inside
    if not lit.any(axis=1).all():
        raise UserError(
            f"no light passes the lens at {np.degrees(theta):.4g} deg",
            file=system.prescription.file,
            field="max_field_deg",
            value=f"{np.degrees(theta):.4g}",
            allowed="a smaller field",
        )
    inside = lit.any(axis=0)
    # The rim lies within one coarse spacing of the last ray inside; one more reaches beyond it.
    spare = 2 * (2 * rim / (coarse - 1))
    x_low, x_high = max(-rim, x[inside].min() - spare), min(rim, x[inside].max() + spare)
    y_low, y_high = max(-rim, y[inside].min() - spare), min(rim, y[inside].max() + spare)
    box = (0.0 if half else x_low, x_high, y_low, y_high)
    return _sample(system, index, launch, *grid(*box, RAYS_ACROSS))
