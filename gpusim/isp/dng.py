"""Raw files in Adobe's Digital Negative format, version 1.4."""

from __future__ import annotations

import math
import struct
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
    "ExifIFD": 34664,  # the next is meant: tifffile does not write it, see _append_exif
    "LinearizationTable": 50712,
    "BlackLevelRepeatDim": 50713,
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
# Fujifilm's filter array: every row and column holds all colours.
XTRANS = np.array(
    [list(row) for row in ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")]
)
DENOMINATOR = 1_000_000  # of rationals: six decimals
LEVEL_DENOMINATOR = 1000  # of black levels: at most 65535, and numerators have 32 bits
EXIF_VERSION, EXIF_ISO = 36864, 34855  # tags of the Exif part
MAX_CODE = 65535
MAX_EXPOSURE_EV = 10.0  # brighter than 2^10, a development shows the quantisation steps of 12 bits


def saturation_dn(sensor: Sensor) -> int:
    """Return the code at which a pixel saturates: the converter's, or the full well's if lower."""
    full_e = sensor.full_well_e
    if sensor.linearity is not None:
        full_e = float(sensor.linearity.read(full_e))
    full = sensor.black_level_dn + sensor.system_gain_dn_per_e * full_e
    return min(sensor.raw_max_dn, math.floor(full))


def linear_dn(sensor: Sensor, codes: np.ndarray) -> np.ndarray:
    """Return what a linear converter would have given in place of some codes, DN."""
    if sensor.linearity is None:
        return np.asarray(codes, np.float64)
    black, gain = sensor.black_level_dn, sensor.system_gain_dn_per_e
    return black + gain * sensor.linearity.collected((codes - black) / gain)


def span_dn(sensor: Sensor) -> float:
    """Return the signal of a saturated pixel of a linear converter, DN."""
    return float(linear_dn(sensor, saturation_dn(sensor))) - sensor.black_level_dn


def linearization_table(sensor: Sensor) -> tuple[np.ndarray, int]:
    """Return what DNG's LinearizationTable makes of each code, and by how much it is scaled.

    The scale is the largest that fits 16 bits, so that rounding takes nothing from the raw. Where
    channels have black levels of their own the table is that of ``black_level_dn``.
    """
    linear = np.maximum(linear_dn(sensor, np.arange(sensor.raw_max_dn + 1)), 0)
    scale = max(1, int(MAX_CODE / linear.max()))
    return np.minimum(np.round(scale * linear), MAX_CODE).astype(np.uint16), scale


def noise_profile(sensor: Sensor) -> tuple[float, float]:
    """Return DNG's NoiseProfile (S, O): the variance is S x + O where x = 0 is black and 1 white.

    Of EMVA 1288's linear camera model, in DN^2: sigma^2 = K^2 sigma_d^2 + 1/12 + K (mu - black).
    """
    span = span_dn(sensor)
    gain = sensor.system_gain_dn_per_e
    dark = (gain * sensor.temporal_dark_noise_e) ** 2 + 1 / 12
    return gain / span, dark / span**2


def _rationals(values: Iterable[float], denominator: int = DENOMINATOR) -> list[int]:
    fractions = [Fraction(round(float(v) * denominator), denominator) for v in values]
    return list(chain.from_iterable((f.numerator, f.denominator) for f in fractions))


def _corners(area: Rect) -> tuple[int, int, int, int]:
    """Return the first row and column of an area, and those behind its last ones."""
    row, col, rows, cols = area
    return row, col, row + rows, col + cols


def has_dng(sensor: Sensor) -> bool:
    """Return whether DNG readers have a sensor's filter array: 2 x 2 of R, G and B, or X-Trans.

    LibRaw and dcraw take other tables for 2 x 2, or two columns of them, and show wrong colours.
    """
    pattern = sensor.cfa.letters
    if np.shape(pattern) == (2, 2):
        return set(chain.from_iterable(pattern)) == set(CHANNELS)
    shifts = np.ndindex(np.shape(XTRANS))
    return any(np.array_equal(pattern, np.roll(XTRANS, shift, (0, 1))) for shift in shifts)


def check_filter_array(sensor: Sensor) -> None:
    """Refuse a filter array that no DNG reader has.

    Raises
    ------
    UserError
        When it is neither 2 x 2 of R, G and B nor X-Trans.
    """
    if not has_dng(sensor):
        raise UserError(
            "no DNG reader has this filter array",
            field="cfa.pattern",
            value=" / ".join("".join(row) for row in sensor.cfa.letters),
            allowed="2 x 2 of R, G and B; or 6 x 6 of X-Trans, from any of its pixels",
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
        Filter array as `has_dng` has it; black levels, bit depth, gain, full well, read noise,
        non-linearity, which readers undo by the table that is written, and quantum efficiencies.
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
    exposure_ev = math.log2(span_dn(sensor) / brightest_dn)
    exposure_ev = min(max(exposure_ev, -MAX_EXPOSURE_EV), MAX_EXPOSURE_EV)
    black_dn, white_dn, scale = (sensor.black_level_dn,), saturation_dn(sensor), 1
    if sensor.channel_black_level_dn:
        black_dn = sensor.site_black_dn
    if sensor.linearity is not None:
        table, scale = linearization_table(sensor)
        black_dn, white_dn = scale * linear_dn(sensor, np.array(black_dn)), int(table[white_dn])
    entries = {
        "DNGVersion": (BYTE, (1, 4, 0, 0)),
        "DNGBackwardVersion": (BYTE, (1, 1, 0, 0)),
        "UniqueCameraModel": (ASCII, f"gpusim {sensor.name}"),
        "Orientation": (SHORT, (1,)),
        "ExposureTime": (RATIONAL, _exposure(exposure_s)),
        "CFARepeatPatternDim": (SHORT, sensor.period),
        "CFAPattern": (BYTE, [CHANNELS.index(letter) for row in pattern for letter in row]),
        "BlackLevel": (RATIONAL, _rationals(black_dn, LEVEL_DENOMINATOR)),
        "WhiteLevel": (LONG, (white_dn,)),
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
    if sensor.channel_black_level_dn:
        entries["BlackLevelRepeatDim"] = (SHORT, sensor.period)
    if sensor.linearity is not None:
        entries["LinearizationTable"] = (SHORT, table.tolist())
    if sensor.iso is not None:
        entries["ExifIFD"] = (LONG, (0,))  # its place is known when the rest is written
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
        if sensor.iso is not None:
            _append_exif(partial, sensor.iso)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError("cannot write the DNG", file=path, value=str(error)) from None


def _append_exif(path: Path, iso: int) -> None:
    """Append the Exif part, with the ISO speed, to a little-endian TIFF that has a tag for it."""
    with path.open("r+b") as file:
        data = file.read()
        file.write(bytes(len(data) % 2))  # parts begin at even places
        (first,) = struct.unpack_from("<I", data, 4)
        (count,) = struct.unpack_from("<H", data, first)
        tags = range(first + 2, first + 2 + 12 * count, 12)
        tag = next(at for at in tags if struct.unpack_from("<H", data, at)[0] == TAGS["ExifIFD"])
        place = file.tell()
        file.write(struct.pack("<H", 2))
        file.write(struct.pack("<HHIHxx", EXIF_ISO, 3, 1, iso))  # type 3: SHORT
        file.write(struct.pack("<HHI4s", EXIF_VERSION, 7, 4, b"0230"))  # type 7: UNDEFINED
        file.write(struct.pack("<I", 0))
        file.seek(tag)
        file.write(struct.pack("<HHII", TAGS["ExifIFD"] + 1, 4, 1, place))  # type 4: LONG


def _exposure(exposure_s: float) -> list[int]:
    """Return the exposure time as a rational, short ones by their inverse: 1/60 as 1 and 60."""
    if exposure_s < 1:
        fraction = 1 / Fraction(1 / exposure_s).limit_denominator(1000)
    else:
        fraction = Fraction(exposure_s).limit_denominator(1000)
    return [fraction.numerator, fraction.denominator]
