"""Float64 twin of exposure and highlight roll-off."""

from __future__ import annotations

import numpy as np


def roll_off(light: np.ndarray, ev: float, share: float) -> np.ndarray:
    """Return light shown brighter or darker by stops; white, 1, is kept.

    Brighter: what is above 1 - share is bent by d / (1 + b d), with b such that white is 1; with no
    share it is clipped. Darker: scaled up to a quarter, then the parabola through white that
    continues it with the same slope (Adobe's DNG SDK 1.4, dng_function_exposure_tone).
    """
    light, slope = np.asarray(light, np.float64), 2.0**ev
    if slope < 1:
        # y = p x^2 + q x + r with y(1/4) = s/4, y'(1/4) = s, y(1) = 1.
        terms = [[1 / 16, 1 / 4, 1], [1 / 2, 1, 0], [1, 1, 1]]
        p, q, r = np.linalg.solve(terms, [slope / 4, slope, 1])
        return np.where(light <= 0.25, slope * light, p * light**2 + q * light + r)
    scaled = slope * light
    if share == 0 or slope == 1:
        return np.minimum(scaled, 1)
    knee = 1 - share
    over = np.maximum(scaled - knee, 0)
    white = slope - knee  # is to become `share`
    bent = over / (1 + (white / share - 1) / white * over)
    return np.minimum(np.where(scaled <= knee, scaled, knee + bent), 1)
