"""Raw files developed by LibRaw, to compare our own development with."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.isp.quad import PERIOD, quad_phase, write_bayer
from gpusim.isp.rawfile import RAW_FILES, RawFile, read_raw
from gpusim.isp.settings import check_ev
from gpusim.isp.source import baseline_ev
from gpusim.scene.colorimetry import encode_srgb
from gpusim.sensor.cfa import PATTERNS

# LibRaw refuses frames of less than 22 pixels a side; its demosaicing of X-Trans needs a whole tile
# of 512.
LEAST_SIDE, XTRANS_TILE = 24, 512
FULL = 65535  # of linear samples


def develop_by_libraw(path: Path, ev: float = 0.0, *, binned: bool = False) -> np.ndarray:
    """Develop a raw file to sRGB by LibRaw.

    Black level, as-shot white balance, demosaicing by AHD, the file's colour matrix, sRGB curve;
    nothing automatic, so that a picture is as bright as its exposure made it. White is where the
    first channel saturates: see `toned` for brighter and darker ones. Quad Bayer frames become
    Bayer first.

    Parameters
    ----------
    path : Path
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
        If the file is missing, LibRaw has no such filter array or size or cannot read it, `ev` is
        no number of stops, or there is nothing to bin.
    """
    check_ev(ev)
    if not os.path.isfile(path):
        raise UserError("no such raw file", file=path, allowed=RAW_FILES)
    try:
        raw = read_raw(path)
    except ValueError as error:
        raise _undevelopable(path, error) from None
    ev += baseline_ev(path)
    is_quad = raw is not None and quad_phase(raw.pattern) is not None
    if binned and not is_quad:
        raise UserError("there is nothing to bin: no quad Bayer", file=path, field="--binned")
    if is_quad and min(raw.signal_dn.shape) >= 2 * PERIOD:
        with tempfile.TemporaryDirectory() as folder:
            bayer = Path(folder) / "bayer.dng"
            write_bayer(raw, bayer, binned=binned)
            return develop_by_libraw(bayer, ev - baseline_ev(bayer))
    if raw is not None and not _is_known(raw):
        raise UserError(
            "LibRaw cannot develop this filter array, or a frame as small",
            file=path,
            value=f"{' '.join(raw.pattern)}, {raw.signal_dn.shape[1]} x {raw.signal_dn.shape[0]}",
            allowed="--engine gpusim",
        )
    light = np.arange(FULL + 1) / FULL
    return np.round(255 * encode_srgb(toned(light, ev))).astype(np.uint8)[_linear(path)]


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


def _is_known(raw: RawFile) -> bool:
    """Return whether LibRaw has a file's filter array, at its size."""
    least = min(raw.signal_dn.shape)
    sites = np.array([list(row) for row in raw.pattern])
    if sites.shape == (2, 2):
        return set(raw.colours) == set("RGB") and least >= LEAST_SIDE
    fuji = np.array([list(row) for row in PATTERNS["X-Trans"]])
    shifted = (np.roll(fuji, shift, (0, 1)) for shift in np.ndindex(fuji.shape))
    return least >= XTRANS_TILE and any(np.array_equal(sites, one) for one in shifted)


def _linear(path: Path) -> np.ndarray:
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
