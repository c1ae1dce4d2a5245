"""Zemax's text exports of grid distortion: where the chief rays of a wavelength land."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.formats.text import decoded
from gpusim.formats.zemax_units import MILLIMETRES, NUMBER, UM

# A distortion grid whose points of one ideal height land at heights this far apart is of a lens
# without symmetry.
SYMMETRY_UM = 1.0


def parse_distortion(content: bytes, file: Path) -> tuple[float, np.ndarray, np.ndarray]:
    """Read one export of grid distortion.

    Returns
    -------
    wavelength_nm : float
    ideal_um, real_um : ndarray (P,)
        Predicted and real distances from the axis, rising in the first; one point for each
        predicted distance.
    """
    text = decoded(content)
    head, marker, body = text.partition("Predicted X")
    wavelength = re.search(rf"Wavelength\s*:\s*({NUMBER})\s*{UM}", head)
    unit = re.search(r"Units are\s+([A-Za-z]+)", head)
    if not (head.lstrip().startswith("Listing of Grid Distortion") and marker and wavelength):
        raise UserError(
            "not a Zemax grid-distortion export",
            file=file,
            allowed='a text that begins with "Listing of Grid Distortion Data"',
        )
    scale = MILLIMETRES.get(unit[1].lower()) if unit else None
    if scale is None:
        raise UserError(
            "this unit of length is not known",
            file=file,
            field="Units are",
            value=unit[1] if unit else "nothing",
            allowed=", ".join(MILLIMETRES),
        )
    table = 1e3 * scale * _table(body, file)
    ideal, real = np.hypot(table[:, 0], table[:, 1]), np.hypot(table[:, 2], table[:, 3])
    if not np.isfinite(table).all():
        raise UserError("a value is not a number", file=file)
    # Points of one ideal height to a nanometre: the same to the digits that are printed.
    place = np.unique(np.round(ideal, 3), return_inverse=True)[1]
    count = np.bincount(place)
    mean = np.bincount(place, real) / count
    spread = np.abs(real - mean[place]).max()
    if spread > SYMMETRY_UM:
        raise UserError(
            "the distortion is not symmetric about the axis",
            file=file,
            field="Real X, Real Y",
            value=f"points of one predicted height land {spread:.3g} um apart",
            allowed=f"at most {SYMMETRY_UM:g} um: lenses without symmetry are not read",
        )
    return 1e3 * float(wavelength[1]), np.bincount(place, ideal) / count, mean


def _table(text: str, file: Path) -> np.ndarray:
    """Return predicted x and y and real x and y (P, 4) of a grid's points, in the file's unit."""
    rows = []
    for line in text.splitlines()[1:]:
        words = line.replace("%", " ").split()
        if len(words) < 9 or re.fullmatch(r"-?\d+", words[0]) is None:
            if rows and words:
                break  # the summary after the table
            continue
        try:
            rows.append([float(word) for word in words[5:9]])
        except ValueError as error:
            raise UserError(f"a value is not a number: {error}", file=file) from error
    if len(rows) < 9:
        raise UserError(
            "the export is not whole", file=file, value=f"{len(rows)} points", allowed="9 or more"
        )
    return np.array(rows)
