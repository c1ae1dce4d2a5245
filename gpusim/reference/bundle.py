"""The light that one image point sees, in object space: its frame, and the bundle of its rays.

Equations: `gpusim.reference.backward`, which traces them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.reference.backward import aim, chief_back, trace_back

OVERSIZE = 1.04  # rays are traced to so many radii of each rim, so that the rim is interpolated
RAYS_ACROSS = 81


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
            aimed, _ = aim(system, index, end[:, None], there, np.zeros((2, 1)))
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
        cosines, found = aim(system, index, image[:, None], guess, stop)
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
