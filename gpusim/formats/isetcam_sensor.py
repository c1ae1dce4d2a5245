"""Reader of ISETCam's sensors: a struct saved from MATLAB (.mat, version 7) or the same as JSON.

ISETCam works in volts at the pixel; sensor files in electrons and DN. With the conversion gain g
(V/e-), the voltage swing S (V), n bits, the analogue gain a and offset o (V), a pixel that holds N
electrons gives (ISETCam, sensorCompute.m and analog2digital.m):

    volts = (g N + o) / a           the analogue gain is a divisor: 0.5 makes the signal larger
    DN = volts / (S / 2^n)

so that, by comparison with DN = K N + black level:

    system gain     K = 2^n g / (a S)            black level     2^n o / (a S)
    full well       S / g                        dark current    dark voltage (V/s) / g
    read noise      (V) / g                      DSNU            (V) / g
    PRNU            per cent as it is            fill factor     photodetector's area / pixel's

and the quantum efficiency of a channel is filter x infra-red filter x the pixel's own.

The parameters are those of `gpusim.formats.isetcam_struct`.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gpusim.errors import UserError
from gpusim.formats.isetcam_struct import Reader, array, parameters
from gpusim.sensor.conversion import Conversion

SAME = 1e-2  # between two statements of one figure


def read_isetcam(file: Path) -> Conversion:
    """Read a sensor of ISETCam.

    Raises
    ------
    UserError
        The file cannot be read; a parameter is unknown, missing, wrong or contradicts another.
    """
    made = Conversion(file)
    found = parameters(made)
    read = Reader(file, found)
    gain_v, swing_v = _charge(read)
    made.put("name", str(found.get("name", file.stem)), "name")
    for field in ("rows", "cols"):
        made.put(field, int(read.number(field, above=0)), field)
    made.put("pixel_pitch_um", _pitch_um(read), "pixel width and height")
    made.put("fill_factor", _fill_factor(read), "photodetector's area over the pixel's")
    _read_converter(made, read, gain_v, swing_v)
    made.put("full_well_e", swing_v / gain_v, "voltage swing / conversion gain")
    _read_noise(made, read, gain_v)
    _read_colours(made, read)
    made.assume("reference_temperature_c", 25.0, "ISETCam has no temperature")
    made.assume("doubling_temperature_c", 6.0, "ISETCam has no temperature")
    made.assume("veiling_glare", 0.0, "of the optics in ISETCam")
    return made


def _charge(read: Reader) -> tuple[float, float]:
    """Return conversion gain, V/e-, and voltage swing, V."""
    gain_v = read.number("conversion_gain", default=None, above=0)
    swing_v = read.number("voltage_swing", above=0)
    well_e = read.number("well_capacity", default=None, above=0)
    if gain_v is None:
        if well_e is None:
            raise read.missing("conversion_gain")
        gain_v = swing_v / well_e
    elif well_e is not None and abs(well_e * gain_v / swing_v - 1) > SAME:
        raise UserError(
            "well capacity and voltage swing contradict each other",
            file=read.file,
            field="well capacity",
            value=f"{well_e:g} e-",
            allowed=f"voltage swing / conversion gain = {swing_v / gain_v:g} e-",
        )
    return gain_v, swing_v


def _read_converter(made: Conversion, read: Reader, gain_v: float, swing_v: float) -> None:
    """Read system gain, black level and bit depth, of what `_charge` returns."""
    bits = _bits(read)
    divisor = read.number("analog_gain", default=1.0, above=0)
    offset_v = read.number("analog_offset", default=0.0)
    made.put(
        "system_gain_dn_per_e",
        system_gain_dn_per_e(gain_v, swing_v, bits, divisor),
        f"2^n g / (a S): conversion gain g {gain_v:g} V/e-, voltage swing S {swing_v:g} V, "
        f"analog gain a {divisor:g}, a divisor",
    )
    made.put(
        "black_level_dn",
        black_level_dn(offset_v, swing_v, bits, divisor),
        f"2^n o / (a S): analog offset o {offset_v:g} V",
    )
    made.put("bit_depth", bits, "quantization")


def _read_noise(made: Conversion, read: Reader, gain_v: float) -> None:
    """Read noise, dark current and non-uniformity, of a conversion gain in V/e-."""
    if "read_noise_e" in read.found:
        made.put("temporal_dark_noise_e", read.number("read_noise_e"), "read noise, electrons")
    else:
        made.put(
            "temporal_dark_noise_e",
            read.number("read_noise_v") / gain_v,
            "read noise (V) / conversion gain",
        )
    dark = read.number("dark_voltage", default=None)
    if dark is not None:
        made.put("dark_current_e_per_s", dark / gain_v, "dark voltage (V/s) / conversion gain")
    made.assume("dark_current_e_per_s", 0.0, "none; the file has no dark voltage")
    made.put("dsnu_e", read.number("dsnu_v", default=0.0) / gain_v, "DSNU (V) / conversion gain")
    made.put("prnu_percent", read.number("prnu_percent", default=0.0), "PRNU, per cent")


def system_gain_dn_per_e(
    conversion_gain_v_per_e: float, voltage_swing_v: float, bits: int, analog_gain: float
) -> float:
    """Return K: volts are divided by the analogue gain, and a DN is 2^-bits of the swing."""
    return conversion_gain_v_per_e / analog_gain * 2**bits / voltage_swing_v


def black_level_dn(
    analog_offset_v: float, voltage_swing_v: float, bits: int, analog_gain: float
) -> float:
    """Return the DN of no charge: the offset, divided by the analogue gain like the signal."""
    return analog_offset_v / analog_gain * 2**bits / voltage_swing_v


MOST_BITS = 64


def _bits(read: Reader) -> int:
    """Return the bits of the converter, from their number or a method such as ``10 bit``."""
    if "bits" in read.found:
        bits = read.number("bits", above=0)
        if bits > MOST_BITS:
            raise UserError(
                "the converter is none",
                file=read.file,
                field="bits",
                value=bits,
                allowed=f"1 to {MOST_BITS}",
            )
        return int(bits)
    method = str(read.found.get("method", "none")).strip().lower()
    number = method.removesuffix("bit").strip()
    if not number.isdecimal() or not 0 < int(number[:9]) <= MOST_BITS:
        raise UserError(
            "the sensor has no converter",
            file=read.file,
            field="quantization",
            value=method,
            allowed="'8 bit', '10 bit', '12 bit', or a linear method with its bits",
        )
    return int(number)


def _pitch_um(read: Reader) -> float:
    width, height = read.number("width", above=0), read.number("height", above=0)
    if not math.isclose(width, height, rel_tol=1e-9):
        raise UserError(
            "the pixels are not square",
            file=read.file,
            field="pixel width, height",
            value=f"{1e6 * width:g} x {1e6 * height:g} um",
            allowed="the same for both",
        )
    return float(f"{1e6 * width:.9g}")


def _fill_factor(read: Reader) -> float:
    if "fill_factor" in read.found:
        return read.number("fill_factor", above=0)
    area = read.number("detector_width", above=0) * read.number("detector_height", above=0)
    return area / (read.number("width") * read.number("height"))


def _read_colours(made: Conversion, read: Reader) -> None:
    """Read the filter pattern and the quantum efficiency of each channel."""
    wave = array(read, "wave", 1)
    filters = array(read, "filters", 2, (wave.size, None))
    names = read.found.get("filter_names")
    names = [] if names is None else [names] if isinstance(names, str) else list(np.ravel(names))
    if len(names) != filters.shape[1]:
        raise UserError(
            "each filter needs a name",
            file=read.file,
            field="filter names",
            value=", ".join(map(str, names)),
            allowed=f"{filters.shape[1]}, as there are filter spectra",
        )
    shared = np.ones(wave.size)
    what = "filter spectra"
    for meaning, label in (("infrared", "infra-red filter"), ("detector_qe", "pixel's own")):
        if meaning in read.found:
            shared = shared * array(read, meaning, 1, (wave.size,))
            what += f" x {label}"
    channels = _channel_names([str(name) for name in names])
    pattern = array(read, "pattern", 2) if "pattern" in read.found else np.ones((1, 1))
    if not np.isin(pattern, np.arange(1, len(channels) + 1)).all():
        raise UserError(
            "the pattern names a filter that is not there",
            file=read.file,
            field="cfa.pattern",
            value=pattern.tolist(),
            allowed=f"1 to {len(channels)}",
        )
    used = np.unique(pattern).astype(int) - 1
    made.unused.extend(
        f"filter {names[index]}: in no place of the pattern"
        for index in range(len(channels))
        if index not in used
    )
    made.put(
        "cfa", {"pattern": [[channels[int(i) - 1] for i in row] for row in pattern]}, "pattern"
    )
    made.put(
        "quantum_efficiency",
        {
            "wavelengths_nm": wave.tolist(),
            "channels": {
                channels[index]: [float(f"{v:.6g}") for v in filters[:, index] * shared]
                for index in used
            },
        },
        what,
    )


def _channel_names(names: list[str]) -> list[str]:
    """Return a channel for each filter: its colour, and more where two have one colour."""
    letters = [name[:1].upper() for name in names]
    return [
        letter if letters.count(letter) == 1 else f"{letter}{name[1:] or index + 1}"
        for index, (letter, name) in enumerate(zip(letters, names, strict=True))
    ]
