"""A bank of Zemax's text exports: FFT and Huygens PSFs, and grid distortion.

A YAML file beside the exports (`gpusim.formats.zemax_psf`, `gpusim.formats.zemax_distortion`):

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

The height of the chief ray at each wavelength comes from the grid distortion of that wavelength;
without ``distortion_files`` from the coordinates of the PSFs' centres ("Center coordinates",
"Reference Coordinates"). Either way the centre of an export is taken for the chief ray: export with
the chief ray as the reference, "Use Centroid" off. Where both are there they must agree, to a
sample and to the digits in which the field is printed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gpusim.config.mistakes import checked
from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.formats.assemble import Stated, make_bank, odd_fit, per_wavelength
from gpusim.formats.zemax_distortion import parse_distortion
from gpusim.formats.zemax_psf import (
    FirstRow,
    PsfExport,
    check_size,
    common_grid,
    parse_psf,
    turned,
)
from gpusim.psf.bank import Bank

SAME_NM = 0.06  # wavelengths are printed to 0.1 nm


class ZemaxFile(Stated):
    """Fields of the YAML file beside the exports: see the module."""

    reference_nm: float = Field(gt=0)
    field_type: Literal["angle", "paraxial image height"]
    relative_illumination: tuple[float | tuple[float, ...], ...]
    psf_files: tuple[str, ...] = Field(min_length=1)
    distortion_files: tuple[str, ...] = ()
    first_row: FirstRow = "+y"


def read_zemax(data: dict[str, object], file: Path) -> Bank:
    """Make the bank of a YAML file that lists exports.

    Raises
    ------
    UserError
        Where an export is missing, is not whole or contradicts another.
    """
    stated = checked(ZemaxFile, data, file)
    grid, ideal_mm, wavelengths = _grid(stated, file)
    reference_nm = _reference_nm(stated, wavelengths, file)
    centres_um = _centres(grid, (len(ideal_mm), len(wavelengths)))
    real_um, chief_rays = _chief_rays(stated, file, wavelengths, ideal_mm, centres_um)
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
        reference_nm=reference_nm,
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


def _reference_nm(stated: ZemaxFile, wavelengths_nm: np.ndarray, file: Path) -> float:
    """Return the wavelength of the exports that is the reference."""
    off = np.abs(wavelengths_nm - stated.reference_nm)
    if off.min() > SAME_NM:
        raise UserError(
            "the reference wavelength is not one of the exports'",
            file=file,
            field="reference_nm",
            value=stated.reference_nm,
            allowed=", ".join(f"{w:g}" for w in wavelengths_nm),
        )
    return float(wavelengths_nm[off.argmin()])


def _grid(
    stated: ZemaxFile, file: Path
) -> tuple[dict[tuple[int, int], PsfExport], np.ndarray, np.ndarray]:
    """Return the exports by field and wavelength, and these: ideal heights, mm, and nm."""
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
    return grid, ideal_mm, wavelengths


def _chief_rays(
    stated: ZemaxFile,
    file: Path,
    wavelengths_nm: np.ndarray,
    ideal_mm: np.ndarray,
    centres_um: np.ndarray | None,
) -> tuple[np.ndarray, str]:
    """Return the heights of the chief rays (F, L), um, and where they come from."""
    if stated.distortion_files:
        real_um = _from_grids(stated, file, wavelengths_nm, 1e3 * ideal_mm)
        return real_um, "grid-distortion exports"
    if centres_um is None:
        raise UserError(
            "the heights of the chief rays are missing: not every PSF export gives the "
            "coordinates of its centre",
            file=file,
            field="distortion_files",
            allowed="a grid-distortion export for each wavelength",
        )
    return centres_um, "centres of the PSF exports"


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
