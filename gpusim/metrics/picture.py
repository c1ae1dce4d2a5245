"""Pictures to measure, channel by channel, linear: raw frames, PNG, JPEG, TIFF, EXR, arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rawpy

from gpusim.config.arrays import read_jpeg, read_npy, read_png, read_tiff
from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.isp.rawfile import read_raw
from gpusim.scene.encoded import PNG, TIFF
from gpusim.scene.exr import library_messages, read_exr

# IEC 61966-2-1: the part near black, and the power.
SRGB_LINEAR, SRGB_POWER = 0.04045, 2.4
LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB, ITU-R BT.709
CLIP_SHARE = 0.998  # of the scale: codes above it count as saturated
PLAIN = (*PNG, ".jpg", ".jpeg", *TIFF)


@dataclass(frozen=True, eq=False)
class Plane:
    """One channel of a picture.

    Attributes
    ----------
    values : ndarray (rows, cols)
        Linear signal; of a raw frame of all channels.
    sites : ndarray (R, C) of bool or None
        Which photosites of the filter array are the channel's; None where all are.
    clip : (float, float)
        Values at which it is black or saturated.
    """

    values: np.ndarray
    sites: np.ndarray | None
    clip: tuple[float, float]


def read_picture(path: Path, *, linear: bool = False) -> dict[str, Plane]:
    """Read a picture's channels by name.

    Parameters
    ----------
    path : path
        A raw frame (DNG and what LibRaw reads), EXR, NumPy array, PNG, JPEG or TIFF.
    linear : bool
        Codes of a PNG, JPEG or TIFF are proportional to light; else they follow the sRGB curve.

    Returns
    -------
    dict of str to Plane
        Filters of a raw frame in their order; ``R``, ``G``, ``B`` and first the luminance ``Y`` of
        a colour picture; ``Y`` alone of a grey one.

    Raises
    ------
    UserError
        The file cannot be read, or is no picture.
    """
    try:
        suffix = path.suffix.lower()
        if suffix == ".exr":
            rgb = read_exr(path, needs_luminance=False).rgb
            return _colours(np.moveaxis(rgb, 0, -1), -np.inf, np.inf)
        if suffix == ".npy":
            return _colours(read_npy(path), -np.inf, np.inf)
        own = read_raw(path) if suffix in (".dng", *TIFF) else None
        if own is not None:
            return _filters(own.signal_dn, own.pattern, own.span_dn)
        if suffix in PLAIN:
            return _plain(path, linear)
        with library_messages(), rawpy.imread(str(path)) as raw:
            return _raw(raw)
    except UserError:
        raise
    except Exception as error:  # whatever a broken file makes of the libraries
        raise UserError(
            f"The picture cannot be read: {str(error) or type(error).__name__}",
            file=path,
            allowed="a raw frame that LibRaw reads, .exr, .npy, .png, .jpg or .tif",
        ) from None


def most_frequent(planes: dict[str, Plane]) -> str:
    """Return the channel of the most photosites: of a picture without a filter array the first."""
    return max(
        planes, key=lambda name: 1.0 if planes[name].sites is None else planes[name].sites.mean()
    )


def _filters(signal: np.ndarray, pattern: tuple[str, ...], span: float) -> dict[str, Plane]:
    letters = np.array([list(row) for row in pattern])
    names = list(dict.fromkeys(letters.ravel()))
    return {
        str(name): Plane(
            signal, letters == name if len(names) > 1 else None, (-np.inf, CLIP_SHARE * span)
        )
        for name in names
    }


def _raw(raw: rawpy.RawPy) -> dict[str, Plane]:
    """Return the filters of a frame that LibRaw read, less their black levels."""
    black = np.array(raw.black_level_per_channel, np.float32)
    if raw.raw_pattern is None:
        values = raw.raw_image_visible.astype(np.float32)
        values = values.mean(axis=2) if values.ndim == 3 else values
        return {
            "Y": Plane(
                values - black[0], None, (-np.inf, CLIP_SHARE * (raw.white_level - black[0]))
            )
        }
    values = raw.raw_image_visible - black[raw.raw_colors_visible]
    letters = raw.color_desc.decode()
    pattern = tuple("".join(letters[at] for at in row) for row in raw.raw_pattern)
    return _filters(values, pattern, float(raw.white_level - black.mean()))


def _plain(path: Path, linear: bool) -> dict[str, Plane]:
    suffix = path.suffix.lower()
    if suffix in TIFF:
        codes = read_tiff(path)
    else:
        codes = (read_png if suffix in PNG else read_jpeg)(read_bytes(path, "the picture"))
    if codes.dtype.kind not in "uf":
        raise ValueError(f"samples of type {codes.dtype}")
    most = 1.0 if codes.dtype.kind == "f" else float(np.iinfo(codes.dtype).max)
    light = codes / most
    if not linear:
        curve = ((light + 0.055) / 1.055) ** SRGB_POWER
        light = np.where(light <= SRGB_LINEAR, light / 12.92, curve)
    return _colours(light, 0.0 if most > 1 else -np.inf, 1.0 if most > 1 else np.inf)


def _colours(values: np.ndarray, low: float, high: float) -> dict[str, Plane]:
    """Return the channels of an array (rows, cols) or (rows, cols, 1 to 4)."""
    values = np.asarray(values)
    if values.dtype.kind not in "uif" or values.ndim not in (2, 3) or 0 in values.shape:
        raise ValueError(f"an array of {values.dtype} of shape {values.shape}")
    clip = low, high
    if values.ndim == 2 or values.shape[2] < 3:
        return {"Y": Plane(values if values.ndim == 2 else values[..., 0], None, clip)}
    planes = {name: Plane(values[..., at], None, clip) for at, name in enumerate("RGB")}
    return {"Y": Plane(values[..., :3] @ np.array(LUMINANCE), None, clip), **planes}
