"""Reader of the sensor files of Ansys' Speos Sensor System exporter (YAML).

Keys, as the exporter's documentation lists them (Ansys Speos 2024 R2, "Properties" and "EMVA
Data"); names are told apart without regard to capitals:

======================== ===========================================================================
Properties:
Resolution: H, V         ``cols``, ``rows``; ``Auto``, the size of the exposure map, is for --set
Pixel Size: H, V         ``pixel_pitch_um``, um; square
Bits depth               ``bit_depth``: 8, 10, 12, 14 or 16
EMVA Data:
IR & UV Filter           transmission tau(lambda): a .spectrum file, or None
Quantum Efficiency       eta(lambda): a .spectrum file
Bayer Matrix             Type: None, or four letters with ``00 spectrum`` to ``11 spectrum``, b_c
System Gain              ``system_gain_dn_per_e``: K, DN/e- (unit e-/DN: 1/K)
Temporal Dark Noise      ``temporal_dark_noise_e``: sigma_d, e- (unit DN: over K)
Dark Current             ``dark_current_e_per_s``: mu_I, e-/s (unit DN/s: over K)
Spatial Non Uniformity   DSNU: ``dsnu_e``, e- (unit DN: over K); PRNU: ``prnu_percent``, %
AST, DR                  ``full_well_e`` = eta AST DR: AST is mu_p.min in photons, DR the ratio
                         mu_p.sat / mu_p.min in dB (EMVA 1288 release 3.1, section 2.5), eta the
                         highest quantum efficiency of all, for the file does not say at which
                         wavelength they were measured; with AST in e-, AST DR. Without them, what
                         fills the converter: (2^bits - 1) / K
======================== ===========================================================================

A number may stand alone or as ``Value`` with its ``Unit``. The quantum efficiency of channel c is
eta tau b_c. The trap in it: data sheets give b_c with the silicon's eta in it, and then eta must be
a constant 100 %; where it is not, a warning says so.

``.spectrum`` files hold a header, the number of samples, and a line ``wavelength value`` for each,
nm and per cent, or 0 to 1 where the key's ``Unit`` says so. A file whose values contradict its unit
is refused: one of them is off by a factor of 100.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path, PureWindowsPath

import numpy as np

from gpusim.config.text import read_bytes, read_yaml
from gpusim.errors import UserError
from gpusim.sensor.conversion import Conversion

PERCENT, UNITY = ("percentage",), ("0 to 1", "o to 1", "[0;1]")
BIT_DEPTHS = (8, 10, 12, 14, 16)
SITES = ("00 spectrum", "01 spectrum", "10 spectrum", "11 spectrum")
NEEDED = ("quantum efficiency", "system gain", "temporal dark noise")
KEYS = {
    "properties": ("resolution", "pixel size", "bits depth"),
    "emva data": (
        *("ir & uv filter", "quantum efficiency", "bayer matrix", "system gain"),
        *("temporal dark noise", "ast", "dr", "dark current", "spatial non uniformity"),
    ),
}

Curve = tuple[np.ndarray, np.ndarray]  # wavelengths in nm, rising; values


def is_speos(data: object) -> bool:
    """Return whether a YAML file's content is a sensor of the exporter."""
    return isinstance(data, dict) and any(str(key).lower() in KEYS for key in data)


def read_speos(file: Path) -> Conversion:
    """Read a sensor file of the exporter.

    Raises
    ------
    UserError
        The file or one of its spectra cannot be read; a key is unknown, missing or wrong.
    """
    top = _mapping(file, read_yaml(file, "the sensor file"), "(top level)")
    _only(file, "", top, tuple(KEYS))
    parts = {}
    for part, known in KEYS.items():
        if part not in top:
            raise UserError("a key is missing", file=file, field=part, allowed=", ".join(KEYS))
        parts[part] = _mapping(file, top[part], part)
        _only(file, part, parts[part], known)
    properties, emva = parts["properties"], parts["emva data"]
    for key in NEEDED:
        if key not in emva:
            raise UserError(
                "a key is missing", file=file, field=f"EMVA Data.{key}", allowed=", ".join(NEEDED)
            )
    made = Conversion(file)
    made.put("name", file.stem, "the file's name")
    _read_properties(made, properties)
    peak = _read_spectra(made, emva)
    _read_numbers(made, emva, peak)
    made.assume("fill_factor", 1.0, "the file has no aperture")
    made.assume("black_level_dn", 0.0, "none; the file has no offset")
    made.assume("reference_temperature_c", 25.0, "the file has no temperature")
    made.assume("doubling_temperature_c", 6.0, "the file has no temperature")
    made.assume("veiling_glare", 0.0, "the file has no glare")
    return made


# Keys


def _read_properties(made: Conversion, properties: dict) -> None:
    """Read resolution, pixel size and bit depth; ``Auto`` leaves a field open."""
    sides = {}
    for key in ("resolution", "pixel size"):
        found = _mapping(made.file, properties.get(key, {}), key)
        _only(made.file, f"Properties.{key}", found, ("h", "v"))
        for side in "hv":
            value = found.get(side, "Auto")
            if str(value).lower() != "auto":
                sides[key, side] = _number(made.file, f"Properties.{key}.{side}", value)
    for side, field in (("h", "cols"), ("v", "rows")):
        if ("resolution", side) in sides:
            made.put(field, sides["resolution", side], f"Resolution {side.upper()}")
    pitches = {sides["pixel size", side] for side in "hv" if ("pixel size", side) in sides}
    if len(pitches) > 1:
        raise UserError(
            "the pixels are not square",
            file=made.file,
            field="Properties.Pixel Size",
            value=" x ".join(f"{one:g} um" for one in sorted(pitches)),
            allowed="the same for H and V",
        )
    if pitches:
        made.put("pixel_pitch_um", pitches.pop(), "Pixel Size")
    if "bits depth" in properties:
        bits = properties["bits depth"]
        if bits not in BIT_DEPTHS:
            raise UserError(
                "the converter has no such depth",
                file=made.file,
                field="Properties.Bits depth",
                value=bits,
                allowed=", ".join(map(str, BIT_DEPTHS)),
            )
        made.put("bit_depth", bits, "Bits depth")


def _read_spectra(made: Conversion, emva: dict) -> float:
    """Read filter pattern and quantum efficiency; return the highest of all channels."""
    file = made.file
    qe = _spectrum_of(file, emva["quantum efficiency"], "EMVA Data.Quantum Efficiency")
    shared = [qe]
    what = "Quantum Efficiency"
    cut = emva.get("ir & uv filter")
    if isinstance(cut, dict):
        named = {str(key).lower(): value for key, value in cut.items()}
        cut = None if _is_none(named.get("filename")) else cut
    if not _is_none(cut):
        shared.append(_spectrum_of(file, cut, "EMVA Data.IR & UV Filter"))
        what += " x IR & UV Filter"
    bayer = _mapping(file, emva.get("bayer matrix", {"Type": None}), "EMVA Data.Bayer Matrix")
    _only(file, "EMVA Data.Bayer Matrix", bayer, ("type", "unit", *SITES))
    kind = bayer.get("type")
    if _is_none(kind):
        channels = {"W": shared}
        pattern = [["W"]]
        made.put("cfa", {"pattern": pattern}, "Bayer Matrix: Type None, monochrome")
    else:
        letters = str(kind).upper()
        if len(letters) != 4 or set(letters) - set("RGB"):
            raise UserError(
                "the Bayer matrix is none",
                file=file,
                field="EMVA Data.Bayer Matrix.Type",
                value=kind,
                allowed="None, or four letters of R, G and B: RGGB",
            )
        curves = []
        for site in SITES:
            if site not in bayer:
                raise UserError(
                    "a key is missing",
                    file=file,
                    field=f"EMVA Data.Bayer Matrix.{site}",
                    allowed=", ".join(SITES),
                )
            filtered = {"filename": bayer[site], "unit": bayer.get("unit", PERCENT[0])}
            curves.append(_spectrum_of(file, filtered, f"EMVA Data.Bayer Matrix.{site}"))
        names = _site_names(letters, curves)
        pattern = [names[:2], names[2:]]
        channels = {name: [*shared, curve] for name, curve in zip(names, curves, strict=True)}
        made.put("cfa", {"pattern": pattern}, f"Bayer Matrix: {letters}")
        what += " x Bayer Matrix"
        if np.ptp(qe[1]) > 0:
            what += "; right only where the latter is the filters alone"
            warnings.warn(
                "Quantum Efficiency and Bayer Matrix are multiplied: data sheets usually give the "
                "channels with the silicon in them, and then Quantum Efficiency must be a constant "
                "100 %",
                stacklevel=2,
            )
    grid = _common_grid([curve for parts in channels.values() for curve in parts])
    products = {
        name: np.prod([np.interp(grid, *curve) for curve in parts], axis=0)
        for name, parts in channels.items()
    }
    made.put(
        "quantum_efficiency",
        {
            "wavelengths_nm": grid.tolist(),
            "channels": {name: [float(f"{v:.6g}") for v in c] for name, c in products.items()},
        },
        what,
    )
    return max(float(values.max()) for values in products.values())


def _read_numbers(made: Conversion, emva: dict, peak: float) -> None:
    """Read gain, noise, dark current, non-uniformity and saturation."""
    file = made.file

    def read(key: str, units: dict[str, float], within: dict = emva, path: str = "") -> float:
        return _with_unit(file, f"EMVA Data.{path}{key}", within[key], units)

    found, unit = _split(file, "EMVA Data.System Gain", emva["system gain"])
    if unit not in (None, "dn/e-", "e-/dn"):
        raise _unit_error(file, "EMVA Data.System Gain", unit, ("DN/e-", "e-/DN"))
    if found <= 0:
        raise UserError(
            "not a gain", file=file, field="EMVA Data.System Gain", value=found, allowed="above 0"
        )
    gain = 1 / found if unit == "e-/dn" else found
    made.put(
        "system_gain_dn_per_e", gain, "System Gain" + (", e-/DN: 1/K" if unit == "e-/dn" else "")
    )
    made.put(
        "temporal_dark_noise_e",
        read("temporal dark noise", {"e-": 1.0, "dn": 1 / gain}),
        "Temporal Dark Noise",
    )
    if "dark current" in emva:
        per_s = read("dark current", {"e-/s": 1.0, "dn/s": 1 / gain})
        made.put("dark_current_e_per_s", per_s, "Dark Current")
    made.assume("dark_current_e_per_s", 0.0, "none; the file has no Dark Current")
    spatial = _mapping(file, emva.get("spatial non uniformity", {}), "Spatial Non Uniformity")
    _only(file, "EMVA Data.Spatial Non Uniformity", spatial, ("dsnu", "prnu"))
    for key, field, units in (
        ("dsnu", "dsnu_e", {"e-": 1.0, "dn": 1 / gain}),
        ("prnu", "prnu_percent", {"%": 1.0}),
    ):
        if key in spatial:
            value = read(key, units, spatial, "Spatial Non Uniformity.")
            made.put(field, value, f"Spatial Non Uniformity: {key.upper()}")
        made.assume(field, 0.0, f"none; the file has no {key.upper()}")
    if "ast" in emva and "dr" in emva:
        # dB of a ratio of amplitudes (EMVA 1288 release 3.1, section 2.5); bit: powers of two
        value, unit = _split(file, "EMVA Data.DR", emva["dr"])
        if unit != "1" and value > MOST_DR:
            raise UserError(
                "the dynamic range is none",
                file=file,
                field="EMVA Data.DR",
                value=value,
                allowed=f"up to {MOST_DR:g}",
            )
        ratios = {None: 10 ** (value / 20), "db": 10 ** (value / 20), "bit": 2**value, "1": value}
        if unit not in ratios:
            raise _unit_error(file, "EMVA Data.DR", unit, ("dB", "bit", "1"))
        threshold = read("ast", {"p": peak, "e-": 1.0})
        made.put("full_well_e", threshold * ratios[unit], "eta AST DR, eta the highest of all")
    elif "bit_depth" in made.fields:
        full = (2 ** int(made.fields["bit_depth"]) - 1) / gain
        made.assume("full_well_e", full, "what fills the converter: the file has not AST and DR")
        made.unused.extend(
            f"EMVA Data.{key.upper()}: AST and DR say the saturation together"
            for key in ("ast", "dr")
            if key in emva
        )


# Values

MOST_DR = 400.0  # dB or bit: 1e20, beyond any pixel


def _is_none(value: object) -> bool:
    return value is None or str(value).lower() == "none"


def _mapping(file: Path, value: object, field: str) -> dict:
    """Return a mapping with its keys in small letters."""
    if not isinstance(value, dict):
        raise UserError(
            "no keys with values where these should be", file=file, field=field, value=value
        )
    return {str(key).strip().lower(): inner for key, inner in value.items()}


def _only(file: Path, path: str, found: dict, known: tuple[str, ...]) -> None:
    """Refuse keys that the exporter's documentation does not list."""
    for key in found:
        if key not in known:
            raise UserError(
                "unknown key",
                file=file,
                field=f"{path}.{key}".removeprefix("."),
                value=found[key],
                allowed=", ".join(known),
            )


def _number(file: Path, field: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise UserError("not a number", file=file, field=field, value=value, allowed="a number")
    return value


def _split(file: Path, field: str, value: object) -> tuple[float, str | None]:
    """Return a number and its unit in small letters, which need not be there."""
    unit = None
    if isinstance(value, dict):
        inner = _mapping(file, value, field)
        _only(file, field, inner, ("value", "unit"))
        value, unit = inner.get("value"), inner.get("unit")
    return _number(file, field, value), None if unit is None else str(unit).strip().lower()


def _with_unit(file: Path, field: str, value: object, units: dict[str, float]) -> float:
    """Return a number in the first of some units, from any of them."""
    number, unit = _split(file, field, value)
    if unit is not None and unit not in units:
        raise _unit_error(file, field, unit, tuple(units))
    return number * (next(iter(units.values())) if unit is None else units[unit])


def _unit_error(file: Path, field: str, unit: str, known: tuple[str, ...]) -> UserError:
    return UserError(
        "unknown unit", file=file, field=f"{field}.Unit", value=unit, allowed=", ".join(known)
    )


# Spectra


def _spectrum_of(file: Path, value: object, field: str) -> Curve:
    """Return the curve that a key names, as fractions of 1."""
    named = _mapping(file, value if isinstance(value, dict) else {"filename": value}, field)
    _only(file, field, named, ("filename", "unit"))
    unit = str(named.get("unit", PERCENT[0])).strip().lower()
    if unit not in PERCENT + UNITY:
        raise _unit_error(file, field, unit, ("Percentage", "0 to 1"))
    name = str(named.get("filename"))
    windows = PureWindowsPath(name)
    places = (file.parent / windows.as_posix(), file.parent / windows.name)
    spectrum = next((place for place in places if place.is_file()), None)
    if spectrum is None:
        raise UserError(
            "the spectrum is not there",
            file=file,
            field=field,
            value=name,
            allowed=f"a .spectrum file, as named or beside {file.name}",
        )
    wavelengths, values = read_spectrum(spectrum)
    most = float(values.max())
    if unit in UNITY:
        if most > 1.5:
            raise UserError(
                "the spectrum is not in 0 to 1: perhaps per cent is meant",
                file=spectrum,
                field=f"{field}.Unit",
                value=f"values up to {most:g}",
                allowed="values of 0 to 1, or Unit: Percentage",
            )
        return wavelengths, values
    if 0 < most <= 1:
        raise UserError(
            "the spectrum is hardly in per cent: perhaps 0 to 1 is meant",
            file=spectrum,
            field=f"{field}.Unit",
            value=f"values up to {most:g}",
            allowed="values of 0 to 100, or Unit: 0 to 1",
        )
    return wavelengths, values / 100


def read_spectrum(file: Path) -> Curve:
    """Read a ``.spectrum`` file: wavelengths in nm, rising, and its values as they stand.

    Raises
    ------
    UserError
        The file holds no samples, not as many as it says, none or negative numbers, or wavelengths
        that do not rise.
    """
    samples: list[tuple[float, float]] = []
    count = None
    lines = read_bytes(file, "the spectrum").decode("utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        words = line.split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) == 2:
            samples.append((values[0], values[1]))
        elif len(values) == 1 and not samples:
            count = values[0]
        elif samples and words:
            raise UserError(
                "a line is no sample",
                file=file,
                field=f"line {number}",
                value=line.strip(),
                allowed="a wavelength in nm and a value",
            )
    if not samples or (count is not None and count != len(samples)):
        raise UserError(
            "the spectrum is not complete",
            file=file,
            field="number of samples",
            value=len(samples),
            allowed="one or more" if count is None else f"{count:g}, as the file says",
        )
    wavelengths, found = np.array(samples).T
    good = np.isfinite(found) & (found >= 0)
    if not good.all():
        raise UserError(
            "the spectrum has a value that is none",
            file=file,
            field=f"at {wavelengths[np.argmin(good)]:g} nm",
            value=found[np.argmin(good)],
            allowed="0 or more",
        )
    if not np.all(np.diff(wavelengths) > 0):
        raise UserError(
            "the wavelengths do not rise", file=file, allowed="each more than the one before"
        )
    return wavelengths, found


def _common_grid(curves: list[Curve]) -> np.ndarray:
    """Return all wavelengths of some curves in the range that all of them have."""
    first = max(float(grid[0]) for grid, _ in curves)
    last = min(float(grid[-1]) for grid, _ in curves)
    every = np.unique(np.concatenate([grid for grid, _ in curves]))
    return every[(every >= first) & (every <= last)]


def _site_names(letters: str, curves: list[Curve]) -> list[str]:
    """Return each site's channel: two unlike greens are Gr and Gb, after the rest of their row."""
    names = list(letters)
    for letter in set(letters):
        sites = [site for site in range(4) if letters[site] == letter]
        same = all(
            np.array_equal(curves[sites[0]][part], curves[site][part])
            for site in sites
            for part in (0, 1)
        )
        if not same:
            for site in sites:
                neighbour = letters[site ^ 1].lower()
                names[site] = f"{letter}{neighbour if letter != letters[site ^ 1] else site}"
    return names
