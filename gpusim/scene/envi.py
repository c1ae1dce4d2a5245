"""ENVI cubes: a text header beside a file of samples, by band, line or pixel."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gpusim.config.text import read_text
from gpusim.errors import UserError
from gpusim.scene.bands import RADIANCE, REFLECTANCE, RELATIVE, Bands, checked_size

# "data type" of the header; complex ones are no pictures.
TYPES = {
    1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"
}  # fmt: skip
# How the axes (lines, samples, bands) lie in the file, and from there to (bands, lines, samples).
INTERLEAVES = {
    "bsq": (("bands", "lines", "samples"), (0, 1, 2)),
    "bil": (("lines", "bands", "samples"), (1, 0, 2)),
    "bip": (("lines", "samples", "bands"), (2, 0, 1)),
}
TO_NM = {"nanometers": 1.0, "nanometres": 1.0, "nm": 1.0, "micrometers": 1e3, "micrometres": 1e3,
         "microns": 1e3, "um": 1e3}  # fmt: skip
# "data units" that say a spectral radiance: its value in W m^-2 sr^-1 nm^-1.
RADIANCES = {"w/m^2/sr/nm": 1.0, "w/m2/sr/nm": 1.0, "w/m^2/sr/um": 1e-3, "w/m2/sr/um": 1e-3,
             "uw/cm^2/sr/nm": 1e-2, "mw/m^2/sr/nm": 1e-3}  # fmt: skip
DATA = ("", ".img", ".dat", ".raw", ".bin", ".bsq", ".bil", ".bip", ".cube")


def is_envi(path: Path) -> bool:
    """Return whether a file is an ENVI header, or has one beside it."""
    header = path if path.suffix.lower() == ".hdr" else _header_of(path)
    try:
        with header.open("rb") as file:
            return file.read(5).strip().startswith(b"ENVI")
    except (OSError, ValueError):
        return False


def _header_of(path: Path) -> Path:
    beside = (path.with_suffix(".hdr"), path.with_name(path.name + ".hdr"))
    return next((file for file in beside if os.path.isfile(file)), beside[0])


def read_envi(path: Path) -> Bands:
    """Read an ENVI cube.

    Parameters
    ----------
    path : Path
        The header, or the file of samples beside it.

    Returns
    -------
    Bands
        A reflectance where the header has a "reflectance scale factor", a radiance where its
        "data units" are those of one; else relative.

    Raises
    ------
    UserError
        Where the header has no such field, or a wrong one; the file is missing or too short.
    """
    header = path if path.suffix.lower() == ".hdr" else _header_of(path)
    fields = _fields(header)
    sizes = {name: _whole(fields, name, header) for name in ("bands", "lines", "samples")}
    checked_size(header, tuple(sizes.values()))
    planes = _samples(path, header, fields, sizes)
    notes: tuple[str, ...] = ()
    if "data ignore value" in fields:
        ignored = planes == np.float32(_number(fields, "data ignore value", header))
        if ignored.any():
            planes[ignored] = 0.0
            notes += (f"{np.count_nonzero(ignored)} samples without data set to 0",)
    kind = RELATIVE
    for name, apply in (("data gain values", np.multiply), ("data offset values", np.add)):
        if name in fields:
            given = _numbers(fields, name, header, len(planes))
            apply(planes, given[:, None, None], out=planes)
    units = fields.get("data units", "").lower().replace(" ", "")
    if "reflectance scale factor" in fields:
        factor = _number(fields, "reflectance scale factor", header)
        if not factor > 0:
            raise _wrong(header, fields, "reflectance scale factor", "above 0")
        planes /= np.float32(factor)
        kind = REFLECTANCE
    elif units in RADIANCES:
        planes *= np.float32(RADIANCES[units])
        kind = RADIANCE
    else:
        notes += ("the header says no unit: relative, unless an illuminant lights it",)
    return Bands(planes, _wavelengths(fields, header, len(planes)), kind, notes)


def _samples(path: Path, header: Path, fields: dict[str, str], sizes: dict[str, int]) -> np.ndarray:
    """Return the samples as they stand (bands, lines, samples), float32."""
    kind = TYPES.get(_whole(fields, "data type", header))
    if kind is None:
        raise _wrong(header, fields, "data type", ", ".join(map(str, TYPES)))
    interleave = INTERLEAVES.get(fields.get("interleave", "").lower())
    if interleave is None:
        raise _wrong(header, fields, "interleave", ", ".join(INTERLEAVES))
    order = fields.get("byte order", "0")
    if order not in ("0", "1"):
        raise _wrong(header, fields, "byte order", "0 for little, 1 for big endian")
    dtype = np.dtype(("<" if order == "0" else ">") + kind)
    offset = _whole(fields, "header offset", header, least=0) if "header offset" in fields else 0
    data = path if path != header else _data_of(header)
    count = sizes["bands"] * sizes["lines"] * sizes["samples"]
    size = data.stat().st_size
    if size < offset + count * dtype.itemsize:
        raise UserError(
            "the file of samples is shorter than its header says",
            file=data,
            value=f"{size:,} bytes",
            allowed=f"{offset + count * dtype.itemsize:,}",
        )
    axes, turn = interleave
    cube = np.memmap(data, dtype, "r", offset, tuple(sizes[axis] for axis in axes))
    return np.transpose(cube, turn).astype(np.float32)


def _fields(header: Path) -> dict[str, str]:
    """Return the fields of a header, names in small letters, without their braces."""
    lines = read_text(header, "the ENVI header").splitlines()
    if not lines or lines[0].strip() != "ENVI":
        raise UserError(
            "no ENVI header", file=header, field="line 1", value=lines[0][:40] if lines else "",
            allowed="ENVI",
        )  # fmt: skip
    fields, name = {}, None
    for line in lines[1:]:
        if name is not None:  # in braces that are open
            fields[name] += " " + line.strip()
        elif "=" in line and not line.lstrip().startswith(";"):
            name, _, value = line.partition("=")
            name = name.strip().lower()
            fields[name] = value.strip()
        if name is not None and (not fields[name].startswith("{") or fields[name].endswith("}")):
            fields[name] = fields[name].strip("{} ")
            name = None
    return fields


def _data_of(header: Path) -> Path:
    """Return the file of samples beside a header."""
    stem = header.with_suffix("")
    found = [stem.with_name(stem.name + end) for end in DATA]
    there = next((file for file in found if os.path.isfile(file)), None)
    if there is None:
        raise UserError(
            "there is no file of samples beside the header",
            file=header,
            allowed=f"{stem.name} with one of {', '.join(end for end in DATA if end)}, or none",
        )
    return there


def _whole(fields: dict[str, str], name: str, header: Path, least: int = 1) -> int:
    text = fields.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 12 and int(text) >= least):
        raise _wrong(header, fields, name, f"a whole number, {least} or more")
    return int(text)


def _number(fields: dict[str, str], name: str, header: Path) -> float:
    return float(_numbers(fields, name, header, 1)[0])


def _numbers(fields: dict[str, str], name: str, header: Path, count: int) -> np.ndarray:
    try:
        found = np.array([float(one) for one in fields[name].split(",")], np.float32)
        if len(found) == count and np.isfinite(found).all():
            return found
    except (ValueError, OverflowError):
        pass
    raise _wrong(header, fields, name, f"{count} finite numbers")


def _wavelengths(fields: dict[str, str], header: Path, count: int) -> np.ndarray:
    if "wavelength" not in fields:
        raise _wrong(header, fields, "wavelength", "one for each band")
    units = fields.get("wavelength units", "nanometers").lower()
    if units not in TO_NM:
        raise _wrong(header, fields, "wavelength units", ", ".join(TO_NM))
    return _numbers(fields, "wavelength", header, count).astype(np.float64) * TO_NM[units]


def _wrong(header: Path, fields: dict[str, str], name: str, allowed: str) -> UserError:
    return UserError(
        "the ENVI header lacks a field" if name not in fields else "the ENVI header is wrong",
        file=header,
        field=name,
        value=fields.get(name),
        allowed=allowed,
    )
