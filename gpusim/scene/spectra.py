"""The wavelength grid, measured spectra on it, and photometry.

The tables lie beside the package as text (``gpusim/data/spectra``), each with its source: reading
them takes milliseconds, importing colour-science 2 s. A test holds them against colour-science's
own numbers.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np

from gpusim.errors import UserError

WAVELENGTHS_NM = np.arange(400.0, 701.0, 5.0)
"""The grid of every spectral product, 61 wavelengths, nm."""

QUADRATURE_NM = np.full(WAVELENGTHS_NM.size, 5.0)
"""Weights of the trapezoidal rule on that grid, nm."""
QUADRATURE_NM[[0, -1]] = 2.5

MAXIMUM_LUMINOUS_EFFICACY_LM_PER_W = 683.0
"""K_m of photopic vision (CIE 015:2018), lm/W."""


@cache
def _table(name: str) -> dict[str, np.ndarray]:
    """Return the columns of a table by name, each (61,) and read-only."""
    text = (files("gpusim") / "data" / "spectra" / f"{name}.csv").read_text(encoding="utf-8")
    header, *rows = [line for line in text.splitlines() if not line.startswith("#")]
    values = np.array([row.split(",") for row in rows], np.float64)
    if not np.array_equal(values[:, 0], WAVELENGTHS_NM):
        raise ValueError(f"{name}.csv: the rows are not the 61 wavelengths")
    values.flags.writeable = False
    return dict(zip(header.split(",")[1:], values.T[1:], strict=True))


def illuminant(name: str) -> np.ndarray:
    """Return the relative spectral power of a CIE illuminant.

    Parameters
    ----------
    name : str
        ``"D50"``, ``"D65"``, ``"A"``, ``"FL2"``, ``"LED-B3"``, ...

    Returns
    -------
    ndarray (61,)
        Relative: the scale is the table's own.

    Raises
    ------
    UserError
        For a name that is not in the table.
    """
    table = _table("illuminants")
    if name not in table:
        raise UserError(
            "unknown illuminant", field="illuminant", value=name, allowed=", ".join(table)
        )
    return table[name]


def colorchecker() -> dict[str, np.ndarray]:
    """Return the reflectances (61,) of the 24 ColorChecker patches, in reading order."""
    return dict(_table("colorchecker"))


def colour_matching() -> np.ndarray:
    """Return the colour-matching functions of the CIE 1931 2-degree observer, ndarray (3, 61)."""
    return np.stack(list(_table("cie_1931_2deg").values()))


def rgb_reflectances() -> np.ndarray:
    """Return the basis reflectances of linear Rec.709 red, green and blue, ndarray (3, 61).

    Their sum is 1 to 1e-5 at each wavelength, and under D65 they reproduce the RGB that weighs them
    (Mallett and Yuksel 2019).
    """
    return np.stack(list(_table("mallett_2019").values()))


def xyz(radiance: np.ndarray) -> np.ndarray:
    """Return absolute tristimulus values.

    X = K_m int L(lambda) xbar(lambda) dlambda and so on (CIE 015:2018), here over 400-700 nm.

    Parameters
    ----------
    radiance : ndarray (..., 61)
        Spectral radiance, W m^-2 sr^-1 nm^-1.

    Returns
    -------
    ndarray (..., 3)
        X, Y, Z; Y is the luminance in cd/m^2.
    """
    weights = MAXIMUM_LUMINOUS_EFFICACY_LM_PER_W * colour_matching() * QUADRATURE_NM
    return np.asarray(radiance, np.float64) @ weights.T


def luminance_cd_m2(radiance: np.ndarray) -> np.ndarray:
    """Return the luminance (...), cd/m^2, of spectral radiance (..., 61), W m^-2 sr^-1 nm^-1."""
    return xyz(radiance)[..., 1]


def white_radiance(illuminant_name: str, white_luminance_cd_m2: float) -> np.ndarray:
    """Return the spectral radiance of a perfect diffuser under an illuminant.

    Parameters
    ----------
    illuminant_name : str
        As for `illuminant`.
    white_luminance_cd_m2 : float
        Luminance of the diffuser, cd/m^2.

    Returns
    -------
    ndarray (61,)
        W m^-2 sr^-1 nm^-1.
    """
    relative = illuminant(illuminant_name)
    return relative * (white_luminance_cd_m2 / luminance_cd_m2(relative))
