"""Rays from an object plane through a lens of spheres, traced in NumPy without the engine.

A ray from p along the unit vector d meets the sphere of curvature c where, with lengths from its
vertex on the axis,

    c |p|^2 = 2 p_z

and leaves it by Snell's law in vectors (Welford 1986, sec. 4.2 to 4.4). Chief rays go through the
middle of the stop; they are found by Newton's rule from the paraxial entrance pupil. Lengths times
indices, summed, are a ray's path; Debye's sphere about the chief ray's point r0 cuts (r - r0) . d
off it, r where the ray lands.

What the engine works out from the lens's file is given: `gpusim.validate.tracers.SHARED`, and first
order. A field angle is that of the object point from the paraxial entrance pupil, and lengths on
the ideal plane are in the engine's unit, its principal distance: both say what is asked, and LGD
depends on neither. Rays cover the paraxial pupil's size and more: what passes, apertures say.

A point of a plain object at the slant distance R sends L dp dq dA into direction cosines p and q,
and dA cos(theta) / R^2 is the solid angle d Omega that the area dA fills as seen from the pupil.
Light per d Omega is L dp dq R^2 / cos(theta): that of an area across the beam from a far point, if
lengths on it are (p, q) R / sqrt(cos(theta)).
"""

from __future__ import annotations

import numpy as np

from gpusim.lens.system import System, conjugates, first_order
from gpusim.validate.tracers import PLANE_NM, Bundle

AIM_MM = 1e-11  # of the stop's radius, some 0.3 mm, 3e-11: 1e-8 um at the image
STEP_MM = 1e-4  # of the slope for Newton's rule
RAYS_ACROSS = 45  # over half the pupil some 1000: nine for each coefficient of degree 14
# Rays cover so many radii of the paraxial entrance pupil: the real one is some percent larger off
# the axis, and rays must reach beyond the rim for polynomials to interpolate there.
OVERSIZE = 1.2


class SphereTracer:
    """Rays of a centred lens of spheres before an object at a finite distance.

    Raises
    ------
    ValueError
        A surface is no sphere, or the object is at infinity.
    """

    name, independent = "rays through spheres in NumPy", True

    def __init__(self, system: System) -> None:
        prescription = system.prescription
        if prescription.object_distance_mm is None:
            raise ValueError("the object is at infinity")
        if any(s.conic or any(s.asphere.coefficients) for s in prescription.surfaces):
            raise ValueError("a surface is no sphere")
        self.system = system
        self.curvature = np.array([s.vertex_curvature for s in prescription.surfaces])
        gaps = [s.thickness for s in prescription.surfaces[:-1]]
        self.vertex_mm = np.concatenate([[0.0], np.cumsum(gaps)])
        self.stop = prescription.stop - 1
        self.distance_mm = prescription.object_distance_mm
        paraxial = first_order(prescription)
        self.pupil_mm = paraxial.entrance_pupil_z_mm
        self.pupil_radius_mm = paraxial.entrance_pupil_diameter_mm / 2
        self.efl_mm = conjugates(prescription, PLANE_NM).principal_distance_mm
        # A ray beyond any of these is stopped.
        self.clear_mm = np.array(system.semi_diameter_mm, float)
        self.clear_mm[self.stop] = min(self.clear_mm[self.stop], system.stop_radius_mm)

    def chief_mm(self, field_rad: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return where chief rays of fields (F,) land, mm from the axis."""
        index = self.system.index(np.array([wavelength_nm]))[:, 0]
        start = self._object(np.asarray(field_rad, float))
        through = self._aimed(start, index)
        return self._traced(start, (np.zeros_like(through), through), index)[0][-1][1]

    def rays(self, field_rad: float, wavelength_nm: float) -> Bundle:
        """Return the rays of a field, those that reach the image."""
        index = self.system.index(np.array([wavelength_nm]))[:, 0]
        start = self._object(np.array([field_rad]))
        middle = self._aimed(start, index)
        u = np.linspace(-1, 1, RAYS_ACROSS)
        x, y = (part.ravel() for part in np.meshgrid(u[u >= 0], u))
        own = x**2 + y**2 <= 1
        # The chief ray comes first.
        reach = OVERSIZE * self.pupil_radius_mm
        x = reach * np.append(0.0, x[own])
        y = middle + reach * np.append(0.0, y[own])
        with np.errstate(invalid="ignore"):  # a ray that misses a surface becomes NaN
            points, leaving, path, sent = self._traced(start, (x, y), index)
        away = points[-1] - points[-1][:, :1]
        wave = path - np.sum(away * leaving, axis=0)
        bounded = np.flatnonzero(np.isfinite(self.clear_mm))
        margin = np.stack([
            np.sum(points[i][:2] ** 2, axis=0) / self.clear_mm[i] ** 2 - 1 for i in bounded
        ])  # fmt: skip
        cosine = np.cos(field_rad)
        slant_mm = (self.distance_mm + self.pupil_mm) / cosine
        entered = np.abs(sent[:1]), sent[1:2]
        entered = np.concatenate(entered) * slant_mm / np.sqrt(cosine)
        ok = np.isfinite(wave) & np.isfinite(margin).all(axis=0)
        ok[0] = False
        return Bundle(
            float(points[-1][1, 0]),
            float(leaving[1, 0]),
            np.abs(leaving[0, ok]),
            leaving[1, ok],
            (wave - wave[0])[ok],
            margin[:, ok],
            entered[:, ok],
        )

    def _object(self, field_rad: np.ndarray) -> np.ndarray:
        """Return heights of object points: the image of one below the axis is above it."""
        return -np.tan(field_rad) * (self.distance_mm + self.pupil_mm)

    def _aimed(self, start_mm: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Return heights in the paraxial entrance pupil of rays through the stop's middle."""
        through, count = np.zeros_like(start_mm), self.stop + 1

        def miss(at_mm: np.ndarray) -> np.ndarray:
            return self._traced(start_mm, (np.zeros_like(at_mm), at_mm), index, count)[0][-1][1]

        for _ in range(30):
            missed = miss(through)
            if np.max(np.abs(missed)) < AIM_MM:
                break
            through = through - missed * STEP_MM / (miss(through + STEP_MM) - missed)
        return through

    def _traced(
        self,
        start_mm: np.ndarray,
        pupil_mm: tuple[np.ndarray, np.ndarray],
        index: np.ndarray,
        count: int | None = None,
    ) -> tuple[list[np.ndarray], np.ndarray, np.ndarray, np.ndarray]:
        """Trace rays from heights in the object through points of the paraxial entrance pupil.

        Returns
        -------
        points : list of ndarray (3, R)
            At the surfaces, as many as asked for; of all, the image plane's too. z is from the
            last vertex, in the image plane from the first.
        leaving : ndarray (3, R)
            Directions at the end.
        path_mm : ndarray (R,)
        sent : ndarray (3, R)
            Directions from the object.
        """
        x, y = np.broadcast_arrays(*pupil_mm)
        p = np.stack([np.zeros_like(x), start_mm + 0 * y, np.full_like(y, -self.distance_mm)])
        d = np.stack([x, y, np.full_like(y, self.pupil_mm)]) - p
        d = sent = d / np.linalg.norm(d, axis=0)
        points, path = [], np.zeros_like(y)
        for i in range(len(self.curvature) if count is None else count):
            c, ratio = self.curvature[i], index[i] / index[i + 1]
            p = p - np.array([[0.0], [0.0], [self.vertex_mm[i]]])
            b = d[2] - c * np.sum(d * p, axis=0)
            f = c * np.sum(p**2, axis=0) - 2 * p[2]
            along = f / (b + np.sqrt(b**2 - c * f))
            p, path = p + along * d, path + index[i] * along
            normal = np.stack([-c * p[0], -c * p[1], 1 - c * p[2]])
            cosine = np.sum(d * normal, axis=0)
            bent = np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
            d = ratio * d + bent * normal
            points.append(p)
            p = p + np.array([[0.0], [0.0], [self.vertex_mm[i]]])
        if count is None:
            along = (self.system.image_z_mm - p[2]) / d[2]
            points.append(p + along * d)
            path = path + index[-1] * along
        return points, d, path, sent
