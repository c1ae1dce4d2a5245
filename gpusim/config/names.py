"""Names that were mistyped, or that other programs and books use."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

# What others call a field of ours, spelled without capitals and signs.
SYNONYMS = {
    "adcbits": "bit_depth",
    "angle": "max_field_deg",
    "aperture": "f_number",
    "bayer": "cfa",
    "bayerpattern": "cfa",
    "bits": "bit_depth",
    "bitdepth": "bit_depth",
    "blackoffset": "black_level_dn",
    "cfapattern": "cfa",
    "conversiongain": "system_gain_dn_per_e",
    "darkcurrent": "dark_current_e_per_s",
    "darksignal": "dark_current_e_per_s",
    "defocusum": "focus_shift_um",
    "dsnu": "dsnu_e",
    "efl": "focal_length_mm",
    "eflmm": "focal_length_mm",
    "fieldofview": "max_field_deg",
    "fnum": "f_number",
    "fno": "f_number",
    "focallength": "focal_length_mm",
    "fov": "max_field_deg",
    "fovdeg": "max_field_deg",
    "fstop": "f_number",
    "gain": "system_gain_dn_per_e",
    "gaindnpere": "system_gain_dn_per_e",
    "height": "rows",
    "heightpx": "rows",
    "k": "system_gain_dn_per_e",
    "lensfile": "prescription",
    "offsetdn": "black_level_dn",
    "pedestaldn": "black_level_dn",
    "pitch": "pixel_pitch_um",
    "pixelpitch": "pixel_pitch_um",
    "pixelsize": "pixel_pitch_um",
    "pixelsizeum": "pixel_pitch_um",
    "prnu": "prnu_percent",
    "qe": "quantum_efficiency",
    "readnoise": "temporal_dark_noise_e",
    "readnoisee": "temporal_dark_noise_e",
    "saturationcapacitye": "full_well_e",
    "saturatione": "full_well_e",
    "temperature": "reference_temperature_c",
    "temperaturec": "reference_temperature_c",
    "wavelengths": "wavelengths_nm",
    "wellcapacity": "full_well_e",
    "wellcapacitye": "full_well_e",
    "width": "cols",
    "widthpx": "cols",
}


def nearest(name: object, names: Iterable[str]) -> str | None:
    """Return the one of some names that is likely meant, by its sense or by its spelling."""
    names = list(names)
    plain = "".join(sign for sign in str(name).lower() if sign.isalnum())
    meant = SYNONYMS.get(plain)
    if meant in names:
        return meant
    alike = {one.lower(): one for one in reversed(names)}
    found = get_close_matches(str(name)[:100].lower(), alike, n=1)
    return alike[found[0]] if found else None


def perhaps(name: object, names: Iterable[str]) -> str:
    """Return ": perhaps ... is meant", or nothing where no name is near."""
    near = nearest(name, names)
    return f": perhaps {near} is meant" if near else ""
