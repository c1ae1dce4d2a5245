"""Float64 twin of the exposure stage, from the equations of EMVA 1288."""

from __future__ import annotations

import numpy as np

from gpusim.reference.philox import (
    DARK_CURRENT,
    PRNU,
    PRNU_COLUMN,
    PRNU_ROW,
    column_deviate,
    deviate,
    row_deviate,
)


def dark_current(
    mu_i_e_per_s: float, temperature_c: float, reference_c: float, doubling_c: float
) -> float:
    """Return the dark current at a temperature (EMVA 1288 R3.1, section 3.2)."""
    return mu_i_e_per_s * 2.0 ** ((temperature_c - reference_c) / doubling_c)


def exposure(
    rate: np.ndarray,
    exposure_s: float,
    *,
    origin: tuple[int, int] = (0, 0),
    limit_e: float = np.inf,
    **law: float | np.ndarray,
) -> np.ndarray:
    """Return the mean electrons of a rectangle of pixels from rates in electrons/s.

    ``law`` is that of `exposed`.
    """
    row, col = np.indices(rate.shape)
    mean = exposed(rate, row + origin[0], col + origin[1], exposure_s, **law)
    return np.minimum(mean, limit_e)


def exposed(
    rate: np.ndarray,
    row: np.ndarray,
    col: np.ndarray,
    exposure_s: float,
    *,
    prnu: float,
    dark_current_e_per_s: float,
    serial_number: int,
    prnu_row: float = 0.0,
    prnu_column: float = 0.0,
    dcnu: float = 0.0,
    mask: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Return the mean electrons of pixels anywhere, in the shape of rate, row and col together."""
    row, col = np.broadcast_arrays(row, col)
    key = serial_number
    response = 1 + prnu * deviate(row, col, 0, PRNU, key)
    response += prnu_row * row_deviate(row, 0, PRNU_ROW, key)
    response += prnu_column * column_deviate(col, 0, PRNU_COLUMN, key)
    # Log-normal of mean 1 and standard deviation dcnu.
    variance = np.log(1 + dcnu**2)
    z = deviate(row, col, 0, DARK_CURRENT, key)
    dark = dark_current_e_per_s * np.exp(np.sqrt(variance) * z - variance / 2)
    light = np.maximum(rate * mask * response, 0)
    return exposure_s * (light + dark)
