"""Chief rays from an object plane through a lens of spheres, in NumPy: no code of the engine's.

In the meridional plane a ray from p along the unit vector d meets the sphere of curvature c where,
with lengths from its vertex on the axis,

    c |p|^2 = 2 p_z

and leaves it by Snell's law in vectors (Welford 1986, sec. 4.2 to 4.4). Chief rays go through the
middle of the stop; they are found by Newton's rule from the paraxial entrance pupil.

A field angle is that of the object point from that pupil, and lengths on the ideal plane are in the
engine's unit: both say what is asked, and LGD depends on neither.
"""

from __future__ import annotations

import numpy as np

from gpusim.lens.system import System, conjugates, first_order

AIM_MM = 1e-11  # of the stop's radius, some 0.3 mm, 3e-11: 1e-8 um at the image
STEP_MM = 1e-4  # of the slope for Newton's rule


class SphereTracer:
    """Chief rays of a centred lens of spheres before an object at a finite distance.

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
        self.pupil_mm = first_order(prescription).entrance_pupil_z_mm
        self.efl_mm = conjugates(prescription).principal_distance_mm

    def chief_mm(self, field_rad: np.ndarray, wavelength_nm: float) -> np.ndarray:
        """Return where chief rays of fields (F,) land, mm from the axis."""
        index = self.system.index(np.array([wavelength_nm]))[:, 0]
        # The image of an object point below the axis is above it.
        start = -np.tan(np.asarray(field_rad, float)) * (self.distance_mm + self.pupil_mm)
        through = np.zeros_like(start)  # where the ray meets the pupil's plane
        for _ in range(30):
            miss = self._height(start, through, index, self.stop + 1)
            if np.max(np.abs(miss)) < AIM_MM:
                break
            beside = self._height(start, through + STEP_MM, index, self.stop + 1)
            through = through - miss * STEP_MM / (beside - miss)
        return self._height(start, through, index, len(self.curvature))

    def _height(
        self, start_mm: np.ndarray, through_mm: np.ndarray, index: np.ndarray, count: int
    ) -> np.ndarray:
        """Return heights of rays at the last of so many surfaces; behind all, in the image."""
        y, z = start_mm, np.full_like(start_mm, -self.distance_mm)
        m, n = through_mm - y, self.pupil_mm - z
        m, n = m / np.hypot(m, n), n / np.hypot(m, n)
        for i in range(count):
            c, ratio, z = self.curvature[i], index[i] / index[i + 1], z - self.vertex_mm[i]
            b = n - c * (m * y + n * z)
            f = c * (y**2 + z**2) - 2 * z
            along = f / (b + np.sqrt(b**2 - c * f))
            y, z = y + along * m, z + along * n
            normal = -c * y, 1 - c * z
            cosine = m * normal[0] + n * normal[1]
            bent = np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine
            m, n = ratio * m + bent * normal[0], ratio * n + bent * normal[1]
            z = z + self.vertex_mm[i]
        if count == len(self.curvature):
            y = y + (self.system.image_z_mm - z) / n * m
        return y
