"""The chief-ray map from the real to the ideal image plane, with its Jacobian."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import NdBSpline, PPoly


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
    distortion : ndarray (n, 4) or (n + 3, n + 3, 2)
        u = x + x d(|x|^2 / radius^2), d in n even pieces from 0 to 1, each a cubic, coefficients
        low to high, of a parameter that goes from 0 to 1; beyond 1 as at 1. Or, of a lens without
        an axis, u = x + the bicubic spline with these control points, over n x n cells of the
        square around the circle.
    radius : float
        Radius of the image circle, samples.
    circle : (float, float)
        Its centre.

    Returns
    -------
    u : ndarray (..., 2)
    jacobian : ndarray (..., 2, 2)
        du/dx: row u, column x.
    """
    if distortion.ndim == 2:
        count = len(distortion)
        d = PPoly((distortion * float(count) ** np.arange(4)).T[::-1], np.linspace(0, 1, count + 1))
        rho2 = np.minimum(np.sum(x**2, axis=-1) / radius**2, 1.0)
        slope = d(rho2, 1) * 2 / radius**2
        outer = x[..., :, None] * x[..., None, :]
        jacobian = (1 + d(rho2))[..., None, None] * np.eye(2) + slope[..., None, None] * outer
        return x + x * d(rho2)[..., None], jacobian
    count = len(distortion) - 3
    knots = 2 * radius * (np.arange(-3, count + 4) / count - 0.5)
    spline = NdBSpline((knots, knots), distortion, 3)
    z = np.clip(x - np.array(circle), -radius, radius)
    columns = [spline(z, nu=way) for way in ((1, 0), (0, 1))]
    return x + spline(z), np.eye(2) + np.stack(columns, axis=-1)
