"""Reader of Zemax's text exports: FFT and Huygens PSFs, and grid distortion.

A bank of them is a YAML file beside the exports:

    title: Triplet f/4
    source: exports of triplet.zmx, OpticStudio 23.1
    efl_mm: 50.0
    f_number: 4.0
    working_f_number: 4.02         # 1 / (2 sin theta') on the axis
    transmission: 0.94             # or one number for each wavelength
    reference_nm: 550              # one of the exports' wavelengths
    field_type: angle              # or: paraxial image height
    relative_illumination: [1.0, 0.93, 0.81]   # fields in rising order; or a list by wavelength
    psf_files: [f0_w1.txt, f0_w2.txt, f1_w1.txt, f1_w2.txt, f2_w1.txt, f2_w2.txt]
    distortion_files: [grid_w1.txt, grid_w2.txt]   # may be left out: see below
    first_row: "+y"                # or "-y": where the exports' rows begin

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

The height of the chief ray at each wavelength comes from the grid distortion of that wavelength;
without ``distortion_files`` from the coordinates of the PSFs' centres ("Center coordinates",
"Reference Coordinates"). Either way the centre of an export is taken for the chief ray: export with
the chief ray as the reference, "Use Centroid" off. Where both are there they must agree, to a
sample and to the digits in which the field is printed.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gpusim.config.mistakes import checked
from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.formats.assemble import (
    Stated,
    make_bank,
    odd_fit,
    per_wavelength,
)
from gpusim.formats.contract import MAX_SIZE
from gpusim.formats.text import decoded
from gpusim.psf.bank import Bank

FirstRow = Literal["+y", "-y"]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
UM = "(?:[µμu]m)"
MILLIMETRES = {"millimeters": 1.0, "centimeters": 10.0, "inches": 25.4, "meters": 1000.0}
SAME_NM = 0.06  # wavelengths are printed to 0.1 nm
# A distortion grid whose points of one ideal height land at heights this far apart is of a lens
# without symmetry.
SYMMETRY_UM = 1.0


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


class ZemaxFile(Stated):
    """Fields of the YAML file beside the exports: see the module."""

    reference_nm: float = Field(gt=0)
    field_type: Literal["angle", "paraxial image height"]
    relative_illumination: tuple[float | tuple[float, ...], ...]
    psf_files: tuple[str, ...] = Field(min_length=1)
    distortion_files: tuple[str, ...] = ()
    first_row: FirstRow = "+y"


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
    low, high, first, second, unit = line.groups()
    along_y = first if second is None else second
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
    rows, cols = map(
        int, found(r"Image grid size:\s*(\d+)\s+by\s+(\d+)", "image grid size").groups()
    )
    if rows != cols or not 16 <= rows <= 4 * MAX_SIZE:
        raise UserError(
            "this grid of samples is not read",
            file=file,
            field="image grid size",
            value=f"{rows} by {cols}",
            allowed=f"square, 16 to {4 * MAX_SIZE}",
        )
    centre = found(
        r"Center point is:?\s*(?:row\s*)?(\d+),\s*(?:column\s*)?(\d+)", "centre point"
    ).groups()
    place = re.search(
        rf"(?:Center|Reference) Coordinates\s*:\s*({NUMBER})\s*,\s*({NUMBER})\s*([a-z]*)",
        head,
        re.IGNORECASE,
    )
    centre_y_mm = None
    if place is not None:
        scale = MILLIMETRES.get(place[3].lower() or "millimeters")
        if scale is None:
            raise UserError(
                "this unit of length is not known",
                file=file,
                field="centre coordinates",
                value=place[3],
                allowed=", ".join(MILLIMETRES),
            )
        centre_y_mm = scale * float(place[2])
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
        wavelength_nm=1e3 * float(low),
        field=float(along_y),
        field_step=10.0 ** -len(along_y.partition(".")[2]),
        field_unit=unit.lower(),
        spacing_um=float(spacing),
        centre=(int(centre[0]) - 1, int(centre[1]) - 1),
        centre_y_mm=centre_y_mm,
        values=_values(body, rows, file),
    )


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
    rows = []
    for line in body.splitlines()[1:]:
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
    table = 1e3 * scale * np.array(rows)
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


def turned(
    export: PsfExport, pitch_um: float, size: int, first_row: FirstRow, outwards_um: float = 0.0
) -> np.ndarray:
    """Return a PSF on the bank's grid: [tangential, radial], centred on the chief ray.

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
    radial, tangential = at[None, :] - outwards_um, at[:, None]
    # Seen with x to the right and y down, tangential is radial turned from x towards y: for a field
    # above the axis radial points up and tangential to the right, for one below down and left.
    upwards = -1 if first_row == "+y" else 1
    row = export.centre[0] + upwards * export.side * radial / export.spacing_um
    col = export.centre[1] + export.side * tangential / export.spacing_um
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


def read_zemax(data: dict[str, object], file: Path) -> Bank:
    """Make the bank of a YAML file that lists exports.

    Raises
    ------
    UserError
        Where an export is missing, is not whole or contradicts another.
    """
    stated = checked(ZemaxFile, data, file)
    exports = []
    for name in stated.psf_files:
        export = parse_psf(read_bytes(file.parent / name, "the PSF export"), file.parent / name)
        exports.append((file.parent / name, export))
    wavelengths = _distinct([export.wavelength_nm for _, export in exports], SAME_NM)
    heights = [abs(_ideal_mm(export, stated, path)) for path, export in exports]
    ideal_mm = _distinct(heights, 1e-6 * max(heights))  # one field is printed alike everywhere
    grid: dict[tuple[int, int], PsfExport] = {}
    for (path, export), height in zip(exports, heights, strict=True):
        cell = (
            int(np.abs(ideal_mm - height).argmin()),
            int(np.abs(wavelengths - export.wavelength_nm).argmin()),
        )
        if cell in grid:
            raise UserError(
                "two exports are of the same field and wavelength",
                file=path,
                field="psf_files",
                value=f"{export.field:g} {export.field_unit}, {export.wavelength_nm:g} nm",
            )
        grid[cell] = export
    for cell in np.ndindex(len(ideal_mm), len(wavelengths)):
        if cell not in grid:
            raise UserError(
                "an export is missing",
                file=file,
                field="psf_files",
                value=f"none at {wavelengths[cell[1]]:g} nm, {ideal_mm[cell[0]]:.4g} mm from the "
                "axis",
                allowed="each field at each wavelength",
            )
    reference = np.abs(wavelengths - stated.reference_nm)
    if reference.min() > SAME_NM:
        raise UserError(
            "the reference wavelength is not one of the exports'",
            file=file,
            field="reference_nm",
            value=stated.reference_nm,
            allowed=", ".join(f"{w:g}" for w in wavelengths),
        )
    centres_um = _centres(grid, (len(ideal_mm), len(wavelengths)))
    if stated.distortion_files:
        real_um = _from_grids(stated, file, wavelengths, 1e3 * ideal_mm)
        chief_rays = "grid-distortion exports"
    elif centres_um is None:
        raise UserError(
            "the heights of the chief rays are missing: not every PSF export gives the "
            "coordinates of its centre",
            file=file,
            field="distortion_files",
            allowed="a grid-distortion export for each wavelength",
        )
    else:
        real_um, chief_rays = centres_um, "centres of the PSF exports"
    illumination = stated.relative_illumination
    if len(illumination) != len(ideal_mm):
        raise UserError(
            "the relative illumination of each field is needed",
            file=file,
            field="relative_illumination",
            value=f"{len(illumination)} fields",
            allowed=f"{len(ideal_mm)}",
        )
    if centres_um is not None:
        _refuse_centroids(grid, centres_um - real_um, stated, file)
    pitch_um, size = common_grid(list(grid.values()))
    check_size(size, pitch_um, file)
    psf = np.stack(
        [
            [turned(grid[f, w], pitch_um, size, stated.first_row) for w in range(len(wavelengths))]
            for f in range(len(ideal_mm))
        ]
    )
    return make_bank(
        stated,
        wavelengths_nm=wavelengths,
        reference_nm=float(wavelengths[reference.argmin()]),
        ideal_height_um=1e3 * ideal_mm,
        real_height_um=real_um,
        psf=psf,
        pitch_um=pitch_um,
        relative_illumination=np.stack(
            [
                per_wavelength(row, len(wavelengths), file, f"relative_illumination.{number}")
                for number, row in enumerate(illumination, start=1)
            ]
        ),
        provenance={
            "object": "as in the lens file of the exports",
            "image_height": "focal length times tan(field angle)"
            if stated.field_type == "angle"
            else "paraxial image height of the exports",
            "chief_ray_heights": chief_rays,
            "psf_orientation": f"rows of an export begin at {stated.first_row}; turned until +x is "
            "radial",
            "psf_centre": "the exports' centre point is the chief ray",
        },
        file=file,
    )


def _distinct(values: list[float], same: float) -> np.ndarray:
    """Return the values that differ by more than the printed digits allow, rising."""
    rising = np.sort(values)
    groups = np.split(rising, np.flatnonzero(np.diff(rising) > same) + 1)
    return np.array([group.mean() for group in groups])


def _ideal_mm(export: PsfExport, stated: ZemaxFile, file: Path) -> float:
    """Return the distortion-free image height of an export's field."""
    is_angle = export.field_unit.startswith("deg")
    if is_angle != (stated.field_type == "angle"):
        raise UserError(
            f"the field of the export is {'an angle' if is_angle else 'a length'}",
            file=file,
            field="field_type",
            value=stated.field_type,
            allowed="angle" if is_angle else "paraxial image height",
        )
    if not is_angle:
        if export.field_unit != "mm":
            raise UserError(
                "this unit of length is not known",
                file=file,
                field="field",
                value=export.field_unit,
                allowed="mm",
            )
        return export.field
    if abs(export.field) >= 89:
        raise UserError(
            "the image height f tan(theta) has no end at this field",
            file=file,
            field="field",
            value=f"{export.field:g} deg",
            allowed="below 89 deg",
        )
    return stated.efl_mm * float(np.tan(np.radians(export.field)))


def _centres(grid: dict[tuple[int, int], PsfExport], shape: tuple[int, int]) -> np.ndarray | None:
    """Return how far from the axis the PSFs' centres lie (F, L), um; None if one does not say."""
    if any(export.centre_y_mm is None for export in grid.values()):
        return None
    centres = np.empty(shape)
    for cell, export in grid.items():
        centres[cell] = 1e3 * abs(export.centre_y_mm)
    return centres


def _refuse_centroids(
    grid: dict[tuple[int, int], PsfExport], offset_um: np.ndarray, stated: ZemaxFile, file: Path
) -> None:
    """Refuse PSFs whose centre lies elsewhere than the chief ray of the distortion grids."""
    for cell, export in grid.items():
        # Half a digit of the field, as a height: d(f tan(theta)) = f / cos(theta)^2 d(theta).
        rounding_um = 500 * export.field_step
        if stated.field_type == "angle":
            theta = np.radians(export.field)
            rounding_um *= stated.efl_mm / np.cos(theta) ** 2 * np.pi / 180
        if abs(offset_um[cell]) > export.spacing_um + rounding_um:
            raise UserError(
                f"the centre of a PSF is not on the chief ray: field {export.field:g} "
                f"{export.field_unit}, {export.wavelength_nm:g} nm",
                file=file,
                field="psf_files",
                value=f"{offset_um[cell]:.3g} um off that of the distortion export",
                allowed="exports of one lens, with the chief ray as reference (Use Centroid off)",
            )


def _from_grids(
    stated: ZemaxFile, file: Path, wavelengths_nm: np.ndarray, ideal_um: np.ndarray
) -> np.ndarray:
    """Return the heights of the chief rays (F, L), um, from the grids of all wavelengths."""
    real_um = np.full((len(ideal_um), len(wavelengths_nm)), np.nan)
    for name in stated.distortion_files:
        path = file.parent / name
        content = read_bytes(path, "the distortion export")
        wavelength, ideal, real = parse_distortion(content, path)
        place = int(np.abs(wavelengths_nm - wavelength).argmin())
        if abs(wavelengths_nm[place] - wavelength) > SAME_NM:
            raise UserError(
                "no PSF is of this wavelength",
                file=path,
                field="Wavelength",
                value=f"{wavelength:g} nm",
                allowed=", ".join(f"{w:g}" for w in wavelengths_nm),
            )
        if ideal[-1] < ideal_um[-1] * (1 - 1e-4):
            raise UserError(
                "the grid does not reach the last field of the PSFs",
                file=path,
                field="Predicted X, Predicted Y",
                value=f"{ideal[-1] / 1e3:.4g} mm from the axis",
                allowed=f"at least {ideal_um[-1] / 1e3:.4g} mm",
            )
        # Through the whole grid: printed digits average out.
        real_um[:, place] = odd_fit(ideal, real, stated.efl_mm, path)[0](ideal_um)
    lacking = np.flatnonzero(np.isnan(real_um).any(axis=0))
    if lacking.size:
        raise UserError(
            "the chief rays of a wavelength are missing",
            file=file,
            field="distortion_files",
            value=f"none at {wavelengths_nm[lacking[0]]:g} nm",
            allowed="a grid-distortion export for each wavelength of the PSFs",
        )
    return real_um
