"""Raw files in Adobe's Digital Negative format, version 1.4."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import gpusim
from gpusim.errors import UserError
from gpusim.isp.colour import CHANNELS, LIGHT_SOURCE, colour_matrix, response

if TYPE_CHECKING:
    from collections.abc import Iterable

    from gpusim.sensor.frame import Rect
    from gpusim.sensor.sensor import Sensor

# Tags by name: TIFF/EP (ISO 12234-2), Exif 2.3 and chapter 4 of the DNG specification 1.4.
TAGS = {
    "Orientation": 274,
    "ExposureTime": 33434,
    "CFARepeatPatternDim": 33421,
    "CFAPattern": 33422,
    "DNGVersion": 50706,
    "DNGBackwardVersion": 50707,
    "UniqueCameraModel": 50708,
    "BlackLevel": 50714,
    "WhiteLevel": 50717,
    "DefaultCropOrigin": 50719,
    "DefaultCropSize": 50720,
    "ColorMatrix1": 50721,
    "ColorMatrix2": 50722,
    "AsShotNeutral": 50728,
    "BaselineExposure": 50730,
    "CalibrationIlluminant1": 50778,
    "CalibrationIlluminant2": 50779,
    "ActiveArea": 50829,
    "MaskedAreas": 50830,
    "NoiseProfile": 51041,
}
BYTE, ASCII, SHORT, LONG, RATIONAL, SRATIONAL, DOUBLE = "B", "s", "H", "I", "2I", "2i", "d"
DENOMINATOR = 1_000_000  # of rationals: six decimals
MAX_EXPOSURE_EV = 10.0  # brighter than 2^10, a development shows the quantisation steps of 12 bits


def saturation_dn(sensor: Sensor) -> int:
    """Return the code at which a pixel saturates: the converter's, or the full well's if lower."""
    full = sensor.black_level_dn + sensor.system_gain_dn_per_e * sensor.full_well_e
    return min(sensor.max_dn, math.floor(full))


def noise_profile(sensor: Sensor) -> tuple[float, float]:
    """Return DNG's NoiseProfile (S, O): the variance is S x + O where x = 0 is black and 1 white.

    Of EMVA 1288's linear camera model, in DN^2: sigma^2 = K^2 sigma_d^2 + 1/12 + K (mu - black).
    """
    span = saturation_dn(sensor) - sensor.black_level_dn
    gain = sensor.system_gain_dn_per_e
    dark = (gain * sensor.temporal_dark_noise_e) ** 2 + 1 / 12
    return gain / span, dark / span**2


def _rationals(values: Iterable[float]) -> list[int]:
    fractions = [Fraction(round(float(v) * DENOMINATOR), DENOMINATOR) for v in values]
    return list(chain.from_iterable((f.numerator, f.denominator) for f in fractions))


def _corners(area: Rect) -> tuple[int, int, int, int]:
    """Return the first row and column of an area, and those behind its last ones."""
    row, col, rows, cols = area
    return row, col, row + rows, col + cols


def check_filter_array(sensor: Sensor) -> None:
    """Refuse a filter array that no DNG reader has.

    Raises
    ------
    UserError
        When it is not 2 x 2 of R, G and B.
    """
    pattern = sensor.cfa.letters
    if np.shape(pattern) != (2, 2) or set(chain.from_iterable(pattern)) != set(CHANNELS):
        raise UserError(
            "no DNG reader has this filter array",
            field="cfa.pattern",
            value=pattern,
            allowed="2 x 2 of R, G and B",
        )


def write_dng(
    path: str | Path,
    raw: np.ndarray,
    sensor: Sensor,
    *,
    white_e: dict[str, float],
    exposure_s: float,
    transmission: np.ndarray | None = None,
    active_area: Rect | None = None,
    masked_areas: Iterable[Rect] = (),
) -> None:
    """Write a raw frame to a DNG file, which appears whole or not at all.

    The same arguments give the same bytes: there is no time stamp. The colour matrices, under
    illuminants A and D65 as cameras carry them, are those of the camera; the scene's light is in
    AsShotNeutral. BaselineExposure is such that the scene's white develops to white.

    Parameters
    ----------
    path : path
        Of the file.
    raw : ndarray (rows, cols), uint16
        Digital numbers, those of the optical black included.
    sensor : Sensor
        Filter array of 2 x 2, of R, G and B; black level, bit depth, gain, full well, read noise,
        quantum efficiencies.
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis by channel.
    exposure_s : float
        Exposure time, s.
    transmission : ndarray (61,), optional
        Of the lens, to a common factor; neutral if not given.
    active_area : (row, col, rows, cols), optional
        Where the lit pixels lie in the raw, with the filter pattern's phase at the first of them.
        By default the whole raw is lit.
    masked_areas : iterable of (row, col, rows, cols)
        Where pixels that are shielded from light do: LibRaw and dcraw take the black level there.

    Raises
    ------
    UserError
        If DNG readers have no such filter array, or the file cannot be written.
    """
    from tifffile import imwrite

    path = Path(path)
    pattern = sensor.cfa.letters
    check_filter_array(sensor)
    row, col, rows, cols = active_area or (0, 0, *raw.shape)
    camera = response(sensor.colour_qe, transmission)
    white = sensor.by_colour(white_e)
    neutral = np.array([white[colour] for colour in CHANNELS], np.float64)
    brightest_dn = sensor.system_gain_dn_per_e * neutral.max()
    exposure_ev = math.log2((saturation_dn(sensor) - sensor.black_level_dn) / brightest_dn)
    exposure_ev = min(max(exposure_ev, -MAX_EXPOSURE_EV), MAX_EXPOSURE_EV)
    entries = {
        "DNGVersion": (BYTE, (1, 4, 0, 0)),
        "DNGBackwardVersion": (BYTE, (1, 1, 0, 0)),
        "UniqueCameraModel": (ASCII, f"gpusim {sensor.name}"),
        "Orientation": (SHORT, (1,)),
        "ExposureTime": (RATIONAL, _exposure(exposure_s)),
        "CFARepeatPatternDim": (SHORT, (2, 2)),
        "CFAPattern": (BYTE, [CHANNELS.index(letter) for row in pattern for letter in row]),
        "BlackLevel": (RATIONAL, _rationals([sensor.black_level_dn])),
        "WhiteLevel": (LONG, (saturation_dn(sensor),)),
        "DefaultCropOrigin": (LONG, (0, 0)),
        "DefaultCropSize": (LONG, (cols, rows)),
        "ActiveArea": (LONG, _corners((row, col, rows, cols))),
        "CalibrationIlluminant1": (SHORT, (LIGHT_SOURCE["A"],)),
        "CalibrationIlluminant2": (SHORT, (LIGHT_SOURCE["D65"],)),
        "ColorMatrix1": (SRATIONAL, _rationals(colour_matrix(camera, "A").flat)),
        "ColorMatrix2": (SRATIONAL, _rationals(colour_matrix(camera, "D65").flat)),
        "AsShotNeutral": (RATIONAL, _rationals(neutral / neutral.max())),
        "BaselineExposure": (SRATIONAL, _rationals([exposure_ev])),
        "NoiseProfile": (DOUBLE, noise_profile(sensor)),
    }
    if masked := [_corners(area) for area in masked_areas]:
        entries["MaskedAreas"] = (LONG, list(chain.from_iterable(masked)))
    tags = []
    for name, (kind, values) in entries.items():
        count = len(values) // 2 if kind in (RATIONAL, SRATIONAL) else len(values)
        content = tuple(values) if not isinstance(values, str) and len(values) > 1 else values
        tags.append((TAGS[name], kind, count, content, True))
    partial = path.with_name(f".{path.name}.part")
    try:
        imwrite(
            partial,
            np.ascontiguousarray(raw, np.uint16),
            byteorder="<",
            photometric="CFA",
            subfiletype=0,
            metadata=None,
            software=f"gpusim {gpusim.__version__}",
            extratags=sorted(tags),
        )
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError("cannot write the DNG", file=path, value=str(error)) from None


def _exposure(exposure_s: float) -> list[int]:
    """Return the exposure time as a rational, short ones by their inverse: 1/60 as 1 and 60."""
    if exposure_s < 1:
        fraction = 1 / Fraction(1 / exposure_s).limit_denominator(1000)
    else:
        fraction = Fraction(exposure_s).limit_denominator(1000)
    return [fraction.numerator, fraction.denominator]
