"""Where light lands that a lens without symmetry sends: from the real image plane to the ideal one.

The ideal plane is that of a distortion-free camera whose axis is the lens's: u = f tan(theta), in
the direction of the field. The map is a polynomial in both coordinates, of the least degree that
follows the traced chief rays.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d

from gpusim.errors import UserError

# Largest error at a traced chief ray: a thousandth of a pixel of 1 um.
FIT_ERROR_UM = 1e-3
# A double Gauss over 22 deg with an element tilted by 0.3 deg needs 8, a Tessar over 23 deg 10.
MAX_DEGREE = 11
STEPS = 33  # points across the circle where the map must not fold


class PlaneMap:
    """The chief rays of one wavelength: u = sum of ideal[i, j] z_x^i z_y^j, z = (x - centre) / R.

    Parameters
    ----------
    real_um, ideal_um : ndarray (M, 2)
        Where traced chief rays land, and where those of the ideal camera do.
    centre_um : (float, float)
        Of the image circle.
    radius_um : float
        R.

    Attributes
    ----------
    ideal : ndarray (degree + 1, degree + 1, 2)
        Coefficients, um; 0 where i + j > degree.
    degree : int

    Raises
    ------
    UserError
        Where there is no circle, no polynomial up to ``MAX_DEGREE`` follows the rays to
        ``FIT_ERROR_UM``, or the map folds over.
    """

    def __init__(
        self,
        real_um: np.ndarray,
        ideal_um: np.ndarray,
        centre_um: tuple[float, float],
        radius_um: float,
    ) -> None:
        if radius_um == 0:
            raise UserError(
                "the fields of the bank make no image: they must lie on both sides of the axis",
                field="field_x_deg, field_y_deg",
                allowed="from below 0 to above 0",
            )
        self.centre_um, self.radius_um = centre_um, radius_um
        z = (real_um - centre_um) / radius_um
        for self.degree in range(1, MAX_DEGREE + 1):
            powers = [(i, j) for i in range(self.degree + 1) for j in range(self.degree + 1 - i)]
            terms = np.stack([z[:, 0] ** i * z[:, 1] ** j for i, j in powers], axis=1)
            found = np.linalg.lstsq(terms, ideal_um, rcond=None)[0]
            error_um = np.hypot(*(terms @ found - ideal_um).T)
            if error_um.max() <= FIT_ERROR_UM:
                break
        else:
            worst = real_um[error_um.argmax()]
            raise UserError(
                "The chief-ray map of this lens is not smooth enough for a polynomial.",
                field="max_field_deg",
                value=f"{error_um.max():.3g} um off at ({worst[0]:.0f}, {worst[1]:.0f}) um",
                allowed=f"at most {FIT_ERROR_UM} um with degree {MAX_DEGREE}: a smaller field",
            )
        self.ideal = np.zeros((self.degree + 1, self.degree + 1, 2))
        self.ideal[tuple(np.transpose(powers))] = found
        if np.linalg.det(self.jacobian()).min() <= 0:
            raise UserError(
                "distortion folds the image over: two field angles meet in one image point",
                field="max_field_deg",
                allowed="a smaller field",
            )

    def ideal_points(
        self, x_um: np.ndarray, y_um: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x and y on the ideal plane of real image points, and which are in the circle.

        Beyond it they are those of the nearest point of its rim.
        """
        z_x = (x_um - self.centre_um[0]) / self.radius_um
        z_y = (y_um - self.centre_um[1]) / self.radius_um
        radius = np.hypot(z_x, z_y)
        inside = radius <= 1
        shrink = 1 / np.maximum(radius, 1.0)
        u, v = polyval2d(z_x * shrink, z_y * shrink, self.ideal)
        return u, v, inside

    def jacobian(self) -> np.ndarray:
        """Return du/dx (P, 2, 2) at points all over the circle."""
        line = np.linspace(-1, 1, STEPS)
        z_x, z_y = (one.ravel() for one in np.meshgrid(line, line))
        inside = np.hypot(z_x, z_y) <= 1
        columns = [
            polyval2d(z_x[inside], z_y[inside], polyder(self.ideal, axis=axis)) / self.radius_um
            for axis in (0, 1)
        ]
        return np.transpose(columns, (2, 1, 0))
