"""Raw files developed by LibRaw."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gpusim.errors import UserError

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
