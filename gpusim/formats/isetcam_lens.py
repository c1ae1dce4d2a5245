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
from pathlib import Path, PureWindowsPath

import numpy as np

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.text import read_bytes, read_mapping
from gpusim.errors import UserError
from gpusim.formats.assemble import Stated, make_bank
from gpusim.formats.text import decoded
from gpusim.formats.zemax_psf import FirstRow, check_size, common_grid, parse_psf, turned
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
    scalars = {}
    for name in NEEDED:
        if name in TEXTS or name == "wave":
            continue
        if values[name].size != 1:
            raise UserError("one number is needed", file=file, field=name, value=str(values[name]))
        scalars[name] = float(values[name][0])
    wavelengths = values["wave"]
    heights = scalars["imgHeightNum"]
    if heights != int(heights) or not 2 <= heights <= MOST_SAMPLES:
        raise UserError(
            "two image heights or more are needed",
            file=file,
            field="imgHeightNum",
            value=f"{heights:g}",
            allowed=f"2 to {MOST_SAMPLES}",
        )
    for name in ("imgHeightMax", "efl", "fnumber", "fnumber_eff"):
        if not scalars[name] > 0:
            raise UserError(
                "a parameter is out of range",
                file=file,
                field=name,
                value=f"{scalars[name]:g}",
                allowed="above 0",
            )
    ideal_um = 1e3 * np.linspace(0, scalars["imgHeightMax"], int(heights))

    base = PureWindowsPath(values["baseLensFileName"]).name  # understands / and \ alike
    shape = (len(ideal_um), len(wavelengths))
    real_um = 1e3 * _table(file.parent / f"{base}_DI_.dat", shape)
    illumination = _table(file.parent / f"{base}_RI_.dat", shape)
    exports = {}
    for field, wave in np.ndindex(shape):
        path = _psf_file(file.parent, base, field + 1, wave + 1)
        export = parse_psf(read_bytes(path, "the PSF file"), path)
        if abs(export.wavelength_nm - wavelengths[wave]) > 0.6:  # the macro counts in whole nm
            raise UserError(
                "the PSF is not of the wavelength that its name says",
                file=path,
                field="wavelength",
                value=f"{export.wavelength_nm:g} nm",
                allowed=f"{wavelengths[wave]:g} nm",
            )
        exports[field, wave] = export
    beside = file.with_suffix(".yaml")
    stated = read_mapping(beside, "the file of the lens's fields") if beside.exists() else {}
    if "transmission" not in stated:
        raise UserError(
            "the folder does not hold the lens's transmission",
            file=beside,
            field="transmission",
            allowed="a file of this name, with transmission: 0 to 1, or one number for each "
            "wavelength",
        )
    known = checked(Beside, stated, beside)
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
                    file=file.parent / f"{base}_DI_.dat",
                    field=f"image height {field + 1}, {wavelengths[wave]:g} nm",
                    value=f"{real_um[field, wave]:.6g} um",
                    allowed=f"about {1e3 * abs(export.centre_y_mm):.6g} um, where the PSF's file "
                    "has its centre",
                )
        psf[field, wave] = turned(export, pitch_um, size, known.first_row, outwards_um)

    lens = PureWindowsPath(values["lensFile"]).name
    working = scalars["fnumber_eff"]
    is_far = scalars["objDist"] > 1e9 or scalars["mag"] == 0
    nearest = int(np.abs(wavelengths - scalars["refWave"]).argmin())
    optics = checked(
        Stated,
        {
            "title": known.title or PureWindowsPath(lens).stem,
            "source": known.source or f"ISETCam ray-trace folder of {lens}",
            "notes": known.notes,
            "efl_mm": scalars["efl"],
            "f_number": scalars["fnumber"],
            "working_f_number": working,
            "transmission": known.transmission,
            "exit_pupil_mm": known.exit_pupil_mm,
        },
        file,
    )
    return make_bank(
        optics,
        wavelengths_nm=wavelengths,
        reference_nm=float(wavelengths[nearest]),
        ideal_height_um=ideal_um,
        real_height_um=real_um,
        psf=psf,
        pitch_um=pitch_um,
        relative_illumination=illumination,
        provenance={
            "object": "at infinity"
            if is_far
            else f"{scalars['objDist']:g} mm before the lens; field angles are those of an object "
            "at infinity with the same image height",
            "image_height": "paraxial image height at the lens's reference wavelength, "
            f"{scalars['refWave']:g} nm; that of the bank is the nearest with data",
            "psf_orientation": f"rows of an export begin at {known.first_row}; turned until +x is "
            "radial",
        },
        file=file,
    )


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
