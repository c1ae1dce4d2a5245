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

Parameters are known by the names of the struct (``pixel.conversionGain``) and by those of sensorSet
(``pixel conversion gain``), without regard to capitals, spaces and dots. Those of :data:`UNUSED`
have no counterpart in a sensor; any other is refused.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gpusim.config.matlab import read_matlab
from gpusim.config.text import read_bytes, read_json
from gpusim.errors import UserError
from gpusim.sensor.conversion import Conversion

# What is read, with the names that it has.
NAMES = {
    "name": ("name",),
    "rows": ("rows",),
    "cols": ("cols",),
    "width": ("pixelwidth", "width"),
    "height": ("pixelheight", "height"),
    "detector_width": ("pixelpdwidth", "pdwidth"),
    "detector_height": ("pixelpdheight", "pdheight"),
    "fill_factor": ("pixelfillfactor", "fillfactor"),
    "conversion_gain": ("pixelconversiongain", "conversiongain"),
    "voltage_swing": ("pixelvoltageswing", "voltageswing"),
    "well_capacity": ("pixelwellcapacity", "wellcapacity"),
    "read_noise_v": ("pixelreadnoise", "pixelreadnoisevolts", "readnoise", "readnoisevolts"),
    "read_noise_e": ("pixelreadnoiseelectrons", "readnoiseelectrons"),
    "dark_voltage": ("pixeldarkvoltage", "darkvoltage"),
    "dsnu_v": ("sigmaoffsetfpn", "dsnulevel", "dsnusigma", "dsnu"),
    "prnu_percent": ("sigmagainfpn", "prnulevel", "prnusigma", "prnu"),
    "analog_gain": ("analoggain",),
    "analog_offset": ("analogoffset",),
    "bits": ("quantizationbits", "nbits", "bits"),
    "method": ("quantizationmethod", "quantization"),
    "pattern": ("cfapattern", "pattern"),
    "wave": ("spectrumwave", "wave", "pixelspectrumwave", "pixelwave"),
    "filters": ("colorfilterspectra", "filterspectra"),
    "filter_names": ("colorfilternames", "filternames"),
    "infrared": ("colorirfilter", "irfilter", "infraredfilter"),
    "detector_qe": ("pixelspectralqe", "pixelpdspectralqe", "pdspectralqe"),
}
# What says nothing of the sensor itself, by the beginning of its name, with the reason.
UNUSED = {
    "type": "a mark of the struct",
    "pixeltype": "a mark of the struct",
    "pixelname": "a mark of the struct",
    "data": "a capture, no property of the sensor",
    "integrationtime": "the exposure time is the capture's",
    "exptime": "the exposure time is the capture's",
    "exposuretime": "the exposure time is the capture's",
    "ae": "the exposure time is the capture's",
    "autoexposure": "the exposure time is the capture's",
    "noiseflag": "which noise is drawn is the capture's choice",
    "noiseseed": "the seed is the capture's",
    "reusenoise": "the seed is the capture's",
    "cds": "correlated double sampling of whole frames is not modelled",
    "responsetype": "only the linear response is modelled",
    "gainfpnimage": "one piece's own pattern; ours comes from the serial number",
    "offsetfpnimage": "one piece's own pattern; ours comes from the serial number",
    "pixelpdxpos": "the photodetector is taken to lie in the pixel's middle",
    "pixelpdypos": "the photodetector is taken to lie in the pixel's middle",
    "pixelwidthgap": "the aperture comes from the photodetector's own size",
    "pixelheightgap": "the aperture comes from the photodetector's own size",
    "pixellayerthickness": "the pixel's stack is not modelled",
    "pixelrefractiveindices": "the pixel's stack is not modelled",
    "pixelspectrumcomment": "a note",
    "etendue": "shading by micro-lenses is not modelled",
    "ml": "shading by micro-lenses is not modelled",
    "chartp": "of a measurement",
    "consistency": "of ISETCam's windows",
    "metadata": "a note",
    "human": "a model of the retina",
    "spectrumcomment": "a note",
}
SAME = 1e-2  # between two statements of one figure


def read_isetcam(file: Path) -> Conversion:
    """Read a sensor of ISETCam.

    Raises
    ------
    UserError
        The file cannot be read; a parameter is unknown, missing, wrong or contradicts another.
    """
    made = Conversion(file)
    found = _sorted(made, _flat(_struct(file)))
    read = _Reader(file, found)
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
            file=file,
            field="well capacity",
            value=f"{well_e:g} e-",
            allowed=f"voltage swing / conversion gain = {swing_v / gain_v:g} e-",
        )
    bits = _bits(read)
    divisor = read.number("analog_gain", default=1.0, above=0)
    offset_v = read.number("analog_offset", default=0.0)
    made.put("name", str(found.get("name", file.stem)), "name")
    for field in ("rows", "cols"):
        made.put(field, int(read.number(field, above=0)), field)
    made.put("pixel_pitch_um", _pitch_um(read), "pixel width and height")
    made.put("fill_factor", _fill_factor(read), "photodetector's area over the pixel's")
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
    made.put("full_well_e", swing_v / gain_v, "voltage swing / conversion gain")
    if "read_noise_e" in found:
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
    _read_colours(made, read)
    made.assume("reference_temperature_c", 25.0, "ISETCam has no temperature")
    made.assume("doubling_temperature_c", 6.0, "ISETCam has no temperature")
    made.assume("veiling_glare", 0.0, "of the optics in ISETCam")
    return made


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


# The file

MOST_BYTES = 64 << 20  # a struct has 10 kB, or some MB with an image
MOST_BITS = 64


def _struct(file: Path) -> dict:
    """Return the sensor's struct of either kind of file."""
    try:
        if file.suffix.lower() == ".mat":
            content = read_bytes(file, "the sensor file", MOST_BYTES)
            top = read_matlab(content)
        else:
            top = read_json(file, "the sensor file")
    except NotImplementedError as error:
        raise UserError(
            "the .mat file is of version 7.3",
            file=file,
            allowed="save(file, 'sensor', '-v7') of MATLAB, or JSON",
        ) from error
    except UserError:
        raise
    except Exception as error:  # readers raise whatever a damaged file leads them to
        reason = str(error) or type(error).__name__
        raise UserError(f"the sensor file cannot be read: {reason}", file=file) from error
    for name in ("sensor", "isa"):
        if isinstance(top, dict) and isinstance(top.get(name), dict):
            return top[name]
    if not isinstance(top, dict):
        raise UserError(
            "no struct of a sensor", file=file, value=type(top).__name__, allowed="sensor {...}"
        )
    return top


def _flat(struct: dict, path: str = "") -> dict[str, object]:
    """Return the values of a nested struct by their dotted names."""
    values: dict[str, object] = {}
    for key, value in struct.items():
        name = f"{path}.{key}".removeprefix(".")
        if isinstance(value, dict):
            values.update(_flat(value, name))
        else:
            values[name] = value
    return values


def _sorted(made: Conversion, values: dict[str, object]) -> dict[str, object]:
    """Return the values that are read by what they are; note those without a counterpart."""
    place = {name: meaning for meaning, names in NAMES.items() for name in names}
    found: dict[str, object] = {}
    for dotted, value in values.items():
        plain = "".join(character for character in dotted.lower() if character.isalnum())
        meaning = place.get(plain)
        try:
            np.shape(value)
        except ValueError as error:
            raise UserError(
                "a parameter is no array: its rows differ in length", file=made.file, field=dotted
            ) from error
        if meaning is not None:
            if np.size(value) == 0:
                continue  # MATLAB's [], not set
            if meaning in found and not _equal(found[meaning], value):
                raise UserError(
                    "two statements of one figure contradict each other",
                    file=made.file,
                    field=dotted,
                    value=value,
                    allowed=f"{found[meaning]}",
                )
            found[meaning] = value
            continue
        reasons = [why for start, why in UNUSED.items() if plain.startswith(start)]
        if not reasons:
            raise UserError(
                "unknown parameter",
                file=made.file,
                field=dotted,
                value=str(value)[:60],
                allowed=", ".join(names[0] for names in NAMES.values()),
            )
        if np.size(value):
            made.unused.append(f"{dotted}: {reasons[0]}")
    return found


def _equal(one: object, other: object) -> bool:
    return np.shape(one) == np.shape(other) and bool(np.all(np.asarray(one) == np.asarray(other)))


class _Reader:
    """Numbers of a struct by what they are."""

    def __init__(self, file: Path, found: dict[str, object]) -> None:
        self.file, self.found = file, found

    def missing(self, meaning: str) -> UserError:
        return UserError(
            "a parameter is missing",
            file=self.file,
            field=meaning.replace("_", " "),
            allowed=" or ".join(NAMES[meaning]),
        )

    def number(
        self, meaning: str, default: float | None = math.nan, above: float | None = None
    ) -> float:
        """Return a number, 0 or more, or `above`; the default where it is not there."""
        if meaning not in self.found:
            if default is not None and math.isnan(default):
                raise self.missing(meaning)
            return default
        value = self.found[meaning]
        good = (
            not isinstance(value, bool | str)
            and np.size(value) == 1
            and np.isreal(value)
            and math.isfinite(np.asarray(value, np.float64).item())
        )
        number = np.asarray(value, np.float64).item() if good else math.nan
        if not (number > above if above is not None else number >= 0):
            raise UserError(
                "a parameter is wrong",
                file=self.file,
                field=meaning.replace("_", " "),
                value=value,
                allowed="a number of 0 or more" if above is None else f"a number above {above:g}",
            )
        return number


def _bits(read: _Reader) -> int:
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


def _pitch_um(read: _Reader) -> float:
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


def _fill_factor(read: _Reader) -> float:
    if "fill_factor" in read.found:
        return read.number("fill_factor", above=0)
    area = read.number("detector_width", above=0) * read.number("detector_height", above=0)
    return area / (read.number("width") * read.number("height"))


def _read_colours(made: Conversion, read: _Reader) -> None:
    """Read the filter pattern and the quantum efficiency of each channel."""
    wave = _array(read, "wave", 1)
    filters = _array(read, "filters", 2, (wave.size, None))
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
            shared = shared * _array(read, meaning, 1, (wave.size,))
            what += f" x {label}"
    channels = _channel_names([str(name) for name in names])
    pattern = _array(read, "pattern", 2) if "pattern" in read.found else np.ones((1, 1))
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


def _array(
    read: _Reader, meaning: str, axes: int, shape: tuple[int | None, ...] | None = None
) -> np.ndarray:
    """Return an array of finite numbers with so many axes."""
    if meaning not in read.found:
        raise read.missing(meaning)
    try:
        values = np.asarray(read.found[meaning], np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    values = np.atleast_1d(values.squeeze()) if axes == 1 else np.atleast_2d(values)
    if axes == 2 and shape is not None and values.shape[0] != shape[0]:
        values = values.T  # one filter alone comes as a row
    fits = shape is None or (
        values.ndim == axes
        and all(size in (None, n) for size, n in zip(shape, values.shape, strict=True))
    )
    if values.ndim != axes or not fits or not np.isfinite(values).all():
        raise UserError(
            "a parameter is wrong",
            file=read.file,
            field=meaning.replace("_", " "),
            value=f"{' x '.join(map(str, values.shape))} numbers",
            allowed="finite numbers"
            + ("" if shape is None else f", {shape[0]} wavelengths in each curve"),
        )
    return values
