"""ISETCam's struct of a sensor: its file, the names of its parameters, and their values.

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
MOST_BYTES = 64 << 20  # a struct has 10 kB, or some MB with an image


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


def parameters(made: Conversion) -> dict[str, object]:
    """Return the values that are read by what they are; note those without a counterpart.

    Raises
    ------
    UserError
        The file cannot be read; a parameter is unknown, or contradicts another.
    """
    values = _flat(_struct(made.file))
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


class Reader:
    """Numbers of a struct by what they are."""

    def __init__(self, file: Path, found: dict[str, object]) -> None:
        self.file, self.found = file, found

    def missing(self, meaning: str) -> UserError:
        """Return the mistake of a parameter that is not there."""
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


def array(
    read: Reader, meaning: str, axes: int, shape: tuple[int | None, ...] | None = None
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
