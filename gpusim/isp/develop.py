"""Raw files developed into sRGB pictures: by LibRaw, or where it cannot, here."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.isp import tiff
from gpusim.isp.demosaic import planes
from gpusim.isp.dng import TAGS
from gpusim.isp.quad import PERIOD, quad_phase, write_bayer
from gpusim.isp.rawfile import RawFile, read_raw
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, encode_srgb, rgb_to_xyz

# LibRaw refuses frames of less than 22 pixels a side; its demosaicing of X-Trans needs a whole tile
# of 512.
LEAST_SIDE, XTRANS_TILE = 24, 512
XTRANS = ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
FULL = 65535  # of linear samples
LARGEST_EV = 20.0


def develop(path: str | Path, ev: float = 0.0, *, binned: bool = False) -> np.ndarray:
    """Develop a raw file to sRGB.

    Black level, as-shot white balance, demosaicing, the file's colour matrix, sRGB curve; nothing
    automatic, so that a picture is as bright as its exposure made it. White is where the first
    channel saturates: see `toned` for brighter and darker ones. LibRaw does it, with AHD
    demosaicing. Quad Bayer frames become Bayer first. Arrays that LibRaw has not, monochrome ones
    and small frames are interpolated by `gpusim.isp.demosaic`; of less than three colours the
    picture is grey.

    Parameters
    ----------
    path : path
        The raw file, one that LibRaw knows or that `gpusim.isp.dng.write_dng` wrote.
    ev : float
        By how many stops to show it brighter, beside a DNG's BaselineExposure.
    binned : bool
        Whether a quad Bayer frame gets one pixel for each cell of 2 x 2; else all, remosaiced.

    Returns
    -------
    ndarray (rows, cols, 3), uint8

    Raises
    ------
    UserError
        If the file is missing or cannot be read, `ev` is no number of stops, or there is nothing to
        bin.
    """
    path = Path(path)
    check_ev(ev)
    if not path.is_file():
        raise UserError("no such raw file", file=path)
    try:
        raw = read_raw(path)
    except ValueError as error:
        raise _undevelopable(path, error) from None
    ev += _baseline_exposure_ev(path)
    is_quad = raw is not None and quad_phase(raw.pattern) is not None
    if binned and not is_quad:
        raise UserError("there is nothing to bin: no quad Bayer", file=path, field="--binned")
    if is_quad and min(raw.signal_dn.shape) >= 2 * PERIOD:
        with tempfile.TemporaryDirectory() as folder:
            bayer = Path(folder) / "bayer.dng"
            write_bayer(raw, bayer, binned=binned)
            return develop(bayer, ev - _baseline_exposure_ev(bayer))
    linear = _by_libraw(path) if raw is None or _has_libraw(raw) else _here(raw)
    light = np.arange(FULL + 1) / FULL
    return np.round(255 * encode_srgb(toned(light, ev))).astype(np.uint8)[linear]


def check_ev(ev: float) -> None:
    """Refuse what is no number of stops.

    Raises
    ------
    UserError
    """
    if not abs(ev) <= LARGEST_EV:
        raise UserError(
            "not a number of stops",
            field="--ev",
            value=ev,
            allowed=f"{-LARGEST_EV:g} to {LARGEST_EV:g}",
        )


def toned(light: np.ndarray, ev: float) -> np.ndarray:
    """Return light, 0..1, that is shown brighter by some stops; 1 remains 1.

    What is brighter than white is clipped. Where it is shown darker, light up to a quarter is
    scaled, and from there a parabola of the same slope rises to white: so saturation never is grey
    (Adobe's DNG SDK 1.4, dng_function_exposure_tone).
    """
    slope = 2.0**ev
    if slope >= 1:
        return np.minimum(light * slope, 1.0)
    a = 16 / 9 * (1 - slope)
    b = slope - a / 2
    return np.where(light <= 0.25, light * slope, (a * light + b) * light + 1 - a - b)


def _has_libraw(raw: RawFile) -> bool:
    """Return whether LibRaw has a file's filter array, at its size."""
    least = min(raw.signal_dn.shape)
    sites = np.array([list(row) for row in raw.pattern])
    if sites.shape == (2, 2):
        return set(raw.colours) == set("RGB") and least >= LEAST_SIDE
    fuji = np.array([list(row) for row in XTRANS])
    shifted = (np.roll(fuji, shift, (0, 1)) for shift in np.ndindex(fuji.shape))
    return least >= XTRANS_TILE and any(np.array_equal(sites, one) for one in shifted)


def _by_libraw(path: Path) -> np.ndarray:
    """Return linear sRGB of a file, 0 to `FULL` where the first channel saturates."""
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            return raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
                use_camera_wb=True,
                no_auto_bright=True,
                adjust_maximum_thr=0.0,  # or LibRaw takes the brightest sample for saturation
                gamma=(1, 1),
                output_color=rawpy.ColorSpace.sRGB,
                output_bps=16,
            )
    except rawpy.LibRawError as error:
        raise _undevelopable(path, error) from None


def _here(raw: RawFile) -> np.ndarray:
    """Return the same without LibRaw: clipped at saturation, balanced and converted."""
    light = planes(raw.signal_dn / np.float32(raw.span_dn), raw.pattern, raw.colours)
    if len(raw.colours) < 3:
        neutral = raw.value("AsShotNeutral") if len(raw.colours) == 2 else np.ones(1)
        grey = np.mean([plane / n for plane, n in zip(light, neutral, strict=True)], axis=0)
        rgb = np.repeat(grey[:, :, None], 3, axis=2)
    else:
        # As LibRaw does: channels balanced to the as-shot white, and the matrix for D65 scaled so
        # that equal channels are the white of sRGB.
        neutral = raw.value("AsShotNeutral")[:, None, None]
        light = np.clip(light / neutral.astype(np.float32), 0, 1)
        space = rgb_to_xyz(REC709_CHROMATICITIES)
        camera = raw.value("ColorMatrix2").reshape(-1, 3) @ space
        to_rgb = np.linalg.pinv(camera / camera.sum(axis=1, keepdims=True))
        rgb = np.tensordot(light, to_rgb.T.astype(np.float32), axes=(0, 0))
    return np.round(FULL * np.clip(rgb, 0, 1)).astype(np.uint16)


def _baseline_exposure_ev(path: Path) -> float:
    """Return BaselineExposure of a DNG; 0 where there is none."""
    try:
        tags, _ = tiff.read_tags(path)
        (stops,) = tiff.numbers(tags[TAGS["BaselineExposure"]])
    except (ValueError, LookupError):
        return 0.0
    return float(stops) if math.isfinite(stops) else 0.0


def _undevelopable(path: Path, error: Exception) -> UserError:
    message = error.args[0] if error.args else ""
    # LibRaw's, which rawpy passes on as bytes.
    text = message.decode(errors="replace") if isinstance(message, bytes) else str(message)
    return UserError(
        "LibRaw cannot develop this file",
        file=path,
        value=text,
        allowed="a raw file, such as DNG",
    )
