"""Pictures of many bands as scenes: one plane a band, straight between the bands' wavelengths."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.known import Known
from gpusim.scene.exr import LARGEST
from gpusim.scene.raster import Raster
from gpusim.scene.scene import DEFAULT_ILLUMINANT, DEFAULT_WHITE_LUMINANCE_CD_M2, Scene
from gpusim.scene.spectra import (
    LONGEST_NM,
    SHORTEST_NM,
    STEP_NM,
    WAVELENGTHS_NM,
    illuminant_known,
    luminance_cd_m2,
    white_radiance,
)

# Samples of all bands together: 512 MiB in float32.
MOST_SAMPLES = 1 << 27
RADIANCE, REFLECTANCE, RELATIVE = "radiance", "reflectance", "relative"
# Share of pixels that are darker than the white, in a scene without a white of its own.
DARKER = 0.99
DARK = 1e-4  # of its brightest wavelength, where a light tells nothing of a reflectance


@dataclass(frozen=True, eq=False)
class Bands:
    """What a file of many bands holds.

    Attributes
    ----------
    planes : ndarray (M, rows, cols)
    wavelengths_nm : ndarray (M,)
    kind : str
        "radiance", W m^-2 sr^-1 nm^-1; "reflectance"; or "relative", a radiance of unknown scale,
        which may be a reflectance.
    notes : tuple of str
        What was changed on the way.
    lamp : ndarray (M,) or None
        Radiance of a perfect white in the file's own light, of a radiance.
    """

    planes: np.ndarray
    wavelengths_nm: np.ndarray
    kind: str
    notes: tuple[str, ...] = ()
    lamp: np.ndarray | None = None


def checked_size(path: Path, shape: tuple[int, int, int], most: int = MOST_SAMPLES) -> None:
    """Refuse a cube (bands, rows, cols) that is empty or larger than any that is read."""
    bands, rows, cols = (int(one) for one in shape)
    if min(bands, rows, cols) < 1 or bands * rows * cols > most:
        raise UserError(
            "a cube of a size that is not read",
            file=path,
            value=f"{bands} bands of {rows} x {cols}",
            allowed=f"1 to {most:,} samples of all bands",
        )


def band_scene(
    path: Path, bands: Bands, luminance: float | None = None, illuminant: str | None = None
) -> Scene:
    """Return the scene of a picture of many bands.

    Parameters
    ----------
    path : Path
        Path of the file.
    bands : Bands
    luminance : float, optional
        Luminance of the scene's white, cd/m^2. If it is not given, a radiance keeps its own, and
        others have 300.
    illuminant : str, optional
        Light on reflectances, D50 if not given; with it, a relative cube is one of reflectances,
        and a radiance whose own light is known is lit anew.

    Raises
    ------
    UserError
        For samples that are no light, wavelengths that are not computed, a radiance with an
        illuminant.
    """
    planes, nm, notes = _sorted(path, bands)
    relit = bands.lamp is not None and illuminant is not None
    if relit:
        own = np.interp(nm, np.asarray(bands.wavelengths_nm, float), bands.lamp)
        dark = own < DARK * own.max()
        planes = planes / np.where(dark, np.inf, own).astype(np.float32)[:, None, None]
        notes += ("reflectances by the file's own light",)
        if dark.any():
            notes += (f"none at {np.count_nonzero(dark)} wavelengths, at which that is dark",)
    elif bands.kind == RADIANCE and illuminant is not None:
        raise UserError(
            "a radiance has its own light in it", file=path, field="illuminant", value=illuminant,
            allowed="none with a radiance; with reflectances any",
        )  # fmt: skip
    known = (Known(f"the bands of {path.name}", float(nm[0]), float(nm[-1])),)
    name, raster = path.name, Raster(planes)
    reflective = bands.kind == REFLECTANCE or illuminant is not None
    if reflective:
        lamp = illuminant or DEFAULT_ILLUMINANT
        level = luminance or DEFAULT_WHITE_LUMINANCE_CD_M2
        notes += (f"reflectances under {Path(lamp).name}, a white of {level:g} cd/m^2",)
        known += (illuminant_known(lamp),)
        light = partial(_under_lamp, nm, lamp, level)
    else:
        lamp = "the file's own"
        white_bands, words = _white(planes, nm, bands)
        own = float(luminance_cd_m2(white_bands @ _hats(nm, WAVELENGTHS_NM)))
        wanted = luminance or (own if bands.kind == RADIANCE else DEFAULT_WHITE_LUMINANCE_CD_M2)
        scale = wanted / own if own > 0 else 1.0
        notes += (f"white is {words}, {wanted if own > 0 else 0.0:.4g} cd/m^2",)
        light = partial(_of_its_own, nm, white_bands, scale)
    spectra, white = light(WAVELENGTHS_NM)
    return Scene(name, spectra, raster, Path(lamp).name, white, notes, light=light, made_of=known)


def _under_lamp(
    nm: np.ndarray, lamp: str, level: float, wavelengths_nm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of bands of reflectance under a lamp, and that of white."""
    white = white_radiance(lamp, level, wavelengths_nm)
    return _hats(nm, wavelengths_nm) * white, white


def _of_its_own(
    nm: np.ndarray, white_bands: np.ndarray, scale: float, wavelengths_nm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of bands of radiance, and that of the picture's white."""
    spectra = scale * _hats(nm, wavelengths_nm)
    return spectra, white_bands @ spectra


def _hats(nm: np.ndarray, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return each band's share (M, K) at wavelengths: straight between bands, even beyond them."""
    return np.stack([np.interp(wavelengths_nm, nm, one) for one in np.eye(len(nm))])


def _sorted(path: Path, bands: Bands) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return planes, float32, none negative, by rising wavelengths that are computed."""
    nm = np.asarray(bands.wavelengths_nm, np.float64).ravel()
    planes, notes = bands.planes, bands.notes
    checked_size(path, planes.shape)
    if len(nm) != len(planes) or not np.all((nm > 0) & (nm < np.inf)):
        raise UserError(
            "not one wavelength a band",
            file=path,
            field="wavelengths",
            value=f"{len(nm)} for {len(planes)} bands",
            allowed="one each, above 0",
        )
    inside = np.flatnonzero((nm >= SHORTEST_NM) & (nm <= LONGEST_NM))
    order = inside[np.argsort(nm[inside], kind="stable")]
    order = order[np.diff(nm[order], prepend=-np.inf) > 1e-6]  # one of two at a place
    if not len(order):
        raise UserError(
            "no band of light that is computed",
            file=path,
            field="wavelengths",
            value=f"{nm.min():g} to {nm.max():g} nm",
            allowed=f"{SHORTEST_NM:g} to {LONGEST_NM:g} nm",
        )
    if len(order) < len(nm):
        notes += (f"{len(nm) - len(order)} bands left out: beyond what is computed, or double",)
    nm, planes = nm[order], planes[order]
    groups = _groups(nm)
    if groups.max() + 1 < len(nm):
        notes += (f"{len(nm)} bands averaged to {groups.max() + 1}, {STEP_NM:g} nm apart or more",)
        count = np.bincount(groups)
        nm = np.bincount(groups, nm) / count
        starts = np.flatnonzero(np.diff(groups, prepend=-1))
        planes = np.add.reduceat(planes, starts, axis=0, dtype=np.float32)
        planes /= count[:, None, None]
    planes = np.ascontiguousarray(planes, np.float32)
    low, high = float(planes.min()), float(planes.max())
    if not (np.isfinite([low, high]).all() and high <= LARGEST):
        bad = ~(np.abs(planes) <= LARGEST)
        band, row, col = np.argwhere(bad)[0]
        raise UserError(
            "NaN, infinite, or beyond all light",
            file=path,
            field=f"band {band + 1}",
            value=f"{np.count_nonzero(bad)} samples, first at row {row}, column {col}",
            allowed=f"finite, up to {LARGEST:g}",
        )
    if low < 0:
        notes += (f"{np.count_nonzero(planes < 0)} negative samples set to 0",)
        planes = np.maximum(planes, 0, out=planes if planes is not bands.planes else None)
    return planes, nm, notes


def _groups(nm: np.ndarray) -> np.ndarray:
    """Return the group of each band: those nearer than a step to a group's first are one.

    The spectra are sampled in steps: a finer band would fall between them.
    """
    if len(nm) < 2 or np.diff(nm).min() >= STEP_NM * (1 - 1e-3):
        return np.arange(len(nm))
    return np.unique(np.floor((nm - nm[0]) / STEP_NM + 1e-3), return_inverse=True)[1]


def _white(planes: np.ndarray, nm: np.ndarray, bands: Bands) -> tuple[np.ndarray, str]:
    """Return the white (M,) of a cube, in its samples' unit, and what it is."""
    if bands.lamp is not None:
        own = np.interp(nm, np.asarray(bands.wavelengths_nm, float), bands.lamp)
        return own, "a perfect diffuser in the file's own light"
    mean = planes.mean(axis=(1, 2), dtype=np.float64)
    eye = luminance_cd_m2(_hats(nm, WAVELENGTHS_NM))
    if not (mean @ eye > 0):  # invisible, or dark
        return np.maximum(mean, 1e-30), "the mean of the picture"
    bright = np.quantile(np.tensordot(eye, planes[:, ::4, ::4], axes=1), DARKER)
    return mean * max(bright, 1e-30) / (
        mean @ eye
    ), "of the picture's mean colour, as bright as its brightest 1 %"
