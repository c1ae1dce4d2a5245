"""Raw files developed by LibRaw."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

XTRANS_TILE = 512  # pixels, of LibRaw's demosaicing of X-Trans
SRGB_GAMMA = (2.4, 12.92)  # power and slope at black of the sRGB curve, IEC 61966-2-1


def develop(path: str | Path) -> np.ndarray:
    """Develop a raw file to sRGB.

    LibRaw's standard conversion: black level, as-shot white balance, AHD demosaicing, the file's
    colour matrix, sRGB curve; nothing automatic. A DNG's BaselineExposure sets the brightness: what
    `gpusim.isp.dng.write_dng` wrote shows the scene's white as 255. Of other raw files, saturation
    is 255.

    Parameters
    ----------
    path : path
        Of a raw file that LibRaw knows.

    Returns
    -------
    ndarray (rows, cols, 3), uint8

    Raises
    ------
    UserError
        If the file is missing or LibRaw cannot read it.
    """
    import rawpy

    path = Path(path)
    if not path.is_file():
        raise UserError("no such raw file", file=path)
    try:
        with rawpy.imread(str(path)) as raw:
            return raw.postprocess(
                demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
                use_camera_wb=True,
                no_auto_bright=True,
                adjust_maximum_thr=0.0,  # or LibRaw takes the brightest sample for saturation
                bright=2.0 ** _baseline_exposure_ev(path),
                gamma=SRGB_GAMMA,
                output_color=rawpy.ColorSpace.sRGB,
                output_bps=8,
            )
    except rawpy.LibRawError as error:
        raise UserError(
            "LibRaw cannot develop this file",
            file=path,
            value=_text(error),
            allowed="a raw file, such as DNG",
        ) from None


def develops(sensor: Sensor, rows: int, cols: int) -> bool:
    """Return whether LibRaw develops a frame: X-Trans only if it fills one of its tiles."""
    return sensor.period == (2, 2) or min(rows, cols) >= XTRANS_TILE


def undeveloped(raw: np.ndarray, sensor: Sensor, white_e: dict[str, float]) -> np.ndarray:
    """Return the raw frame as a grey picture: each pixel over what it has of the scene's white.

    For filter arrays that no raw developer has; of a monochrome sensor it is the picture.

    Parameters
    ----------
    raw : ndarray (rows, cols)
        Digital numbers of the lit pixels, with the pattern's phase at the first of them.
    sensor : Sensor
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis by channel.

    Returns
    -------
    ndarray (rows, cols, 3), uint8
    """
    rows, cols = (np.arange(n) % step for n, step in zip(raw.shape, sensor.period, strict=True))
    white = np.array([white_e[name] for name in sensor.site_channels()]).reshape(sensor.period)
    black = np.array(sensor.site_black_dn).reshape(sensor.period)
    full = np.maximum(sensor.system_gain_dn_per_e * white, 1e-9)
    light = (raw - black[rows[:, None], cols]) / full[rows[:, None], cols]
    light = np.clip(light, 0.0, 1.0)
    power, slope = SRGB_GAMMA
    shown = np.where(light <= 0.0031308, slope * light, 1.055 * light ** (1 / power) - 0.055)
    return np.repeat(np.round(255 * shown).astype(np.uint8)[:, :, None], 3, axis=2)


def _baseline_exposure_ev(path: Path) -> float:
    """Return BaselineExposure of a DNG; 0 where there is none."""
    from tifffile import TiffFile, TiffFileError

    from gpusim.isp.dng import TAGS

    try:
        with TiffFile(path) as file:
            numerator, denominator = file.pages.first.tags.valueof(
                TAGS["BaselineExposure"], default=(0, 1)
            )
    except TiffFileError:
        return 0.0
    return numerator / denominator


def _text(error: Exception) -> str:
    """Return LibRaw's message, which rawpy passes on as bytes."""
    message = error.args[0] if error.args else ""
    return message.decode(errors="replace") if isinstance(message, bytes) else str(message)
