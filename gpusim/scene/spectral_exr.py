"""Spectral EXR files after Fichet, Pacanowski and Wilkie (JCGT 10(3), 2021), section 4."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.bands import MOST_SAMPLES, RADIANCE, REFLECTANCE, Bands, checked_size
from gpusim.scene.exr import _parts, write_exr

# S0 to S3 of a light's Stokes vector, T of a reflectance; the decimal sign is a comma.
CHANNEL = re.compile(r"(S[0-3]|T)\.(\d*,?\d*(?:[eE][+-]?\d+)?)([YZEPTGMkhdacmunpf]?)(m|Hz)")
PREFIXES = {"Y": 1e24, "Z": 1e21, "E": 1e18, "P": 1e15, "T": 1e12, "G": 1e9, "M": 1e6, "k": 1e3,
            "h": 1e2, "": 1.0, "d": 1e-1, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9,
            "p": 1e-12}  # fmt: skip
LIGHT_M_PER_S = 299_792_458.0
RADIANCE_UNITS = "W m^-2 sr^-1 nm^-1"


def wavelength_nm(channel: str) -> tuple[str, float] | None:
    """Return what a channel's name says: S0 to S3 or T, and its wavelength; None for others."""
    found = CHANNEL.fullmatch(channel)
    if found is None:
        return None
    what, digits, prefix, unit = found.groups()
    try:
        value, scale = float(digits.replace(",", ".")), PREFIXES[prefix]
        # In nm the scale is 1, and the wavelength that of the name to the last bit.
        return what, value * (1e9 * scale) if unit == "m" else 1e9 * LIGHT_M_PER_S / (value * scale)
    except (ValueError, KeyError, ZeroDivisionError):
        return None


def is_spectral(path: Path) -> bool:
    """Return whether a file is an EXR with spectral channels; False for one that is no EXR."""
    if not os.path.isfile(path):
        return False
    try:
        parts = _parts(path, header_only=True)
        names = [channel.name for part in parts for channel in part.header.get("channels", ())]
    except (UserError, UnicodeDecodeError):
        return False
    return any(wavelength_nm(name) for name in names)


def read_spectral_exr(path: Path, reflective: bool = False, most: int = MOST_SAMPLES) -> Bands:
    """Read a spectral EXR.

    Parameters
    ----------
    path : Path
    reflective : bool
        Where a file holds both, take the reflectances, not the light.
    most : int
        Samples of all channels that it may have.

    Raises
    ------
    UserError
        Where it cannot be read, or its channels are not of one size.
    """
    headers = [part.header for part in _parts(path, header_only=True)]
    for header in headers:
        (x0, y0), (x1, y1) = np.asarray(header["dataWindow"], np.int64)
        checked_size(path, (len(header.get("channels", ())), y1 - y0 + 1, x1 - x0 + 1), most)
    found: dict[str, dict[float, np.ndarray]] = {}
    for part in _parts(path):
        # A part's dictionary of channels is made of their names: all of them were read before.
        for name, channel in part.channels.items():
            meant = wavelength_nm(name)
            if meant:
                found.setdefault(meant[0], {})[meant[1]] = channel.pixels
    kind = "T" if "T" in found and (reflective or "S0" not in found) else "S0"
    chosen = found.get(kind, {})
    shapes = {np.shape(plane) for plane in chosen.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise UserError(
            "no spectral channels of one size",
            file=path,
            field="channels",
            value=", ".join(sorted(found)) or None,
            allowed="S0.550,0nm of a light, or T.550,0nm of a reflectance",
        )
    notes = ()
    others = sorted(set(found) - {kind})
    if others:
        notes = (f"channels {', '.join(others)} left out: {kind} is taken",)
    nm = sorted(chosen)
    planes = np.stack([np.asarray(chosen[one], np.float32) for one in nm])
    return Bands(planes, np.array(nm), REFLECTANCE if kind == "T" else RADIANCE, notes)


def write_spectral_exr(
    path: Path, values: np.ndarray, wavelengths_nm: np.ndarray, units: str
) -> None:
    """Write a spectral EXR of light, which `read_spectral_exr` reads.

    Parameters
    ----------
    path : Path
    values : ndarray (rows, cols, bands)
        Written as float32.
    wavelengths_nm : ndarray (bands,)
        Kept to the last bit in the names of the channels.
    units : str
        Unit of the values, for the header; it ends in "nm^-1".

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    names = [
        np.format_float_positional(nm, min_digits=3) for nm in np.asarray(wavelengths_nm, float)
    ]
    planes = {f"S0.{name.replace('.', ',')}nm": values[..., n] for n, name in enumerate(names)}
    # The layout's own name of a unit leaves out that it is one for each nm.
    layout = {"emissiveUnits": units.removesuffix(" nm^-1").replace(" ", ".")}
    write_exr(path, planes, units=units, more=layout | {"spectralLayoutVersion": "1.0"})
