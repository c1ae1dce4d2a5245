"""``.spectrum`` files of Speos: curves over the wavelength.

Such a file holds a header, the number of samples, and a line ``wavelength value`` for each, nm and
per cent, or 0 to 1 where the key's ``Unit`` says so. A file whose values contradict its unit is
refused: one of them is off by a factor of 100.
"""

from __future__ import annotations

from pathlib import Path, PureWindowsPath

import numpy as np

from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.formats.speos_values import mapping, only, unit_error

PERCENT, UNITY = ("percentage",), ("0 to 1", "o to 1", "[0;1]")
Curve = tuple[np.ndarray, np.ndarray]  # wavelengths in nm, rising; values


def spectrum_of(file: Path, value: object, field: str) -> Curve:
    """Return the curve that a key names, as fractions of 1."""
    named = mapping(file, value if isinstance(value, dict) else {"filename": value}, field)
    only(file, field, named, ("filename", "unit"))
    unit = str(named.get("unit", PERCENT[0])).strip().lower()
    if unit not in PERCENT + UNITY:
        raise unit_error(file, field, unit, ("Percentage", "0 to 1"))
    name = str(named.get("filename"))
    windows = PureWindowsPath(name)
    places = (file.parent / windows.as_posix(), file.parent / windows.name)
    spectrum = next((place for place in places if place.is_file()), None)
    if spectrum is None:
        raise UserError(
            "the spectrum is not there",
            file=file,
            field=field,
            value=name,
            allowed=f"a .spectrum file, as named or beside {file.name}",
        )
    wavelengths, values = read_spectrum(spectrum)
    most = float(values.max())
    if unit in UNITY:
        if most > 1.5:
            raise UserError(
                "the spectrum is not in 0 to 1: perhaps per cent is meant",
                file=spectrum,
                field=f"{field}.Unit",
                value=f"values up to {most:g}",
                allowed="values of 0 to 1, or Unit: Percentage",
            )
        return wavelengths, values
    if 0 < most <= 1:
        raise UserError(
            "the spectrum is hardly in per cent: perhaps 0 to 1 is meant",
            file=spectrum,
            field=f"{field}.Unit",
            value=f"values up to {most:g}",
            allowed="values of 0 to 100, or Unit: 0 to 1",
        )
    return wavelengths, values / 100


def read_spectrum(file: Path) -> Curve:
    """Read a ``.spectrum`` file: wavelengths in nm, rising, and its values as they stand.

    Raises
    ------
    UserError
        The file holds no samples, not as many as it says, none or negative numbers, or wavelengths
        that do not rise.
    """
    samples: list[tuple[float, float]] = []
    count = None
    lines = read_bytes(file, "the spectrum").decode("utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) == 2:
            samples.append((values[0], values[1]))
        elif len(values) == 1 and not samples:
            count = values[0]
        elif samples and words:
            raise UserError(
                "a line is no sample",
                file=file,
                field=f"line {number}",
                value=line.strip(),
                allowed="a wavelength in nm and a value",
            )
    if not samples or (count is not None and count != len(samples)):
        raise UserError(
            "the spectrum is not complete",
            file=file,
            field="number of samples",
            value=len(samples),
            allowed="one or more" if count is None else f"{count:g}, as the file says",
        )
    wavelengths, found = np.array(samples).T
    good = np.isfinite(found) & (found >= 0)
    if not good.all():
        raise UserError(
            "the spectrum has a value that is none",
            file=file,
            field=f"at {wavelengths[np.argmin(good)]:g} nm",
            value=found[np.argmin(good)],
            allowed="0 or more",
        )
    if not np.all(np.diff(wavelengths) > 0):
        raise UserError(
            "the wavelengths do not rise", file=file, allowed="each more than the one before"
        )
    return wavelengths, found


def common_grid(curves: list[Curve]) -> np.ndarray:
    """Return all wavelengths of some curves in the range that all of them have."""
    first = max(float(grid[0]) for grid, _ in curves)
    last = min(float(grid[-1]) for grid, _ in curves)
    every = np.unique(np.concatenate([grid for grid, _ in curves]))
    return every[(every >= first) & (every <= last)]
