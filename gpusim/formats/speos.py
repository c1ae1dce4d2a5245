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

The spectra are those of `gpusim.formats.speos_spectra`.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.formats.speos_spectra import PERCENT, Curve, common_grid, spectrum_of
from gpusim.formats.speos_values import mapping, number, only, split, unit_error, with_unit
from gpusim.sensor.conversion import Conversion

BIT_DEPTHS = (8, 10, 12, 14, 16)
MOST_DR = 400.0  # dB or bit: 1e20, beyond any pixel
SITES = ("00 spectrum", "01 spectrum", "10 spectrum", "11 spectrum")
NEEDED = ("quantum efficiency", "system gain", "temporal dark noise")
KEYS = {
    "properties": ("resolution", "pixel size", "bits depth"),
    "emva data": (
        *("ir & uv filter", "quantum efficiency", "bayer matrix", "system gain"),
        *("temporal dark noise", "ast", "dr", "dark current", "spatial non uniformity"),
    ),
}


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
    top = mapping(file, read_yaml(file, "the sensor file"), "(top level)")
    only(file, "", top, tuple(KEYS))
    parts = {}
    for part, known in KEYS.items():
        if part not in top:
            raise UserError("a key is missing", file=file, field=part, allowed=", ".join(KEYS))
        parts[part] = mapping(file, top[part], part)
        only(file, part, parts[part], known)
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
    gain = _read_gain(made, emva)
    _read_noise(made, emva, gain)
    _read_full_well(made, emva, gain, peak)
    made.assume("fill_factor", 1.0, "the file has no aperture")
    made.assume("black_level_dn", 0.0, "none; the file has no offset")
    made.assume("reference_temperature_c", 25.0, "the file has no temperature")
    made.assume("doubling_temperature_c", 6.0, "the file has no temperature")
    made.assume("veiling_glare", 0.0, "the file has no glare")
    return made


def _read_properties(made: Conversion, properties: dict) -> None:
    """Read resolution, pixel size and bit depth; ``Auto`` leaves a field open."""
    sides = {}
    for key in ("resolution", "pixel size"):
        found = mapping(made.file, properties.get(key, {}), key)
        only(made.file, f"Properties.{key}", found, ("h", "v"))
        for side in "hv":
            value = found.get(side, "Auto")
            if str(value).lower() != "auto":
                sides[key, side] = number(made.file, f"Properties.{key}.{side}", value)
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
    qe = spectrum_of(file, emva["quantum efficiency"], "EMVA Data.Quantum Efficiency")
    shared, what = [qe], "Quantum Efficiency"
    cut = emva.get("ir & uv filter")
    if isinstance(cut, dict):
        named = {str(key).lower(): value for key, value in cut.items()}
        cut = None if _is_none(named.get("filename")) else cut
    if not _is_none(cut):
        shared.append(spectrum_of(file, cut, "EMVA Data.IR & UV Filter"))
        what += " x IR & UV Filter"
    bayer = mapping(file, emva.get("bayer matrix", {"Type": None}), "EMVA Data.Bayer Matrix")
    only(file, "EMVA Data.Bayer Matrix", bayer, ("type", "unit", *SITES))
    if _is_none(bayer.get("type")):
        channels = {"W": shared}
        made.put("cfa", {"pattern": [["W"]]}, "Bayer Matrix: Type None, monochrome")
    else:
        filters = _read_bayer(made, bayer)
        channels = {name: [*shared, curve] for name, curve in filters.items()}
        what += " x Bayer Matrix"
        if np.ptp(qe[1]) > 0:
            what += "; right only where the latter is the filters alone"
            warnings.warn(
                "Quantum Efficiency and Bayer Matrix are multiplied: data sheets usually give the "
                "channels with the silicon in them, and then Quantum Efficiency must be a constant "
                "100 %",
                stacklevel=2,
            )
    grid = common_grid([curve for parts in channels.values() for curve in parts])
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


def _read_bayer(made: Conversion, bayer: dict) -> dict[str, Curve]:
    """Read the filter pattern; return the curve of each channel's filters."""
    file, kind = made.file, bayer["type"]
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
        curves.append(spectrum_of(file, filtered, f"EMVA Data.Bayer Matrix.{site}"))
    names = _site_names(letters, curves)
    made.put("cfa", {"pattern": [names[:2], names[2:]]}, f"Bayer Matrix: {letters}")
    return dict(zip(names, curves, strict=True))


def _read_gain(made: Conversion, emva: dict) -> float:
    """Read the system gain, DN/e-."""
    field = "EMVA Data.System Gain"
    found, unit = split(made.file, field, emva["system gain"])
    if unit not in (None, "dn/e-", "e-/dn"):
        raise unit_error(made.file, field, unit, ("DN/e-", "e-/DN"))
    if found <= 0:
        raise UserError("not a gain", file=made.file, field=field, value=found, allowed="above 0")
    gain = 1 / found if unit == "e-/dn" else found
    what = "System Gain" + (", e-/DN: 1/K" if unit == "e-/dn" else "")
    made.put("system_gain_dn_per_e", gain, what)
    return gain


def _read_noise(made: Conversion, emva: dict, gain: float) -> None:
    """Read dark noise, dark current and non-uniformity, of a system gain in DN/e-."""
    file, path = made.file, "EMVA Data"
    units = {"e-": 1.0, "dn": 1 / gain}
    noise = with_unit(file, f"{path}.temporal dark noise", emva["temporal dark noise"], units)
    made.put("temporal_dark_noise_e", noise, "Temporal Dark Noise")
    if "dark current" in emva:
        per_s = {"e-/s": 1.0, "dn/s": 1 / gain}
        current = with_unit(file, f"{path}.dark current", emva["dark current"], per_s)
        made.put("dark_current_e_per_s", current, "Dark Current")
    made.assume("dark_current_e_per_s", 0.0, "none; the file has no Dark Current")
    spatial = mapping(file, emva.get("spatial non uniformity", {}), "Spatial Non Uniformity")
    path += ".Spatial Non Uniformity"
    only(file, path, spatial, ("dsnu", "prnu"))
    for key, field, known in (("dsnu", "dsnu_e", units), ("prnu", "prnu_percent", {"%": 1.0})):
        if key in spatial:
            value = with_unit(file, f"{path}.{key}", spatial[key], known)
            made.put(field, value, f"Spatial Non Uniformity: {key.upper()}")
        made.assume(field, 0.0, f"none; the file has no {key.upper()}")


def _read_full_well(made: Conversion, emva: dict, gain: float, peak: float) -> None:
    """Read the saturation, of a system gain in DN/e- and the highest quantum efficiency."""
    file = made.file
    if "ast" in emva and "dr" in emva:
        # dB of a ratio of amplitudes (EMVA 1288 release 3.1, section 2.5); bit: powers of two
        value, unit = split(file, "EMVA Data.DR", emva["dr"])
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
            raise unit_error(file, "EMVA Data.DR", unit, ("dB", "bit", "1"))
        threshold = with_unit(file, "EMVA Data.ast", emva["ast"], {"p": peak, "e-": 1.0})
        made.put("full_well_e", threshold * ratios[unit], "eta AST DR, eta the highest of all")
    elif "bit_depth" in made.fields:
        full = (2 ** int(made.fields["bit_depth"]) - 1) / gain
        made.assume("full_well_e", full, "what fills the converter: the file has not AST and DR")
        made.unused.extend(
            f"EMVA Data.{key.upper()}: AST and DR say the saturation together"
            for key in ("ast", "dr")
            if key in emva
        )


def _is_none(value: object) -> bool:
    return value is None or str(value).lower() == "none"


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
