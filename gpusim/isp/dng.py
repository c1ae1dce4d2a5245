"""Raw files in Adobe's Digital Negative format, version 1.4."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

import numpy as np

import gpusim
from gpusim.isp import tiff
from gpusim.isp.colour import LIGHT_SOURCE, colour_matrix, forward_matrix, response
from gpusim.isp.lens_tags import Optics, opcodes
from gpusim.isp.levels import (
    iso_speed,
    linear_dn,
    linearization_table,
    noise_profile,
    saturation_dn,
)
from gpusim.isp.tiff import ASCII, BYTE, DOUBLE, LONG, RATIONAL, SHORT, SRATIONAL, UNDEFINED
from gpusim.sensor.cfa import CFA_LETTERS
from gpusim.sensor.frame import Rect
from gpusim.sensor.sensor import Sensor

# Tags by name: TIFF 6.0, TIFF/EP (ISO 12234-2) and chapter 4 of the DNG specification 1.4.
TAGS = {
    "NewSubfileType": 254,
    "PhotometricInterpretation": 262,
    "ImageDescription": 270,
    "Make": 271,
    "Model": 272,
    "Orientation": 274,
    "XResolution": 282,
    "YResolution": 283,
    "ResolutionUnit": 296,
    "Software": 305,
    "DateTime": 306,
    "CFARepeatPatternDim": 33421,
    "CFAPattern": 33422,
    "DNGVersion": 50706,
    "DNGBackwardVersion": 50707,
    "UniqueCameraModel": 50708,
    "CFAPlaneColor": 50710,
    "CFALayout": 50711,
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
    "CameraSerialNumber": 50735,
    "LensInfo": 50736,
    "CalibrationIlluminant1": 50778,
    "CalibrationIlluminant2": 50779,
    "ActiveArea": 50829,
    "MaskedAreas": 50830,
    "ForwardMatrix1": 50964,
    "ForwardMatrix2": 50965,
    "NoiseProfile": 51041,
    "OpcodeList3": 51022,
}
# Tags of the Exif part: Exif 2.31.
EXIF = {
    "ExposureTime": 33434,
    "FNumber": 33437,
    "ISO": 34855,
    "SensitivityType": 34864,
    "ExifVersion": 36864,
    "DateTimeOriginal": 36867,
    "DateTimeDigitized": 36868,
    "OffsetTime": 36880,
    "OffsetTimeOriginal": 36881,
    "OffsetTimeDigitized": 36882,
    "ShutterSpeedValue": 37377,
    "FocalLength": 37386,
    "FlashpixVersion": 40960,
    "ColorSpace": 40961,
    "FocalPlaneXResolution": 41486,
    "FocalPlaneYResolution": 41487,
    "FocalPlaneResolutionUnit": 41488,
    "BodySerialNumber": 42033,
    "LensInfo": 42034,
    "LensModel": 42036,
}
MAKE = "gpusim"
# PhotometricInterpretation.
BLACK_IS_ZERO, CFA, LINEAR_RAW = 1, 32803, 34892
# What Adobe's DNG SDK 1.4 takes: kMaxColorPlanes, kMaxCFAPattern.
MAX_COLOURS, MAX_PERIOD = 4, 8
SENSITIVITY_UNKNOWN, SENSITIVITY_ISO = 0, 3  # SensitivityType: as the maker names it; ISO speed
CENTIMETRE = 3  # ResolutionUnit


def photometric(sensor: Sensor) -> int:
    """Return DNG's PhotometricInterpretation of a sensor's raw; that of plain TIFF if it has none.

    A filter array is CFA, one colour alone LinearRaw. DNG has no more than `MAX_COLOURS` colours
    and no larger patterns than `MAX_PERIOD`.
    """
    colours = {letter for row in sensor.cfa.letters for letter in row}
    if len(colours) == 1:
        return LINEAR_RAW
    fits = len(colours) <= MAX_COLOURS and max(sensor.period) <= MAX_PERIOD
    return CFA if fits else BLACK_IS_ZERO


def has_dng(sensor: Sensor) -> bool:
    """Return whether DNG has a way to say what a sensor's raw is."""
    return photometric(sensor) != BLACK_IS_ZERO


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
    optics: Optics | None = None,
    place: tuple[int, int] = (0, 0),
    temperature_c: float | None = None,
    ev: float = 0.0,
    taken: datetime | None = None,
) -> None:
    """Write a raw frame to a DNG file, which appears whole or not at all.

    The same arguments give the same bytes. The colour matrices, under illuminants A and D65 as
    cameras carry them, are those of the camera; the scene's light is in AsShotNeutral. White is
    where the first channel saturates: BaselineExposure is 0 but for `ev`. Where DNG has no way to
    say what the raw is (`has_dng`), the file is a TIFF with the same tags.

    Parameters
    ----------
    path : path
        Path of the file.
    raw : ndarray (rows, cols), uint16
        Digital numbers, those of the optical black included.
    sensor : Sensor
        Filter array; black levels, bit depth, gain, full well, temporal noise, non-linearity, which
        readers undo by the table that is written, and quantum efficiencies.
    white_e : dict of str to float
        Mean electrons that the scene's white makes on the axis by channel.
    exposure_s : float
        Exposure time, s. Exif's rationals end at 2.3e-10 s: ShutterSpeedValue, the logarithm, holds
        any.
    transmission : ndarray (61,), optional
        Transmission of the lens, to a common factor; neutral if not given.
    active_area : (row, col, rows, cols), optional
        Where the lit pixels lie in the raw, with the filter pattern's phase at the first of them.
        By default the whole raw is lit.
    masked_areas : iterable of (row, col, rows, cols)
        Where pixels that are shielded from light do: LibRaw and dcraw take the black level there.
    optics : Optics, optional
        The lens: its name and figures, and what readers need to undo its shading and distortion.
    place : (int, int)
        Row and column of the first lit pixel of the raw, counted from the sensor's own.
    temperature_c : float, optional
        Temperature of the sensor.
    ev : float
        By how many stops readers are to show the picture brighter.
    taken : datetime, optional
        With its time zone; by default now.

    Raises
    ------
    UserError
        If the file cannot be written.
    """
    path, kind = Path(path), photometric(sensor)
    area = active_area or (0, 0, *raw.shape)
    entries = _camera(sensor) | _levels(sensor, temperature_c)
    entries |= _areas(area, masked_areas) | {
        "NewSubfileType": (LONG, (0,)),
        "PhotometricInterpretation": (SHORT, (kind,)),
        "ImageDescription": (ASCII, f"{sensor.name}, raw"),
        "Orientation": (SHORT, (1,)),
        "XResolution": (RATIONAL, (72, 1)),
        "YResolution": (RATIONAL, (72, 1)),
        "ResolutionUnit": (SHORT, (2,)),
        "Software": (ASCII, f"gpusim {gpusim.__version__}"),
        "BaselineExposure": (SRATIONAL, tiff.rational(ev, SRATIONAL)),
    }
    if kind != LINEAR_RAW:
        entries |= _colours(sensor, white_e, transmission)
    if kind == BLACK_IS_ZERO:
        entries = {name: entry for name, entry in entries.items() if "DNG" not in name}
    exif = _exif(sensor, exposure_s)
    if optics is not None:
        exif |= _lens(optics)
        entries["LensInfo"] = exif["LensInfo"]
        corrections = opcodes(optics, sensor, (*place, *area[2:]))
        if corrections:
            entries["OpcodeList3"] = (UNDEFINED, corrections)
    for name, entry in _dates(taken or datetime.now(UTC)).items():
        (entries if name == "DateTime" else exif)[name] = entry
    tiff.write_tiff(
        path,
        np.asarray(raw, np.uint16),
        {TAGS[name]: entry for name, entry in entries.items()},
        {EXIF[name]: entry for name, entry in exif.items()},
    )


def _camera(sensor: Sensor) -> dict[str, tuple[int, object]]:
    return {
        "DNGVersion": (BYTE, (1, 4, 0, 0)),
        "DNGBackwardVersion": (BYTE, (1, 1, 0, 0)),
        "Make": (ASCII, MAKE),
        "Model": (ASCII, sensor.name),
        "UniqueCameraModel": (ASCII, f"{MAKE} {sensor.name}"),
        "CameraSerialNumber": (ASCII, str(sensor.serial_number)),
    }


def _levels(sensor: Sensor, temperature_c: float | None) -> dict[str, tuple[int, object]]:
    """Return black and white level, what lies between them, and the noise."""
    black_dn, white_dn, period = (sensor.black_level_dn,), saturation_dn(sensor), (1, 1)
    if sensor.channel_black_level_dn:
        black_dn, period = sensor.site_black_dn, sensor.period
    entries = {}
    if sensor.linearity is not None:
        table, scale = linearization_table(sensor)
        black_dn, white_dn = scale * linear_dn(sensor, np.array(black_dn)), int(table[white_dn])
        entries["LinearizationTable"] = (SHORT, table.tolist())
    return entries | {
        "BlackLevelRepeatDim": (SHORT, period),
        "BlackLevel": (RATIONAL, tiff.rationals(black_dn)),
        "WhiteLevel": (LONG, (white_dn,)),
        "NoiseProfile": (DOUBLE, noise_profile(sensor, temperature_c)),
    }


def _areas(area: Rect, masked_areas: Iterable[Rect]) -> dict[str, tuple[int, object]]:
    entries = {
        "DefaultCropOrigin": (LONG, (0, 0)),
        "DefaultCropSize": (LONG, (area[3], area[2])),
        "ActiveArea": (LONG, _corners(area)),
    }
    if masked := [_corners(masked) for masked in masked_areas]:
        entries["MaskedAreas"] = (LONG, list(chain.from_iterable(masked)))
    return entries


def _corners(area: Rect) -> tuple[int, int, int, int]:
    """Return the first row and column of an area, and those behind its last ones."""
    row, col, rows, cols = area
    return row, col, row + rows, col + cols


def _colours(
    sensor: Sensor, white_e: dict[str, float], transmission: np.ndarray | None
) -> dict[str, tuple[int, object]]:
    """Return the filter array, and what its colours are."""
    camera = response(sensor.colour_qe, transmission)
    white = sensor.by_colour(white_e)
    colours = sorted(white, key=CFA_LETTERS.index)
    neutral = np.array([white[colour] for colour in colours], np.float64)
    matrices = {"ColorMatrix": colour_matrix}
    if len(colours) >= 3:
        matrices["ForwardMatrix"] = forward_matrix
    return {
        "CFARepeatPatternDim": (SHORT, sensor.period),
        "CFAPattern": (
            BYTE,
            [CFA_LETTERS.index(site) for row in sensor.cfa.letters for site in row],
        ),
        "CFAPlaneColor": (BYTE, [CFA_LETTERS.index(colour) for colour in colours]),
        "CFALayout": (SHORT, (1,)),  # rectangular
        "CalibrationIlluminant1": (SHORT, (LIGHT_SOURCE["A"],)),
        "CalibrationIlluminant2": (SHORT, (LIGHT_SOURCE["D65"],)),
        **{
            f"{name}{number}": (SRATIONAL, tiff.rationals(fit(camera, light).flat, SRATIONAL))
            for name, fit in matrices.items()
            for number, light in enumerate(("A", "D65"), start=1)
        },
        "AsShotNeutral": (RATIONAL, tiff.rationals(neutral / neutral.max())),
    }


def _exif(sensor: Sensor, exposure_s: float) -> dict[str, tuple[int, object]]:
    per_cm = 1e4 / sensor.pixel_pitch_um
    named = sensor.iso is not None
    return {
        "ExposureTime": (RATIONAL, tiff.rational(exposure_s)),
        "ShutterSpeedValue": (SRATIONAL, tiff.rational(-math.log2(exposure_s), SRATIONAL)),
        "ISO": (SHORT, (iso_speed(sensor),)),
        "SensitivityType": (SHORT, (SENSITIVITY_UNKNOWN if named else SENSITIVITY_ISO,)),
        "ExifVersion": (UNDEFINED, b"0231"),
        "FlashpixVersion": (UNDEFINED, b"0100"),
        "ColorSpace": (SHORT, (65535,)),  # uncalibrated
        "FocalPlaneXResolution": (RATIONAL, tiff.rational(per_cm)),
        "FocalPlaneYResolution": (RATIONAL, tiff.rational(per_cm)),
        "FocalPlaneResolutionUnit": (SHORT, (CENTIMETRE,)),
        "BodySerialNumber": (ASCII, str(sensor.serial_number)),
    }


def _lens(optics: Optics) -> dict[str, tuple[int, object]]:
    focal, stop = tiff.rational(optics.focal_length_mm), tiff.rational(optics.f_number)
    return {
        "FNumber": (RATIONAL, stop),
        "FocalLength": (RATIONAL, focal),
        "LensInfo": (RATIONAL, (*focal, *focal, *stop, *stop)),  # ends of a zoom, and their stops
        "LensModel": (ASCII, optics.name),
    }


def _dates(taken: datetime) -> dict[str, tuple[int, object]]:
    zone = taken.strftime("%z") or "+0000"
    entries = {name: (ASCII, f"{taken:%Y:%m:%d %H:%M:%S}") for name in _DATES}
    return entries | {name: (ASCII, f"{zone[:3]}:{zone[3:5]}") for name in _OFFSETS}


_DATES = ("DateTime", "DateTimeOriginal", "DateTimeDigitized")
_OFFSETS = ("OffsetTime", "OffsetTimeOriginal", "OffsetTimeDigitized")
