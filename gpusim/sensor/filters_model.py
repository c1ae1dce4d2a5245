"""Filters in front of the sensor or the lens, infra-red cut and others: what they pass."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from pydantic import ValidationInfo, model_validator

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict, wrong
from gpusim.config.text import read_text
from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.strict import NotNegative, Positive, check_grid


class Filter(Strict):
    """What a filter passes at normal incidence, straight between the wavelengths given.

    Attributes
    ----------
    name : str
    wavelengths_nm : tuple of float
        Rising, over all of the grid of spectra.
    transmission : tuple of float
        Share of the light, 0 to 1. In a file `file: NAME.csv` may stand for both lists: a line for
        each wavelength, nm and transmission with a comma between, and `#` before remarks.
    """

    name: str
    wavelengths_nm: tuple[Positive, ...]
    transmission: tuple[NotNegative, ...]

    @model_validator(mode="before")
    @classmethod
    def _from_file(cls, data: object, info: ValidationInfo) -> object:
        if not isinstance(data, dict) or "file" not in data:
            return data
        if clash := {"wavelengths_nm", "transmission"} & data.keys():
            raise wrong(f"both file and {', '.join(sorted(clash))}", "one or the other")
        path = (info.context or {}).get("folder", Path()) / str(data["file"])
        grid, curve = read_spectrum(path)
        rest = {name: value for name, value in data.items() if name != "file"}
        return {"name": path.stem, **rest, "wavelengths_nm": grid, "transmission": curve}

    @model_validator(mode="after")
    def _on_the_grid(self) -> Filter:
        check_grid(self.wavelengths_nm)
        if len(self.transmission) != len(self.wavelengths_nm):
            raise wrong(
                f"filter {self.name} has {len(self.transmission)} values",
                f"{len(self.wavelengths_nm)}, as wavelengths",
            )
        if (most := max(self.transmission)) > 1:
            warnings.warn(f"transmission of filter {self.name} exceeds 1: {most:g}", stacklevel=2)
        return self


def read_spectrum(path: Path) -> tuple[list[float], list[float]]:
    """Read wavelengths, nm, and what belongs to them from a table of two columns.

    Raises
    ------
    UserError
        Where the file cannot be read, or a line is not two numbers that are not negative.
    """
    lines = read_text(path, "the spectrum").splitlines()
    rows = []
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        try:
            row = [float(part) for part in text.split(",")]
        except ValueError:
            row = []
        if len(row) != 2 or not all(math.isfinite(value) and value >= 0 for value in row):
            raise UserError(
                "a line of the spectrum is wrong",
                file=path,
                field=f"line {number}",
                value=text,
                allowed="wavelength in nm and value, a comma between: 550, 0.98",
            )
        rows.append(row)
    return [row[0] for row in rows], [row[1] for row in rows]


def passed(filters: Iterable[Filter], wavelengths_nm: np.ndarray = WAVELENGTHS_NM) -> np.ndarray:
    """Return what filters one behind the other pass (K,), beyond their data as at its ends."""
    product = np.ones(len(wavelengths_nm))
    for one in filters:
        product *= np.interp(wavelengths_nm, one.wavelengths_nm, one.transmission)
    return product


class _Filters(Strict):
    """Filters of a camera file, with the name that they have in a sensor's."""

    filters: tuple[Filter, ...]


def load_filters(data: object, path: Path) -> tuple[Filter, ...]:
    """Return the filters in front of a lens, of a camera file that lies at a path.

    Raises
    ------
    UserError
        A wrong field, or a spectrum that cannot be read.
    """
    return checked(_Filters, {"filters": data}, path, folder=path.parent).filters
