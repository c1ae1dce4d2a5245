"""Image height against field angle: where the chief rays of one wavelength land."""

from __future__ import annotations

import functools

import numpy as np
from scipy.interpolate import PPoly, make_interp_spline

from gpusim.lens.prescription import Prescription
from gpusim.lens.system import conjugates

# Lenses that see farther off the axis are taken to follow the angle, others its tangent: there the
# two differ by a third of the height, and a wide lens bends its image towards the angle.
WIDE_DEG = 50.0
# Degree of the spline. Largest miss between the 15 default fields of the library's lenses, um:
# phone 1.2 with 3, 0.6 with 5, 0.25 with 7; wide 0.11, 0.008, 0.0006; all others below 1e-3 with 7.
DEGREE = 7


class FieldMap:
    """Height h(theta) of a chief ray in the image, odd in theta.

    A spline through the traced rays, of the difference from c u over u: u is tan(theta), or
    theta itself where the lens sees farther than ``WIDE_DEG``.

    Parameters
    ----------
    theta : ndarray, shape (F,)
        Field angles, rad, rising from 0.
    height_um : ndarray, shape (F,)
        Real image heights.
    scale_um : float
        Principal distance c: the focal length where lens and object are set to infinity.
    """

    def __init__(self, theta: np.ndarray, height_um: np.ndarray, scale_um: float) -> None:
        self.edge = float(theta[-1])
        self.edge_um = float(height_um[-1])
        self.scale_um = scale_um
        self.wide = self.edge > np.radians(WIDE_DEG)
        u = theta if self.wide else np.tan(theta)
        shift = height_um - scale_um * u
        spline = make_interp_spline(
            np.concatenate([-u[:0:-1], u]),
            np.concatenate([-shift[:0:-1], shift]),
            k=min(DEGREE, 2 * len(u) - 3),  # 2 F - 1 points carry an odd function
        )
        self._spline = PPoly.from_spline(spline)
        self._derivative = self._spline.derivative()
        self._count = 32 * len(u)

    def height_um(self, theta: np.ndarray) -> np.ndarray:
        """Return the height at angles from 0 to the edge."""
        u = theta if self.wide else np.tan(theta)
        return self.scale_um * u + self._spline(u)

    def slope_um(self, theta: np.ndarray) -> np.ndarray:
        """Return the derivative of the height, um per rad, at angles from 0 to the edge."""
        if self.wide:
            return self.scale_um + self._derivative(theta)
        u = np.tan(theta)
        return (self.scale_um + self._derivative(u)) * (1 + u * u)

    def angle(self, height_um: np.ndarray) -> np.ndarray:
        """Return the angle, rad, at heights from 0 to the edge's, good to 1e-9 um."""
        theta = np.asarray(height_um, dtype=float) * (self.edge / self.edge_um)
        for _ in range(20):  # Newton on a monotone map: 3 to 5 steps
            off_um = self.height_um(theta) - height_um
            theta = np.clip(theta - off_um / self.slope_um(theta), 0, self.edge)
            if np.max(np.abs(off_um), initial=0) < 1e-9:
                break
        return theta

    @functools.cached_property
    def folds_at(self) -> float | None:
        """Smallest angle, rad, from which the height does not rise any more; None if it does."""
        theta = np.linspace(0, self.edge, self._count)
        falling = np.flatnonzero(np.diff(self.height_um(theta)) <= 0)
        return float(theta[falling[0]]) if falling.size else None


def ideal_height_um(principal_distance_mm: float, field_deg: np.ndarray) -> np.ndarray:
    """Return the principal distance times tan(theta), infinite from 90 deg."""
    below = field_deg < 90
    tangent = np.tan(np.radians(np.where(below, field_deg, 0)))
    return np.where(below, 1e3 * principal_distance_mm * tangent, np.inf)


def principal_mm(prescription: Prescription, reference_nm: float) -> float | None:
    """Return the principal distance of a lens; None where lens and object are set to infinity."""
    if prescription.object_distance_mm is None and prescription.focused_mm is None:
        return None
    return conjugates(prescription, reference_nm).principal_distance_mm
