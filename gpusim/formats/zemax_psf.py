"""Zemax's text exports of PSFs: how they are read, and laid on the grid of a bank.

A PSF export (window's Text tab) has lines of this kind, then the values row by row:

    Listing of Huygens PSF Data
    0.5500 um at 0.0000, 14.0000 (deg).      wavelength, field x and y
    Data spacing is 0.250 um.
    Image grid size: 128 by 128
    Center point is: 65, 65                  row and column, from 1
    Center coordinates : 0.0000E+000, 1.2466E+001 Millimeters
    Values are relative intensity.

Rows are taken to run from +y at the top to -y, columns from -x to +x, as the program draws a PSF.
(Its arrays begin at the lower left and must be turned over to be drawn: Ansys Zemax community,
topic 5426. No text says that the listing is as drawn: where one's coma points the wrong way,
``first_row: "-y"`` turns it.) A field lies on the y axis; which side of the image it lands on is
the sign of the centre's y, where there is none the field's. So a PSF can be turned until the radial
direction is that of the bank.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from gpusim.errors import UserError
from gpusim.formats.contract import MAX_SIZE
from gpusim.formats.text import decoded
from gpusim.formats.zemax_units import MILLIMETRES, NUMBER, UM

FirstRow = Literal["+y", "-y"]


@dataclass(frozen=True)
class PsfExport:
    """One PSF as exported.

    Attributes
    ----------
    wavelength_nm : float
    field : float
        Along y, in the unit of the file.
    field_step : float
        The last digit in which it is printed.
    field_unit : str
        "deg" or a length.
    spacing_um : float
    centre : (float, float)
        Row and column of the reference point, from 0.
    centre_y_mm : float or None
        Where the reference point lies on the image plane.
    values : ndarray (n, n)
        Row 0 at +y.
    """

    wavelength_nm: float
    field: float
    field_step: float
    field_unit: str
    spacing_um: float
    centre: tuple[float, float]
    centre_y_mm: float | None
    values: np.ndarray

    @property
    def side(self) -> int:
        """1 where it lands at +y, -1 at -y."""
        height = self.centre_y_mm or self.field
        return -1 if height < 0 else 1


def parse_psf(content: bytes, file: Path) -> PsfExport:
    """Read one export of a PSF.

    Raises
    ------
    UserError
        Where the file is no such export, polychromatic, off the y axis or not whole.
    """
    head, marker, body = decoded(content).partition("Values are")
    if not (re.match(r"\s*Listing of [^\n]*PSF Data", head) and marker):
        raise UserError(
            "not a Zemax PSF export",
            file=file,
            allowed='a text that begins with "Listing of FFT PSF Data" or "Huygens PSF Data"',
        )

    def found(pattern: str, what: str) -> re.Match:
        match = re.search(pattern, head, re.IGNORECASE)
        if match is None:
            raise UserError(f"the export does not give the {what}", file=file, field=what)
        return match

    line = found(
        rf"({NUMBER})(?:\s+to\s+({NUMBER}))?\s*{UM}\s+at\s+({NUMBER})(?:\s*,\s*({NUMBER}))?"
        r"\s*\(?([a-z]+)",
        "wavelength and field",
    )
    um, along_y, unit = _place(line, file)
    size = _size(*found(r"Image grid size:\s*(\d+)\s+by\s+(\d+)", "image grid size").groups(), file)
    centre = found(
        r"Center point is:?\s*(?:row\s*)?(\d+),\s*(?:column\s*)?(\d+)", "centre point"
    ).groups()
    spacing = found(rf"Data spacing is\s+({NUMBER})\s*{UM}", "data spacing")[1]
    if not float(spacing) > 0:
        raise UserError(
            "the data spacing is wrong",
            file=file,
            field="data spacing",
            value=spacing,
            allowed="> 0",
        )
    return PsfExport(
        wavelength_nm=1e3 * float(um),
        field=float(along_y),
        field_step=10.0 ** -len(along_y.partition(".")[2]),
        field_unit=unit.lower(),
        spacing_um=float(spacing),
        centre=(int(centre[0]) - 1, int(centre[1]) - 1),
        centre_y_mm=_centre_y_mm(head, file),
        values=_values(body, size, file),
    )


def _place(line: re.Match, file: Path) -> tuple[str, str, str]:
    """Return wavelength, um, field along y and its unit, of the line that says them."""
    low, high, first, second, unit = line.groups()
    if high is not None and float(high) != float(low):
        raise UserError(
            "a polychromatic PSF cannot be used",
            file=file,
            field="wavelength",
            value=f"{low} to {high} um",
            allowed="one wavelength in each export",
        )
    if second is not None and float(first) != 0:
        raise UserError(
            "the field lies off the y axis", file=file, field="field x", value=first, allowed="0"
        )
    return low, first if second is None else second, unit


def _size(rows: str, cols: str, file: Path) -> int:
    """Return the samples across a square grid."""
    if int(rows) != int(cols) or not 16 <= int(rows) <= 4 * MAX_SIZE:
        raise UserError(
            "this grid of samples is not read",
            file=file,
            field="image grid size",
            value=f"{int(rows)} by {int(cols)}",
            allowed=f"square, 16 to {4 * MAX_SIZE}",
        )
    return int(rows)


def _centre_y_mm(head: str, file: Path) -> float | None:
    """Return where the reference point lies on the image plane; None where the export says not."""
    place = re.search(
        rf"(?:Center|Reference) Coordinates\s*:\s*({NUMBER})\s*,\s*({NUMBER})\s*([a-z]*)",
        head,
        re.IGNORECASE,
    )
    if place is None:
        return None
    scale = MILLIMETRES.get(place[3].lower() or "millimeters")
    if scale is None:
        raise UserError(
            "this unit of length is not known",
            file=file,
            field="centre coordinates",
            value=place[3],
            allowed=", ".join(MILLIMETRES),
        )
    return scale * float(place[2])


def _values(body: str, size: int, file: Path) -> np.ndarray:
    """Return the values (n, n) after the line that says what they are."""
    words = body.partition("\n")[2].split()
    try:
        values = np.array(words, dtype=float)
    except ValueError as error:
        raise UserError(f"a value is not a number: {error}", file=file, field="values") from error
    if values.size != size**2:
        raise UserError(
            "the export is not whole",
            file=file,
            field="values",
            value=f"{values.size} values",
            allowed=f"{size} x {size} = {size**2}",
        )
    if not np.isfinite(values).all() or values.min() < 0 or values.max() <= 0:
        raise UserError(
            "these values are no intensities",
            file=file,
            field="values",
            value=f"{values.min():g} to {values.max():g}",
            allowed="0 or more, not all 0",
        )
    return values.reshape(size, size)


def turned(
    export: PsfExport, pitch_um: float, size: int, first_row: FirstRow, outwards_um: float = 0.0
) -> np.ndarray:
    """Return a PSF on the bank's grid: [sagittal, tangential], centred on the chief ray.

    Parameters
    ----------
    export : PsfExport
    pitch_um : float
    size : int
        n, even.
    first_row : "+y" or "-y"
        Where the rows of the export begin.
    outwards_um : float
        How far the export's reference point lies outside the chief ray.

    Returns
    -------
    ndarray (n, n)
        By splines of degree 5 (their error is below that of the printed digits where Nyquist's
        frequency is half as high again as the PSF's last), 0 beyond the exported window.
    """
    from scipy.ndimage import map_coordinates

    at = (np.arange(size) - size // 2) * pitch_um
    tangential, sagittal = at[None, :] - outwards_um, at[:, None]
    # Seen with x to the right and y down, sagittal is tangential turned from x towards y: for a
    # field above the axis tangential points up and sagittal to the right; below, down and left.
    upwards = -1 if first_row == "+y" else 1
    row = export.centre[0] + upwards * export.side * tangential / export.spacing_um
    col = export.centre[1] + export.side * sagittal / export.spacing_um
    where = np.broadcast_arrays(row, col)
    return map_coordinates(export.values, where, order=5, mode="grid-constant")


def common_grid(exports: list[PsfExport]) -> tuple[float, int]:
    """Return the finest spacing of the exports, and the samples that cover the widest of them."""
    pitch_um = min(export.spacing_um for export in exports)
    widest = max(len(export.values) * export.spacing_um for export in exports)
    return pitch_um, 2 * int(np.ceil(widest / pitch_um / 2 - 1e-9))


def check_size(size: int, pitch_um: float, file: Path) -> None:
    """Refuse a common grid that is too large."""
    if size > MAX_SIZE:
        raise UserError(
            "the PSFs do not fit a common grid",
            file=file,
            field="data spacing",
            value=f"{size} samples of {pitch_um:g} um",
            allowed=f"{MAX_SIZE} samples: export all PSFs with the same spacing and area",
        )
