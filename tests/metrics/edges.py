"""Slanted edges in closed form: a half-plane under a Gaussian, averaged over square pixels."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm


def profile(distance_px: np.ndarray, sigma_px: float, angle_deg: float) -> np.ndarray:
    """Return the mean over a pixel's square, from 0 to 1, at a distance of its middle.

    The integral over the square of Phi(d / sigma) is the second difference of Phi's second
    antiderivative over the square's extent along the normal.
    """
    a, b = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))

    def twice(at: np.ndarray) -> np.ndarray:
        z = at / sigma_px
        return sigma_px**2 / 2 * ((z**2 + 1) * norm.cdf(z) + z * norm.pdf(z))

    wide, narrow = (a + b) / 2, (a - b) / 2
    outer = twice(distance_px + wide) + twice(distance_px - wide)
    return (outer - twice(distance_px + narrow) - twice(distance_px - narrow)) / (a * b)


def mtf(frequency_cy_px: np.ndarray, sigma_px: float, angle_deg: float) -> np.ndarray:
    """Return the MTF along the edge's normal: the Gaussian's times the square aperture's."""
    a, b = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    f = np.asarray(frequency_cy_px)
    return np.exp(-2 * (np.pi * sigma_px * f) ** 2) * np.abs(np.sinc(f * a) * np.sinc(f * b))


def sigma_of(mtf50_cy_px: float, angle_deg: float) -> float:
    """Return the Gaussian's standard deviation, px, that gives an MTF50."""
    return brentq(lambda sigma: mtf(mtf50_cy_px, sigma, angle_deg) - 0.5, 1e-6, 20.0)


def edge(mtf50_cy_px: float, angle_deg: float, side: int = 80, off_px: float = 0.0) -> np.ndarray:
    """Return a picture (side, side) of an edge from 0.1 to 0.9, nearer to the vertical."""
    y, x = np.mgrid[:side, :side] + 0.5
    angle = np.radians(angle_deg)
    distance = (x - side / 2 - off_px) * np.cos(angle) - (y - side / 2) * np.sin(angle)
    return 0.1 + 0.8 * profile(distance, sigma_of(mtf50_cy_px, angle_deg), angle_deg)
