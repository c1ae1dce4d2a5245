"""Light as it enters a lens: how much of it goes into each direction behind it.

A point of an even scene sends light evenly over what it sees of the lens: per area dA across the
beam where it is at infinity, per direction cosines along the object plane where it is near
(Lambert's law). With q either of the two and (alpha, beta) the direction cosines in which a ray
leaves, light is carried along rays and so the pupil passes, per d alpha d beta,

    E = |d(q1, q2) / d(alpha, beta)|

(Born & Wolf, Principles of Optics, 7th ed., sec. 3.1.2: intensity along a tube of rays), and its
amplitude is sqrt(E). E is even where Abbe's sine condition holds. An image point, on the other
hand, sees the scene evenly in (alpha, beta) whatever the lens does (radiance theorem): that is the
light which arrives there from all points, and no point's own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from gpusim.lens.aim import AIM_TOLERANCE, launch_field
from gpusim.lens.geometry import Geometry
from gpusim.lens.launch import Launch
from gpusim.lens.trace import trace

if TYPE_CHECKING:
    from gpusim.lens.system import System

# Steps of difference quotients. Forward, of the stop's radius: E errs by half a step times its
# relative slope, 2e-5 where it doubles over the pupil.
STEP = 2e-5
# Backward and central, of the field: with 3e-4 rad the curvature of distortion leaves 1e-6, and
# what aiming leaves of a chief ray, 1e-9 f, 3e-6 at most.
STEP_RAD = 3e-4


@dataclass(frozen=True)
class Entering:
    """Light of one field's rays, R of them, by wavelength.

    Attributes
    ----------
    geometry : Geometry
    stop_radius_mm : float
    index : ndarray, shape (S + 1, L)
    launch : Launch
    px, py : ndarray, shape (L, R)
        Where they cross the launch plane.
    """

    geometry: Geometry
    stop_radius_mm: float
    index: np.ndarray
    launch: Launch
    px: np.ndarray
    py: np.ndarray

    def density(self, line: int, kept: np.ndarray) -> tuple[np.ndarray, float]:
        """Return E of the rays `kept` at one wavelength over the chief ray's, and the latter.

        Parameters
        ----------
        line : int
        kept : ndarray of bool, shape (R,)

        Returns
        -------
        density : ndarray, shape (kept,)
            NaN where a neighbour of the ray does not pass.
        of_chief : float
            E itself: mm^2, or without unit where the object is near.
        """
        px, py = (np.append(0.0, one[line, kept]) for one in (self.px, self.py))
        step = STEP * self.stop_radius_mm
        aside = np.array([[0, 1, 0], [0, 0, 1]]) * step
        x, y = ((one + a[:, None]).reshape(1, -1) for one, a in zip((px, py), aside, strict=True))
        launch = replace(self.launch, base=self.launch.base[:, [line]])
        rays = trace(self.geometry, self.index[:, [line]], launch, x, y)
        entered = q_of(launch, x, y)[:, 0].reshape(2, 3, -1)
        left = rays.direction[:2, 0].reshape(2, 3, -1)
        ok = rays.ok.reshape(3, -1).all(axis=0)
        light = _area(entered) / np.where(ok, _area(left), np.nan)
        return light[1:] / light[0], float(light[0])


def _area(three: np.ndarray) -> np.ndarray:
    """Return the area (R,) between points (2, 3, R): the first, and two beside it."""
    one, two = three[:, 1] - three[:, 0], three[:, 2] - three[:, 0]
    return np.abs(one[0] * two[1] - one[1] * two[0])


def q_of(launch: Launch, px: np.ndarray, py: np.ndarray) -> np.ndarray:
    """Return q, shape (2, L, R), of rays that cross the launch plane at px, py: see the head."""
    if launch.source is None:
        return np.stack([px, py])
    return launch.rays(px, py)[1][:2]


@dataclass(frozen=True)
class Stretch:
    """How the image of a lens is stretched about a field.

    Attributes
    ----------
    along, across : ndarray, shape (2, 2)
        How far the chief ray lands per radian along the meridian and across it, mm: in the image
        plane, and more of it per mm by which the plane is moved away from the lens. NaN where a
        chief ray beside the field does not pass.
    scene : float
        Solid angle of the field per area of the scene: 1, or sr per mm^2 of a near object plane.
    """

    along: np.ndarray
    across: np.ndarray
    scene: float

    def area(self, focus_mm: float = 0.0) -> float:
        """Return the image's area per area of the scene: mm^2 per sr, or mm^2 per mm^2."""
        one, two = (way[0] + focus_mm * way[1] for way in (self.along, self.across))
        return float(abs(one[0] * two[1] - one[1] * two[0])) * self.scene


def stretch(
    system: System,
    reference_nm: float,
    theta: float,
    azimuth: float = 0.0,
    start: Launch | None = None,
) -> Stretch:
    """Return how the image is stretched about a field, by chief rays.

    Parameters
    ----------
    system : System
    reference_nm : float
        Wavelength of the chief rays. A bank's scene lies on the image plane by those of its
        reference; PSFs of other wavelengths hold the way from there, and so their light is by this
        area too.
    theta, azimuth : float
        Field, rad.
    start : Launch, optional
        Launch plane of that field on the chief ray; by default it is sought.
    """
    index = system.index(np.array([reference_nm]))
    # Inwards along the meridian, where chief rays surely pass.
    start = start or _chief(system, index, theta, azimuth)
    nearer = [_chief(system, index, theta - n * STEP_RAD, azimuth, start) for n in (1, 2)]
    image = [_landed(system, index, launch) for launch in (start, *nearer)]
    along = (1.5 * image[0] - 2 * image[1] + 0.5 * image[2]) / STEP_RAD
    if not system.geometry.moved.any():
        # Across the meridian the image turns with the scene.
        radius = along if theta == 0 else image[0] / np.sin(theta)
        across = np.stack([-radius[:, 1], radius[:, 0]], axis=1)
    else:
        # Straight across by the tangent of a step: farther off by its square, half of it.
        off = np.arctan2(STEP_RAD, np.sin(theta))
        beside = np.arctan2(np.hypot(np.sin(theta), STEP_RAD), np.cos(theta))
        ends = [_chief(system, index, float(beside), azimuth + sign * off) for sign in (1, -1)]
        one, two = (_landed(system, index, launch) for launch in ends)
        across = (one - two) / (2 * STEP_RAD)
    if np.isinf(system.geometry.object_z):
        return Stretch(along, across, 1.0)
    # A point of the object plane lies at z tan(theta) from the axis.
    near_mm = system.geometry.object_z - system.geometry.field_z
    return Stretch(along, across, float(np.cos(theta)) ** 3 / near_mm**2)


def _chief(
    system: System, index: np.ndarray, theta: float, azimuth: float, start: Launch | None = None
) -> Launch:
    """Return the launch plane of a field; on the far side of the axis its angle is below 0."""
    tolerance = AIM_TOLERANCE * system.stop_radius_mm
    launch, found = launch_field(system.geometry, index, theta, tolerance, azimuth, start=start)
    return replace(launch, base=np.where(found, launch.base, np.nan))


def _landed(system: System, index: np.ndarray, launch: Launch) -> np.ndarray:
    """Return where the chief ray of a field lands, mm, and how much farther per mm: (2, 2)."""
    zero = np.zeros((1, 1))
    rays = trace(system.geometry, index, launch, zero, zero)
    if not rays.ok[0, 0]:
        return np.full((2, 2), np.nan)
    point, direction = rays.point[:, 0, 0], rays.direction[:, 0, 0]
    slope = direction[:2] / direction[2]
    return np.stack([point[:2] + (system.image_z_mm - point[2]) * slope, slope])
