"""Scenes from arrays: linear RGB, or spectra by band."""

from __future__ import annotations

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.raster import Raster
from gpusim.scene.scene import DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.scene.upsampling import lit_rgb


def rgb_scene(
    rgb: np.ndarray,
    white_cd_m2: float = DEFAULT_WHITE_LUMINANCE_CD_M2,
    name: str = "RGB array",
) -> Scene:
    """Return a photograph that is an array: see `gpusim.library.scene.Scene.from_rgb`."""
    pixels = _finite(rgb, "rgb", "(rows, cols, 3)")
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise _shape("rgb", pixels, "(rows, cols, 3)")
    if not 0 < white_cd_m2 < np.inf:
        raise UserError(
            "impossible luminance", field="white_cd_m2", value=white_cd_m2, allowed="above 0"
        )
    planes = np.ascontiguousarray(np.moveaxis(pixels, 2, 0))
    return lit_rgb(name, planes, np.ones(3), scale_cd_m2=white_cd_m2, notes=())


def spectral_scene(
    radiance: np.ndarray, wavelengths_nm: np.ndarray, name: str = "spectral array"
) -> Scene:
    """Return a scene of spectral radiance by band: see `from_spectra` of the library's `Scene`."""
    cube = _finite(radiance, "radiance", "(rows, cols, bands)")
    lines = np.asarray(wavelengths_nm, float)
    if cube.ndim != 3 or cube.shape[2] != len(lines) or len(lines) < 2:
        raise _shape("radiance", cube, f"(rows, cols, {max(len(lines), 2)}): bands as wavelengths")
    if (np.diff(lines) <= 0).any():
        raise UserError("the wavelengths do not rise", field="wavelengths_nm", allowed="nm, rising")
    # Between bands the radiance is a straight line: each band's spectrum is a hat.
    hats = np.array([np.interp(WAVELENGTHS_NM, lines, row) for row in np.eye(len(lines))])
    inside = (WAVELENGTHS_NM >= lines[0]) & (WAVELENGTHS_NM <= lines[-1])
    if not inside.any():
        raise UserError(
            "no band lies where light is seen",
            field="wavelengths_nm",
            value=f"{lines[0]:g} to {lines[-1]:g} nm",
            allowed="some of 400 to 700 nm",
        )
    planes = np.ascontiguousarray(np.moveaxis(cube, 2, 0))
    notes = ()
    if not inside.all():
        notes = (f"no light beyond the bands: {lines[0]:g} to {lines[-1]:g} nm",)
    spectra = hats * inside
    level = planes.mean(axis=0).ravel()
    brightest = np.argpartition(level, -max(level.size // 100, 1))[-max(level.size // 100, 1) :]
    white = planes.reshape(len(lines), -1)[:, brightest].mean(axis=1) @ spectra
    return Scene(name, spectra, Raster(planes), "its own", white, notes)


def _finite(values: np.ndarray, field: str, allowed: str) -> np.ndarray:
    if getattr(values, "dtype", None) == np.uint8:
        raise UserError(
            "bytes are a picture with its curve, not light",
            field=field,
            value="uint8",
            allowed="linear light in floating point, 1 for white; a PNG, TIFF or JPEG: gpusim "
            "render FILE --transfer srgb",
        )
    try:
        found = np.asarray(values, np.float32)
    except (TypeError, ValueError):
        raise UserError("not an array of numbers", field=field, allowed=allowed) from None
    if not np.isfinite(found).all() or (found < 0).any():
        raise UserError(
            "the array has values that are no light", field=field, allowed="finite, none negative"
        )
    if not found.size:
        raise _shape(field, found, f"{allowed}, none of them 0")
    return found


def _shape(field: str, found: np.ndarray, allowed: str) -> UserError:
    return UserError("an array of another shape", field=field, value=found.shape, allowed=allowed)
