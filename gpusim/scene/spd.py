"""Spectra from files: two columns of text, JSON, or IES TM-27's XML."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gpusim.config.text import MOST_TEXT_BYTES, read_bytes, read_json, read_text
from gpusim.errors import UserError

TEXT, JSON, TM27 = (".csv", ".txt", ".spd", ".tsv"), (".json",), (".spdx", ".xml")
SUFFIXES = (*TEXT, *JSON, *TM27)
FORMATS = "wavelength in nm and value by line (.csv, .txt), JSON, or IES TM-27 (.spdx)"
SHORTEST_NM, LONGEST_NM = 100.0, 1e4
MOST_VALUES = 100_000
COLUMNS = ("wavelengths_nm", "values")  # of JSON


def is_spectrum(name: str) -> bool:
    """Return whether a name is that of a file with a spectrum."""
    return Path(name).suffix.lower() in SUFFIXES


def read_spectrum(path: Path, what: str, most: float = 1e30) -> tuple[np.ndarray, np.ndarray]:
    """Read a spectrum.

    Parameters
    ----------
    path : Path
        Text with two numbers a line, parted by commas or blanks, after a heading or none, ``#``
        before remarks; JSON, ``{"wavelengths_nm": [...], "values": [...]}`` or
        ``{"400": 0.1, ...}``; or XML of ANSI/IES TM-27-14 with its elements SpectralData.
    what : str
        What it should be: "the reflectance".
    most : float
        The most that a value may be.

    Returns
    -------
    wavelengths_nm, values : ndarray (K,)
        Wavelengths rise.

    Raises
    ------
    UserError
        Where it cannot be read, a value is negative or too large, or the wavelengths do not rise.
    """
    suffix = path.suffix.lower()
    read = _xml if suffix in TM27 else _json if suffix in JSON else _text
    rows = read(path, what)
    for place, nm, value in rows:
        if not (SHORTEST_NM <= nm <= LONGEST_NM and 0 <= value <= most):
            raise UserError(
                f"{what} is no spectrum",
                file=path,
                field=place,
                value=f"{nm:g}, {value:g}",
                allowed=f"{SHORTEST_NM:g} to {LONGEST_NM:g} nm, and 0 to {most:g}",
            )
    falls = next((b[0] for a, b in pairwise(rows) if b[1] <= a[1]), None)
    if len(rows) < 2 or len(rows) > MOST_VALUES or falls is not None:
        raise UserError(
            f"{what} is no spectrum",
            file=path,
            field=falls,
            value=f"{len(rows)} values",
            allowed=f"2 to {MOST_VALUES:,}, wavelengths rising; {FORMATS}",
        )
    _, nm, values = zip(*rows, strict=True)
    return np.array(nm, np.float64), np.array(values, np.float64)


Rows = list[tuple[str, float, float]]  # place, wavelength, value


def _text(path: Path, what: str) -> Rows:
    rows: Rows = []
    for number, line in enumerate(read_text(path, what).splitlines(), start=1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        cells = line.replace(",", " ").replace(";", " ").split()
        try:
            nm, value = (float(cell) for cell in cells)
        except ValueError:
            if not rows and not cells[0][:1].isdigit():
                continue  # a heading
            raise UserError(
                f"{what} has a line that is none of a spectrum",
                file=path,
                field=f"line {number}",
                value=line,
                allowed="wavelength in nm, value",
            ) from None
        rows.append((f"line {number}", nm, value))
    return rows


def _json(path: Path, what: str) -> Rows:
    data = read_json(path, what)
    try:
        if set(data) == set(COLUMNS):
            pairs = list(zip(*(data[name] for name in COLUMNS), strict=True))
        else:
            pairs = sorted((float(nm), value) for nm, value in data.items())
        if any(isinstance(one, bool | str) for pair in pairs for one in pair):
            raise ValueError
        return [(f"value {k}", float(nm), float(one)) for k, (nm, one) in enumerate(pairs, 1)]
    except (TypeError, ValueError, AttributeError, OverflowError):
        raise UserError(
            f"{what} is JSON of another kind",
            file=path,
            allowed='{"wavelengths_nm": [400, ...], "values": [0.1, ...]}, or {"400": 0.1, ...}',
        ) from None


def _xml(path: Path, what: str) -> Rows:
    content = read_bytes(path, what, MOST_TEXT_BYTES)
    try:
        if b"<!" in content.replace(b"<!--", b""):  # entities may grow without end
            raise ValueError("a DOCTYPE or an entity: none is read")
        rows: Rows = []
        for one in ElementTree.fromstring(content).iter():
            if str(one.tag).rpartition("}")[2] == "SpectralData":
                nm = float(one.get("wavelength", "nan"))
                rows.append((f"SpectralData {len(rows) + 1}", nm, float(one.text or "nan")))
        return rows
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise UserError(
            f"{what} is not XML of IES TM-27: {error}", file=path,
            allowed='<SpectralData wavelength="400">0.1</SpectralData>',
        ) from None  # fmt: skip


def on_grid(
    nm: np.ndarray, values: np.ndarray, wavelengths_nm: np.ndarray, step_nm: float
) -> np.ndarray:
    """Return a spectrum at wavelengths, beyond its ends as at these.

    A finer one is averaged by a triangle of a step to either side: lines between two wavelengths
    are shared by both, and none is lost.
    """
    if np.diff(nm).min() >= step_nm * (1 - 1e-9):
        return np.interp(wavelengths_nm, nm, values)
    # The integral of what is straight between the values, and that of its integral, exactly; by
    # these the triangle's mean is a second difference.
    first, last = wavelengths_nm[0] - step_nm, wavelengths_nm[-1] + step_nm
    at = np.unique(np.concatenate([nm, [first, last]]))
    at = np.concatenate([at, wavelengths_nm, wavelengths_nm - step_nm, wavelengths_nm + step_nm])
    at = np.unique(at)
    power = np.interp(at, nm, values)
    wide = np.diff(at)
    once = np.concatenate([[0.0], np.cumsum(wide * (power[1:] + power[:-1]) / 2)])
    # `twice` is a cubic, whose slope is `once` and whose curvature runs straight.
    rise = wide * once[:-1] + wide**2 * (power[:-1] / 3 + power[1:] / 6)
    twice = np.concatenate([[0.0], np.cumsum(rise)])
    below, here, above = (
        twice[np.searchsorted(at, wavelengths_nm + off)] for off in (-step_nm, 0.0, step_nm)
    )
    found = (below - 2 * here + above) / step_nm**2
    return np.maximum(found, 0.0)  # where it is dark, differences round below it
