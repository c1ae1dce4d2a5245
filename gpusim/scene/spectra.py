"""The wavelength grid, measured spectra on it, and photometry.

The tables lie beside the package as text (``gpusim/data/spectra``), each with its source: reading
them takes milliseconds, importing colour-science 2 s. A test holds them against colour-science's
own numbers.
"""

from __future__ import annotations

import math
import re
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.scene.spd import FORMATS, is_spectrum, on_grid, read_spectrum

STEP_NM = 5.0
SHORTEST_NM, LONGEST_NM = 300.0, 1200.0
"""Ends of the light that is computed: glass passes little below, silicon sees none beyond."""

WAVELENGTHS_NM = np.arange(400.0, 701.0, STEP_NM)
"""The grid of every spectral product, 61 wavelengths, nm; scenes may reach farther: `grid_nm`."""

QUADRATURE_NM = np.full(WAVELENGTHS_NM.size, STEP_NM)
"""Weights of the trapezoidal rule on that grid, nm."""
QUADRATURE_NM[[0, -1]] = STEP_NM / 2

MAXIMUM_LUMINOUS_EFFICACY_LM_PER_W = 683.0
"""K_m of photopic vision (CIE 015:2018), lm/W."""
SECOND_RADIATION_M_K = 1.438776877e-2
"""c2 = h c / k of Planck's law (SI 2019), m K."""
# CIE 015:2018, eq. 4.1: illuminant A is Planck's law at 2848 K with the c2 of its time.
_A_KELVIN, _A_C2_M_K, _A_UNIT_NM = 2848.0, 1.435e-2, 560.0
_KELVIN = re.compile(r"(\d{1,6}(?:\.\d+)?) ?K", re.ASCII)
# CIE daylight: hundreds of kelvins by the c2 of its time, D57, or the temperature itself, D5700K.
_DAYLIGHT = re.compile(r"D(?:(\d{2,3})|(\d{4,5}(?:\.\d+)?) ?K)", re.ASCII)
_DAYLIGHT_C2_RATIO = 1.4388 / 1.4380  # CIE 015:2018, 4.1.2: D65 has 6504 K
COOLEST_DAYLIGHT_K, HOTTEST_DAYLIGHT_K = 4000.0, 25_000.0
COOLEST_K, HOTTEST_K = 500.0, 100_000.0  # of a blackbody that lights a scene


def grid_nm(first_nm: float, last_nm: float) -> np.ndarray:
    """Return the wavelengths of the grid from one to another, nm: `WAVELENGTHS_NM` at least.

    Multiples of `STEP_NM` within `SHORTEST_NM` and `LONGEST_NM`.
    """
    first = min(math.ceil(max(first_nm, SHORTEST_NM) / STEP_NM) * STEP_NM, WAVELENGTHS_NM[0])
    last = max(math.floor(min(last_nm, LONGEST_NM) / STEP_NM) * STEP_NM, WAVELENGTHS_NM[-1])
    return np.arange(first, last + 1, STEP_NM)


ALL_NM = grid_nm(SHORTEST_NM, LONGEST_NM)
"""All wavelengths that light may be computed at."""


def seen_by_eye(wavelengths_nm: np.ndarray) -> slice:
    """Return where `WAVELENGTHS_NM` lie in a grid that `grid_nm` made."""
    first = int(np.searchsorted(wavelengths_nm, WAVELENGTHS_NM[0]))
    return slice(first, first + WAVELENGTHS_NM.size)


# Tables of charts' patches, and what they are called.
CHECKERS = {"colorchecker": "ColorChecker", "colorchecker-sg": "ColorChecker SG"}


@cache
def _table(name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return wavelengths (K,) and the columns of a table by name, read-only; empty ones are NaN."""
    text = (files("gpusim") / "data" / "spectra" / f"{name}.csv").read_text(encoding="utf-8")
    header, *rows = [line for line in text.splitlines() if not line.startswith("#")]
    values = np.array([[cell or "nan" for cell in row.split(",")] for row in rows], np.float64)
    if not np.array_equal(values[:, 0], grid_nm(*values[[0, -1], 0])):
        raise ValueError(f"{name}.csv: the rows are not wavelengths of the grid")
    values.flags.writeable = False
    return values[:, 0], dict(zip(header.split(",")[1:], values.T[1:], strict=True))


def _columns(name: str, wavelengths_nm: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of a table at wavelengths; beyond its ends as at these."""
    known, columns = _table(name)
    return {key: np.interp(wavelengths_nm, known, one) for key, one in columns.items()}


def _table_ends_nm(name: str) -> tuple[float, float]:
    return tuple(_table(name)[0][[0, -1]].tolist())


def illuminant(name: str, wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> np.ndarray:
    """Return the relative spectral power of a CIE illuminant or a blackbody.

    Parameters
    ----------
    name : str
        ``"D50"``, ``"D65"``, ``"A"``, ``"FL2"``, ``"LED-B3"``, ...; a temperature, ``"5100K"``,
        for Planck's law; ``"D57"`` or ``"D5700K"`` for CIE daylight; or a file: see
        `gpusim.scene.spd.read_spectrum`.
    wavelengths_nm : ndarray (K,)

    Returns
    -------
    ndarray (K,)
        Relative: the scale is the table's own. Beyond `illuminant_known` as at its ends.

    Raises
    ------
    UserError
        For a name that is not in the table, a temperature out of range, or a file that holds no
        spectrum or none that is seen.
    """
    wavelengths = np.asarray(wavelengths_nm, np.float64)
    if is_spectrum(name):
        return on_grid(*_lamp(Path(name)), wavelengths, STEP_NM)
    if (kelvin := _kelvin(name)) is not None:
        return _planck(wavelengths, kelvin, SECOND_RADIATION_M_K)
    known, table = _table("illuminants")
    if name not in table and (kelvin := _daylight_kelvin(name)) is not None:
        return _daylight(wavelengths, kelvin)
    if name not in table:
        raise UserError(
            "unknown illuminant",
            field="illuminant",
            value=name,
            allowed=f"{', '.join(table)}, a blackbody by its temperature: 5100K, daylight: D57 or "
            f"D5700K, or a file: {FORMATS}",
        )
    there = np.isfinite(table[name])
    found = np.interp(wavelengths, known[there], table[name][there])
    if name == "A":  # the table has the CIE's own digits, the formula all wavelengths
        found = np.where(wavelengths > known[there][-1], _illuminant_a(wavelengths), found)
    return found


def _lamp(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return a light's wavelengths and power from a file; refuse one that is dark to the eye."""
    nm, power = read_spectrum(path, "the illuminant")
    seen = (nm > WAVELENGTHS_NM[0]) & (nm < WAVELENGTHS_NM[-1])
    if not power[seen].any():
        raise UserError(
            "the illuminant is dark to the eye", file=path, value=f"{nm[0]:g} to {nm[-1]:g} nm",
            allowed="power between 400 and 700 nm",
        )  # fmt: skip
    return nm, power


def _kelvin(name: str) -> float | None:
    """Return the temperature that a name means; None for one that means none."""
    found = _KELVIN.fullmatch(name)
    if found is None:
        return None
    kelvin = float(found[1])
    if not COOLEST_K <= kelvin <= HOTTEST_K:
        raise UserError(
            "no blackbody of that temperature lights a scene",
            field="illuminant",
            value=name,
            allowed=f"{COOLEST_K:g}K to {HOTTEST_K:g}K",
        )
    return kelvin


def _daylight_kelvin(name: str) -> float | None:
    """Return the temperature of a CIE daylight's name; None for one that means none."""
    found = _DAYLIGHT.fullmatch(name)
    if found is None:
        return None
    kelvin = float(found[2] or 100 * float(found[1]))
    if not COOLEST_DAYLIGHT_K <= kelvin <= HOTTEST_DAYLIGHT_K:
        raise UserError(
            "the CIE has no daylight of that temperature",
            field="illuminant",
            value=name,
            allowed=f"D{COOLEST_DAYLIGHT_K:g}K to D{HOTTEST_DAYLIGHT_K:g}K, or D40 to D250",
        )
    return kelvin if found[2] else kelvin * _DAYLIGHT_C2_RATIO


def _daylight(wavelengths_nm: np.ndarray, kelvin: float) -> np.ndarray:
    """Return CIE daylight, 100 at 560 nm (CIE 015:2018, eq. 4.4 to 4.8)."""
    if kelvin <= 7000:
        terms = -4.6070e9, 2.9678e6, 0.09911e3, 0.244063
    else:
        terms = -2.0064e9, 1.9018e6, 0.24748e3, 0.237040
    x = float(np.polyval(terms, 1 / kelvin))
    y = -3.000 * x**2 + 2.870 * x - 0.275
    below = 0.0241 + 0.2562 * x - 0.7341 * y
    # The CIE rounds both to three decimals.
    first = round((-1.3515 - 1.7703 * x + 5.9114 * y) / below, 3)
    second = round((0.0300 - 31.4424 * x + 30.0717 * y) / below, 3)
    parts = _columns("daylight", wavelengths_nm)
    return parts["S0"] + first * parts["S1"] + second * parts["S2"]


def _planck(wavelengths_nm: np.ndarray, kelvin: float, c2_m_k: float) -> np.ndarray:
    """Return Planck's law, 100 at 560 nm: lambda^-5 / (exp(c2 / (lambda T)) - 1)."""
    scale = c2_m_k * 1e9 / kelvin
    at_unit = math.expm1(scale / _A_UNIT_NM)
    return 100 * (_A_UNIT_NM / wavelengths_nm) ** 5 * at_unit / np.expm1(scale / wavelengths_nm)


def _illuminant_a(wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return CIE illuminant A by its formula (CIE 015:2018, eq. 4.1)."""
    return _planck(wavelengths_nm, _A_KELVIN, _A_C2_M_K)


def illuminant_known(name: str) -> Known:
    """Return over which wavelengths an illuminant is defined: A, E and blackbodies over all."""
    if is_spectrum(name):
        return Known(f"illuminant {Path(name).name}", *_lamp(Path(name))[0][[0, -1]].tolist())
    if _kelvin(name) is not None or name in ("A", "E"):
        return Known(f"illuminant {name}", 0.0, math.inf)
    known, table = _table("illuminants")
    if name not in table:
        return Known(f"illuminant {name}", *_table_ends_nm("daylight"))
    first, *_, last = known[np.isfinite(table[name])].tolist()
    return Known(f"illuminant {name}", first, last)


def colorchecker(wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> dict[str, np.ndarray]:
    """Return the reflectances (K,) of the 24 ColorChecker patches, in reading order."""
    return _columns("colorchecker", wavelengths_nm)


def patch_names() -> tuple[str, ...]:
    """Return the patches that charts may name.

    The ColorChecker's 24, and the 140 of its Digital SG: "SG A1" to "SG N10".
    """
    return tuple(name for table in CHECKERS for name in _table(table)[1])


def patch_reflectance(name: str, wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> np.ndarray:
    """Return the reflectance (K,) of a patch; beyond the table's ends as at these."""
    known, columns = _table(_checker(name))
    return np.interp(wavelengths_nm, known, columns[name])


def patch_known(name: str) -> Known:
    """Return over which wavelengths a patch was measured."""
    table = _checker(name)
    return Known(f"the {CHECKERS[table]}'s reflectances", *_table_ends_nm(table))


def _checker(patch: str) -> str:
    return next(table for table in CHECKERS if patch in _table(table)[1])


def colour_matching() -> np.ndarray:
    """Return the colour-matching functions of the CIE 1931 2-degree observer, ndarray (3, 61)."""
    return np.stack(list(_table("cie_1931_2deg")[1].values()))


def rgb_reflectances(wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> np.ndarray:
    """Return the basis reflectances of linear Rec.709 red, green and blue, ndarray (3, K).

    Their sum is 1 to 1e-5 at each wavelength, and under D65 they reproduce the RGB that weighs them
    (Mallett and Yuksel 2019).
    """
    return np.stack(list(_columns("mallett_2019", wavelengths_nm).values()))


def rgb_nodes(
    table: str, wavelengths_nm: np.ndarray = WAVELENGTHS_NM
) -> tuple[np.ndarray, np.ndarray]:
    """Return linear Rec.709 colours (N, 3) whose largest component is 1; and reflectances (N, K).

    Parameters
    ----------
    table : str
        "jakob_2019" (Jakob and Hanika 2019) or "smits_1999" (Smits 1999).
    wavelengths_nm : ndarray (K,)
    """
    columns = _columns(table, wavelengths_nm)
    nodes = np.array([[float(one) for one in name.split()] for name in columns])
    return nodes, np.stack(list(columns.values()))


def rgb_known(table: str | None = None) -> Known:
    """Return over which wavelengths these are defined; without a table, the basis of three."""
    names = {"jakob_2019": "Jakob and Hanika", "smits_1999": "Smits"}
    who = names.get(table, "Mallett and Yuksel")
    return Known(f"the spectra made of RGB ({who})", *_table_ends_nm(table or "mallett_2019"))


def xyz(radiance: np.ndarray, wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> np.ndarray:
    """Return absolute tristimulus values.

    X = K_m int L(lambda) xbar(lambda) dlambda and so on (CIE 015:2018), here over 400-700 nm.

    Parameters
    ----------
    radiance : ndarray (..., K)
        Spectral radiance, W m^-2 sr^-1 nm^-1.
    wavelengths_nm : ndarray (K,)
        As `grid_nm` returns them.

    Returns
    -------
    ndarray (..., 3)
        X, Y, Z; Y is the luminance in cd/m^2.
    """
    weights = MAXIMUM_LUMINOUS_EFFICACY_LM_PER_W * colour_matching() * QUADRATURE_NM
    return np.asarray(radiance, np.float64)[..., seen_by_eye(wavelengths_nm)] @ weights.T


def luminance_cd_m2(
    radiance: np.ndarray, wavelengths_nm: np.ndarray = WAVELENGTHS_NM
) -> np.ndarray:
    """Return the luminance (...), cd/m^2, of spectral radiance (..., K), W m^-2 sr^-1 nm^-1."""
    return xyz(radiance, wavelengths_nm)[..., 1]


def white_radiance(
    illuminant_name: str,
    white_luminance_cd_m2: float,
    wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
) -> np.ndarray:
    """Return the spectral radiance of a perfect diffuser under an illuminant.

    Parameters
    ----------
    illuminant_name, wavelengths_nm
        As for `illuminant`.
    white_luminance_cd_m2 : float
        Luminance of the diffuser, cd/m^2.

    Returns
    -------
    ndarray (K,)
        W m^-2 sr^-1 nm^-1.
    """
    scale = white_luminance_cd_m2 / luminance_cd_m2(illuminant(illuminant_name))
    return illuminant(illuminant_name, wavelengths_nm) * scale
