"""Float64 twin of the exposure stage, from the equations of EMVA 1288."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from gpusim.reference.philox import PRNU, shared_word


def dark_current(
    mu_i_e_per_s: float, temperature_c: float, reference_c: float, doubling_c: float
) -> float:
    """Return the dark current at a temperature (EMVA 1288 R3.1, section 3.2)."""
    return mu_i_e_per_s * 2.0 ** ((temperature_c - reference_c) / doubling_c)


def response(row: np.ndarray, col: np.ndarray, serial_number: int, prnu: float) -> np.ndarray:
    """Return the relative response 1 + PRNU z of each pixel."""
    word = shared_word(row, col, 0, PRNU, serial_number)
    return 1 + prnu * ndtri((word + 0.5) / 2**32)


def exposure(
    rate: np.ndarray,
    exposure_s: float,
    *,
    prnu: float,
    dark_current_e_per_s: float,
    serial_number: int,
    origin: tuple[int, int] = (0, 0),
    limit_e: float = np.inf,
) -> np.ndarray:
    """Return the mean electrons of a rectangle of pixels from rates in electrons/s."""
    row, col = np.indices(rate.shape)
    light = rate * response(row + origin[0], col + origin[1], serial_number, prnu)
    return np.minimum(exposure_s * (np.maximum(light, 0) + dark_current_e_per_s), limit_e)
