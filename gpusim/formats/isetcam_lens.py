"""Reader of the ray-trace folder of ISETCam, as its Zemax macros write it.

The format is that of the macros ISET_RT_ZEMAX.ZPL (2008) and ISET_RT_ZEMAX_2D.ZPL (2013, 2017) in
ISETCam, opticalimage/raytrace/zemax:

- ``ISETPARMS.TXT``: lines ``name=value;`` with ``%`` before a comment. It is MATLAB, which ISETCam
  evaluates; here it is parsed, and a line that is no number, quoted text or range is refused.
- ``BASE_DI_.dat``, ``BASE_RI_.dat``: real heights of the chief rays, mm, and relative illumination,
  for each paraxial image height all wavelengths.
- ``BASE_2D_PSF_Fld<i>_Wave<j>.dat`` (2008: ``BASE_PSF_<i>_<j>.dat``): Zemax exports of the PSF
  (`gpusim.formats.zemax_psf`), i counting image heights and j wavelengths from 1.

Image heights are evenly spaced from 0 to imgHeightMax, f tan(theta). The macro traces the PSFs at
negative heights, and the other files at positive ones; it puts the sign into each export.

What the folder does not hold is the transmission. It stands in ``ISETPARMS.yaml`` beside the text:

    transmission: 0.95             # or one number for each wavelength
    title: my lens                 # optional; the name of the lens file otherwise
    source: where it comes from    # optional
    first_row: "+y"                # optional, see gpusim.formats.zemax_psf
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.text import read_bytes, read_mapping
from gpusim.errors import UserError
from gpusim.formats.assemble import Stated, make_bank
from gpusim.formats.text import decoded
from gpusim.formats.zemax_psf import (
    FirstRow,
    PsfExport,
    check_size,
    common_grid,
    parse_psf,
    turned,
)
from gpusim.formats.zemax_units import NUMBER
from gpusim.psf.bank import Bank

NEEDED = (
    "lensFile",
    "baseLensFileName",
    "wave",
    "imgHeightNum",
    "imgHeightMax",
    "objDist",
    "mag",
    "refWave",
    "efl",
    "fnumber_eff",
    "fnumber",
)
TEXTS = ("lensFile", "baseLensFileName")
PSF_NAMES = ("{base}_2D_PSF_Fld{field}_Wave{wave}.dat", "{base}_PSF_{field}_{wave}.dat")
MOST_SAMPLES = 1000  # fields or wavelengths: more is no lens


class Beside(Strict):
    """Fields of ISETPARMS.yaml."""

    transmission: float | tuple[float, ...]
    title: str | None = None
    source: str | None = None
    notes: str = ""
    exit_pupil_mm: float | None = None
    first_row: FirstRow = "+y"


def parse_parameters(text: str, file: Path) -> dict[str, str | np.ndarray]:
    """Read ``name=value`` lines: quoted texts, numbers, and ranges as arrays.

    Raises
    ------
    UserError
        For a line that is anything else.
    """
    values: dict[str, str | np.ndarray] = {}
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip().strip("\x00\x1a")
        if not line or line.startswith("%"):
            continue
        match = re.fullmatch(r"([A-Za-z]\w*)\s*=\s*('[^']*'|[^%;']+?)\s*;?\s*(?:%.*)?", line)
        value = _value(match[2]) if match else None
        if value is None:
            raise UserError(
                "the line is no parameter (nothing is evaluated)",
                file=file,
                field=f"line {number}",
                value=line[:60],
                allowed="name=number; name='text'; name=first:step:last; name=[numbers]",
            )
        values[match[1]] = value
    return values


def _value(text: str) -> str | np.ndarray | None:
    """Return a quoted text, or the numbers of a number, a range or a list; None for all else."""
    if text.startswith("'"):
        return text[1:-1]
    if re.fullmatch(rf"{NUMBER}(\s*:\s*{NUMBER}){{1,2}}", text):
        parts = [float(part) for part in text.split(":")]
        first, step, last = parts if len(parts) == 3 else (parts[0], 1.0, parts[1])
        if step <= 0 or last < first or (last - first) / step > MOST_SAMPLES:
            return None
        return first + step * np.arange(int(np.floor((last - first) / step + 1e-9)) + 1)
    words = text.strip("[]").replace(",", " ").split()
    if words and all(re.fullmatch(NUMBER, word) for word in words):
        return np.array(words, float)
    return None


def read_isetcam(file: Path) -> Bank:
    """Make the bank of a folder from its ISETPARMS.TXT.

    Raises
    ------
    UserError
        Where a file is missing, is not whole or contradicts another.
    """
    given = _parameters(file)
    shape = (len(given.ideal_um), len(given.wavelengths_nm))
    heights = file.parent / f"{given.base}_DI_.dat"
    real_um = 1e3 * _table(heights, shape)
    illumination = _table(file.parent / f"{given.base}_RI_.dat", shape)
    exports = {at: _export(file.parent, given, *at) for at in np.ndindex(shape)}
    known = _beside(file.with_suffix(".yaml"))
    pitch_um, size = common_grid(list(exports.values()))
    check_size(size, pitch_um, file)
    psf = np.empty((*shape, size, size))
    for (field, wave), export in exports.items():
        outwards_um = 0.0
        if export.centre_y_mm is not None:
            outwards_um = 1e3 * abs(export.centre_y_mm) - real_um[field, wave]
            if abs(outwards_um) > size * pitch_um / 4:
                raise UserError(
                    "a PSF and its chief ray lie apart",
                    file=heights,
                    field=f"image height {field + 1}, {given.wavelengths_nm[wave]:g} nm",
                    value=f"{real_um[field, wave]:.6g} um",
                    allowed=f"about {1e3 * abs(export.centre_y_mm):.6g} um, where the PSF's file "
                    "has its centre",
                )
        psf[field, wave] = turned(export, pitch_um, size, known.first_row, outwards_um)
    nearest = int(np.abs(given.wavelengths_nm - given.numbers["refWave"]).argmin())
    return make_bank(
        _optics(given, known, file),
        wavelengths_nm=given.wavelengths_nm,
        reference_nm=float(given.wavelengths_nm[nearest]),
        ideal_height_um=given.ideal_um,
        real_height_um=real_um,
        psf=psf,
        pitch_um=pitch_um,
        relative_illumination=illumination,
        provenance=_provenance(given, known),
        file=file,
    )


@dataclass(frozen=True)
class _Parameters:
    """What ISETPARMS.TXT says.

    Attributes
    ----------
    lens, base : str
        Names of the lens's file, and that with which the data files begin.
    wavelengths_nm : ndarray (L,)
    ideal_um : ndarray (F,)
        Paraxial image heights.
    numbers : dict of str to float
        By the macro's names.
    """

    lens: str
    base: str
    wavelengths_nm: np.ndarray
    ideal_um: np.ndarray
    numbers: dict[str, float]


def _parameters(file: Path) -> _Parameters:
    """Read and check ISETPARMS.TXT."""
    values = parse_parameters(decoded(read_bytes(file, "the parameter file")), file)
    for name in NEEDED:
        if name not in values:
            raise UserError(
                f"{name} is missing", file=file, field=name, allowed="as the macro writes it"
            )
        if isinstance(values[name], str) != (name in TEXTS):
            raise UserError(
                "a parameter is of the wrong kind",
                file=file,
                field=name,
                value=str(values[name]),
                allowed="a quoted text" if name in TEXTS else "a number",
            )
    numbers = {}
    for name in NEEDED:
        if name in TEXTS or name == "wave":
            continue
        if values[name].size != 1:
            raise UserError("one number is needed", file=file, field=name, value=str(values[name]))
        numbers[name] = float(values[name][0])
    heights = numbers["imgHeightNum"]
    if heights != int(heights) or not 2 <= heights <= MOST_SAMPLES:
        raise UserError(
            "two image heights or more are needed",
            file=file,
            field="imgHeightNum",
            value=f"{heights:g}",
            allowed=f"2 to {MOST_SAMPLES}",
        )
    for name in ("imgHeightMax", "efl", "fnumber", "fnumber_eff"):
        if not numbers[name] > 0:
            raise UserError(
                "a parameter is out of range",
                file=file,
                field=name,
                value=f"{numbers[name]:g}",
                allowed="above 0",
            )
    # PureWindowsPath understands / and \ alike.
    lens, base = (PureWindowsPath(values[name]).name for name in TEXTS)
    ideal_um = 1e3 * np.linspace(0, numbers["imgHeightMax"], int(heights))
    return _Parameters(lens, base, values["wave"], ideal_um, numbers)


def _export(folder: Path, given: _Parameters, field: int, wave: int) -> PsfExport:
    """Read the PSF of a field and a wavelength."""
    path = _psf_file(folder, given.base, field + 1, wave + 1)
    export = parse_psf(read_bytes(path, "the PSF file"), path)
    stated_nm = given.wavelengths_nm[wave]
    if abs(export.wavelength_nm - stated_nm) > 0.6:  # the macro counts in whole nm
        raise UserError(
            "the PSF is not of the wavelength that its name says",
            file=path,
            field="wavelength",
            value=f"{export.wavelength_nm:g} nm",
            allowed=f"{stated_nm:g} nm",
        )
    return export


def _beside(file: Path) -> Beside:
    """Read ISETPARMS.yaml."""
    stated = read_mapping(file, "the file of the lens's fields") if file.exists() else {}
    if "transmission" not in stated:
        raise UserError(
            "the folder does not hold the lens's transmission",
            file=file,
            field="transmission",
            allowed="a file of this name, with transmission: 0 to 1, or one number for each "
            "wavelength",
        )
    return checked(Beside, stated, file)


def _optics(given: _Parameters, known: Beside, file: Path) -> Stated:
    """Return what the bank needs beside the data."""
    return checked(
        Stated,
        {
            "title": known.title or PureWindowsPath(given.lens).stem,
            "source": known.source or f"ISETCam ray-trace folder of {given.lens}",
            "notes": known.notes,
            "efl_mm": given.numbers["efl"],
            "f_number": given.numbers["fnumber"],
            "working_f_number": given.numbers["fnumber_eff"],
            "transmission": known.transmission,
            "exit_pupil_mm": known.exit_pupil_mm,
        },
        file,
    )


def _provenance(given: _Parameters, known: Beside) -> dict[str, str]:
    """Return what is particular to such a folder."""
    distance_mm = given.numbers["objDist"]
    is_far = distance_mm > 1e9 or given.numbers["mag"] == 0
    return {
        "object": "at infinity"
        if is_far
        else f"{distance_mm:g} mm before the lens; field angles are those of an object "
        "at infinity with the same image height",
        "image_height": "paraxial image height at the lens's reference wavelength, "
        f"{given.numbers['refWave']:g} nm; that of the bank is the nearest with data",
        "psf_orientation": f"rows of an export begin at {known.first_row}; turned until +x is "
        "radial",
    }


def _table(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """Read the numbers of a file as (fields, wavelengths)."""
    words = decoded(read_bytes(path, "the data file")).split()
    try:
        values = np.array(words, float)
    except ValueError as error:
        raise UserError(f"a value is not a number: {error}", file=path) from error
    if values.size != shape[0] * shape[1] or not np.isfinite(values).all():
        raise UserError(
            "the file is not whole",
            file=path,
            value=f"{values.size} numbers",
            allowed=f"{shape[0]} image heights x {shape[1]} wavelengths",
        )
    return values.reshape(shape)


def _psf_file(folder: Path, base: str, field: int, wave: int) -> Path:
    """Return the PSF file of a field and wavelength, in whichever way the macro named it."""
    names = [pattern.format(base=base, field=field, wave=wave) for pattern in PSF_NAMES]
    for name in names:
        if (folder / name).exists():
            return folder / name
    raise UserError("a PSF file is missing", file=folder / names[0], allowed=" or ".join(names))
