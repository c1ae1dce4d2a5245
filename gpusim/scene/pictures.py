"""Pictures of other programs as scenes, by what their files are."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.bands import Bands, band_scene
from gpusim.scene.encoded import ENCODED, RAWS, read_encoded, read_raw_scene
from gpusim.scene.envi import is_envi, read_envi
from gpusim.scene.exr import Photograph, read_exr, units_of
from gpusim.scene.isetcam_scene import read_isetcam_scene
from gpusim.scene.radiance_hdr import read_hdr
from gpusim.scene.scene import DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectral_exr import RADIANCE_UNITS, is_spectral, read_spectral_exr
from gpusim.scene.upsampling import MALLETT, check_upsampling, lit_rgb

ENVI = (".hdr", ".img", ".dat", ".raw", ".bsq", ".bil", ".bip", ".cube")
SUFFIXES = (".exr", ".pic", ".mat", *ENVI, *ENCODED, *RAWS)
PICTURES = (
    ".exr, RGB or spectral; .hdr of Radiance or ENVI; .mat of ISETCam; .tif; .png; .jpg; a raw"
)


def is_picture(path: Path) -> bool:
    """Return whether a file's name is that of a picture."""
    return path.suffix.lower() in SUFFIXES


def picture_scene(
    path: Path,
    luminance_cd_m2: float | None = None,
    illuminant: str | None = None,
    transfer: str | None = None,
    upsampling: str | None = None,
) -> Scene:
    """Return the scene of a picture.

    Parameters
    ----------
    path : Path
        An EXR, RGB or spectral; an ENVI cube; an ISETCam scene; a Radiance picture; a TIFF, PNG or
        JPEG; a camera's raw.
    luminance_cd_m2 : float, optional
        Luminance of its white.
    illuminant : str, optional
        Light on a picture of reflectances.
    transfer : str, optional
        What light the values of a TIFF, PNG or JPEG stand for: see `gpusim.scene.encoded.linear`.
    upsampling : str, optional
        Method by which RGB becomes spectra: see `gpusim.scene.upsampling`.

    Raises
    ------
    UserError
        Where it cannot be read, or is given what it has no use for.
    """
    suffix = path.suffix.lower()
    if transfer is not None and suffix not in ENCODED:
        raise UserError(
            "the picture has no transfer function but its own",
            file=path,
            field="transfer",
            value=transfer,
            allowed="with a TIFF, PNG or JPEG",
        )
    method = check_upsampling(upsampling or MALLETT)
    if not os.path.isfile(path):
        raise UserError("no such scene file", file=path, allowed=PICTURES)
    if suffix == ".exr":
        _check_units(path)
    bands = _bands(path, suffix, illuminant)
    if bands is not None:
        if upsampling is not None:
            raise UserError(
                "the picture has spectra of its own",
                file=path,
                field="upsampling",
                value=upsampling,
                allowed="with an RGB picture",
            )
        return band_scene(path, bands, luminance_cd_m2, illuminant)
    if illuminant is not None:
        raise UserError(
            "a photograph has its own light in it",
            file=path,
            field="illuminant",
            value=illuminant,
            allowed="none with a photograph; with a chart any",
        )
    photograph = _rgb(path, suffix, transfer, luminance_cd_m2)
    return _photograph(path, photograph, luminance_cd_m2, method)


def _check_units(path: Path) -> None:
    """Refuse an EXR that says to hold something else than radiance."""
    units = units_of(path)
    if units not in (None, RADIANCE_UNITS):
        raise UserError(
            "the EXR holds no radiance",
            file=path,
            field="units",
            value=units,
            allowed=f"{RADIANCE_UNITS}, or none; an irradiance: gpusim render CAMERA FILE",
        )


def _bands(path: Path, suffix: str, illuminant: str | None) -> Bands | None:
    """Return what a picture of many bands holds; None for one of three."""
    if suffix == ".exr" and is_spectral(path):
        return read_spectral_exr(path, reflective=illuminant is not None)
    if suffix == ".mat":
        return read_isetcam_scene(path)
    if suffix in ENVI and (suffix != ".hdr" or is_envi(path)):
        return read_envi(path)
    return None


def _rgb(path: Path, suffix: str, transfer: str | None, luminance: float | None) -> Photograph:
    if suffix == ".exr":
        return read_exr(path, needs_luminance=luminance is None)
    if suffix in (".hdr", ".pic"):
        return read_hdr(path)
    if suffix in RAWS:
        return read_raw_scene(path)
    return read_encoded(path, transfer)


def _photograph(
    path: Path, photograph: Photograph, luminance_cd_m2: float | None, method: str
) -> Scene:
    known = luminance_cd_m2 or photograph.white_luminance_cd_m2
    scale = known or DEFAULT_WHITE_LUMINANCE_CD_M2
    notes = photograph.notes
    if not known:
        notes += (f"the file gives no whiteLuminance: RGB (1, 1, 1) taken as {scale:g} cd/m^2",)
    white = np.asarray(photograph.white_rgb)
    return lit_rgb(
        path.name, photograph.rgb, white, scale_cd_m2=scale, notes=notes, upsampling=method
    )
