"""The chief-ray map from the real to the ideal image plane, with its Jacobian."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval2d


def chief_ray(
    x: np.ndarray,
    distortion: np.ndarray,
    radius: float,
    circle: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:
    """Map points of the real image plane to the ideal one.

    Parameters
    ----------
    x : ndarray (..., 2)
        Samples from the optical axis.
    distortion : ndarray (8,) or (D + 1, D + 1, 2)
        Coefficients of g, low to high: u = x g(|x|^2 / radius^2); or of a lens without an axis
        u = sum of distortion[i, j] z_x^i z_y^j with z = (x - circle) / radius.
    radius : float
        Of the image circle, samples.
    circle : (float, float)
        Its centre.

    Returns
    -------
    u : ndarray (..., 2)
    jacobian : ndarray (..., 2, 2)
        du/dx: row u, column x.
    """
    if distortion.ndim == 1:
        g = np.polynomial.Polynomial(distortion)
        rho2 = np.sum(x**2, axis=-1) / radius**2
        slope = g.deriv()(rho2) * 2 / radius**2
        outer = x[..., :, None] * x[..., None, :]
        jacobian = g(rho2)[..., None, None] * np.eye(2) + slope[..., None, None] * outer
        return x * g(rho2)[..., None], jacobian
    z = np.moveaxis((x - np.array(circle)) / radius, -1, 0)
    columns = [polyval2d(*z, polyder(distortion, axis=axis)) / radius for axis in (0, 1)]
    u = np.moveaxis(polyval2d(*z, distortion), 0, -1)
    return u, np.moveaxis(columns, (0, 1), (-1, -2))
