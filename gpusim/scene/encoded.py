"""Pictures of other programs as scenes: TIFF, PNG and JPEG of a stated transfer, camera raws."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path

import numpy as np

from gpusim.config.arrays import MOST_RATIO, opened_tiff, read_jpeg, read_png
from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.scene.exr import MOST_PIXELS, Photograph, _check, _into_gamut, library_messages
from gpusim.scene.medium import is_table, light_of

TIFF, PNG, JPEG = (".tif", ".tiff"), (".png",), (".jpg", ".jpeg")
ENCODED = (*TIFF, *PNG, *JPEG)
RAWS = (".3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .iiq .kdc .mef .mos .mrw .nef .nrw .orf .pef "
        ".raf .rw2 .rwl .sr2 .srf .srw .x3f").split()  # fmt: skip
GAMMA = re.compile(r"gamma ?(\d(?:\.\d{1,4})?)", re.ASCII)
TRANSFERS = "linear, srgb, rec709, gamma2.2 (1 to 4), or a table: FILE.cube"


def linear(encoded: np.ndarray, transfer: str, path: Path) -> np.ndarray:
    """Return the light that values from 0 to 1 stand for, 1 for 1.

    Parameters
    ----------
    encoded : ndarray
    transfer : str
        "linear"; "srgb" (IEC 61966-2-1); "rec709", the inverse of the camera's curve (ITU-R
        BT.709-6, 1.2); "gamma2.2", the power 2.2.
    path : Path
        Path of the picture, for the message.

    Raises
    ------
    UserError
        For another name.
    """
    gamma = GAMMA.fullmatch(transfer)
    if transfer == "linear":
        return encoded
    if transfer == "srgb":
        high = ((np.maximum(encoded, 0.0) + 0.055) / 1.055) ** 2.4
        return np.where(encoded <= 0.04045, encoded / 12.92, high)
    if transfer == "rec709":
        high = ((np.maximum(encoded, 0.0) + 0.099) / 1.099) ** (1 / 0.45)
        return np.where(encoded < 0.081, encoded / 4.5, high)
    if gamma and 1 <= float(gamma[1]) <= 4:
        return np.maximum(encoded, 0.0) ** float(gamma[1])
    raise UserError(
        "there is no such transfer function",
        file=path,
        field="transfer",
        value=transfer,
        allowed=TRANSFERS,
    )


def read_encoded(path: Path, transfer: str | None) -> Photograph:
    """Read a TIFF, PNG or JPEG: grey or RGB, 8 or 16 bits or floats, with Rec.709's primaries.

    Parameters
    ----------
    path : Path
    transfer : str or None
        As `linear` takes it, or the .cube file of a table (`gpusim.scene.medium`). Floats are
        linear without; whole numbers say nothing of it.

    Raises
    ------
    UserError
        Where it is no such picture, or its transfer function is not said.
    """
    pixels = _tiff(path) if path.suffix.lower() in TIFF else _by_pillow(path)
    whole = pixels.dtype.kind in "ub"
    if transfer is None and whole:
        raise UserError(
            "the picture does not say what light its values stand for",
            file=path,
            field="transfer",
            allowed=f"--transfer: {TRANSFERS}",
        )
    if whole:
        scaled = pixels.astype(np.float64) / np.iinfo(pixels.dtype).max
    else:
        scaled = pixels.astype(np.float64)
        _check(path, "", pixels.reshape(len(pixels), -1))
    if transfer is not None and is_table(transfer):
        rgb = light_of(scaled, Path(transfer))
    else:
        rgb = linear(scaled, transfer or "linear", path)
    rgb = np.stack([rgb] * 3) if rgb.ndim == 2 else np.moveaxis(rgb[..., :3], -1, 0)
    rgb, moved = _into_gamut(rgb, rgb_to_xyz(REC709_CHROMATICITIES)[1])
    bits = f"{8 * pixels.dtype.itemsize}-bit {'whole numbers' if whole else 'floats'}"
    medium = Path(transfer or "linear").name
    notes = (f"{bits}, transfer function {medium}, primaries of Rec.709",)
    if moved:
        notes += (f"{moved} negative pixels moved to the boundary of Rec.709, luminance kept",)
    return Photograph(rgb.astype(np.float32), (1.0, 1.0, 1.0), None, notes)


def read_raw_scene(path: Path) -> Photograph:
    """Read a camera's raw: demosaiced, linear, in Rec.709 by the camera's own colour matrix.

    LibRaw develops it with the white balance of the shot, without a tone curve.

    Raises
    ------
    UserError
        Where LibRaw cannot read it, or it is larger than any that is read.
    """
    import rawpy

    content = read_bytes(path, "the raw")
    try:
        with library_messages(), rawpy.imread(io.BytesIO(content)) as raw:
            pixels = raw.sizes.raw_width * raw.sizes.raw_height
            if pixels > MOST_PIXELS:
                raise _refused(path, f"{pixels:,} pixels")
            rgb = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                use_camera_wb=True,
                output_color=rawpy.ColorSpace.sRGB,
                highlight_mode=rawpy.HighlightMode.Clip,
            )
    except (rawpy.LibRawError, ValueError, MemoryError) as error:
        raise _refused(path, str(error) or type(error).__name__) from None
    if rgb.ndim != 3 or rgb.shape[2] != 3:
        raise _refused(path, f"{rgb.shape[-1]} colours")
    planes = np.moveaxis(rgb.astype(np.float32) / 65535, -1, 0)
    notes = (
        "a raw developed by LibRaw: demosaiced, white balance of the shot, linear; its highlights "
        "end where the camera's did",
    )
    return Photograph(np.ascontiguousarray(planes), (1.0, 1.0, 1.0), None, notes)


def _refused(path: Path, reason: str) -> UserError:
    return UserError(
        "no raw that can be read", file=path, value=reason,
        allowed=f"what LibRaw reads, up to {MOST_PIXELS:,} pixels",
    )  # fmt: skip


def _tiff(path: Path) -> np.ndarray:
    content = read_bytes(path, "the picture")
    try:
        with warnings.catch_warnings(), opened_tiff(io.BytesIO(content)) as file:
            warnings.simplefilter("ignore")
            page = file.pages[0]
            problem = _unfit(page.shape, page.dtype, len(content))
            if problem is None:
                pixels = page.asarray()
                # Planes apart: (3, rows, cols).
                if pixels.ndim == 3 and pixels.shape[0] in (3, 4) and page.planarconfig == 2:
                    pixels = np.moveaxis(pixels, 0, -1)
                problem = _unfit(pixels.shape, pixels.dtype, len(content))
    except Exception as error:  # tifffile has its own and those of what is missing in a file
        problem = str(error) or type(error).__name__
    if problem:
        raise _no_picture(path, problem)
    return pixels


def _by_pillow(path: Path) -> np.ndarray:
    reader = read_png if path.suffix.lower() in PNG else read_jpeg
    try:
        pixels = reader(read_bytes(path, "the picture"))
    except UserError:
        raise
    except Exception as error:  # Pillow has its own and those of what is missing in a file
        raise _no_picture(path, str(error) or type(error).__name__) from None
    if pixels.ndim == 3:  # without transparency
        pixels = pixels[..., :3] if pixels.shape[2] > 2 else pixels[..., 0]
    return pixels if pixels.dtype != bool else 255 * pixels.astype(np.uint8)


def _unfit(shape: tuple[int, ...], dtype: np.dtype | None, nbytes: int) -> str | None:
    """Return why an array is no picture in a file of so many bytes; None for one that is."""
    if dtype is None or dtype.str[1:] not in ("u1", "u2", "f2", "f4", "f8"):
        return f"values of type {dtype}"
    if len(shape) not in (2, 3) or 0 in shape or (len(shape) == 3 and min(shape) > 4):
        return f"an array of {' x '.join(map(str, shape))}"
    count = np.prod(shape, dtype=float)
    if count > 4 * MOST_PIXELS or count * dtype.itemsize > MOST_RATIO * nbytes:
        return f"{' x '.join(map(str, shape))} values"
    return None


def _no_picture(path: Path, reason: str) -> UserError:
    return UserError(
        "no picture that can be read",
        file=path,
        value=reason,
        allowed="grey or RGB, 8 or 16 bits or floats",
    )
