"""What a CODE V lens file says of the system: wavelengths, fields, vignetting and aperture."""

from __future__ import annotations

from gpusim.formats.imported import Beam, FieldKind, Fields
from gpusim.formats.seq_commands import SeqFile


def wavelengths_of(seq: SeqFile) -> tuple[tuple[float, ...], float]:
    """Return the wavelengths of a file, nm, and that of reference."""
    if not seq.system.get("WL"):
        raise seq.refuse("the file states no wavelength", "WL", None, "WL nm nm ...")
    found = seq.numbers("WL", seq.system["WL"])
    if "REF" in seq.system:
        reference = seq.numbers("REF", seq.system["REF"])[0]
    else:
        reference = (len(found) + 1) // 2
        if len(found) > 1:
            seq.import_log.substituted("file", f"REF not stated: by wavelength {reference}")
    if reference not in range(1, len(found) + 1):
        raise seq.refuse(
            "the reference wavelength is not in the list", "REF", f"{reference:g}",
            f"1 to {len(found)}",
        )  # fmt: skip
    return tuple(found), found[int(reference) - 1]


def fields_of(seq: SeqFile) -> Fields:
    """Return the fields of a file, and the beams of its vignetting factors."""
    kinds: dict[str, FieldKind] = {
        "AN": "angle",
        "IM": "paraxial image height",
        "RI": "real image height",
        "OB": "object height",
    }
    stated = [suffix for suffix in kinds if {"X" + suffix, "Y" + suffix} & set(seq.system)]
    if len(stated) != 1:
        raise seq.refuse(
            "the file states no field" if not stated else "the file has two types of field",
            "YAN",
            ", ".join(stated) or None,
            "XAN, YAN angles; XOB, YOB object heights; XIM, YIM or XRI, YRI image heights",
        )
    suffix = stated[0]
    if suffix == "OB" and not seq.near():
        raise seq.refuse(
            "object heights are not read: the object is at infinity", "YOB", None, "YAN"
        )

    names = ("X" + suffix, "Y" + suffix)
    count = max(len(seq.system.get(name, [])) for name in names)
    xs, ys = (_values(seq, name, count) for name in names)
    beams = _beams(seq, suffix, xs, ys)
    if not count:
        raise seq.refuse("the file states no field", names[1], None, "values")
    return Fields.at(kinds[suffix], zip(xs, ys, strict=True), beams)


def _values(seq: SeqFile, key: str, count: int) -> list[float]:
    """Return so many numbers of a command, 0 where it has none."""
    found = seq.numbers(key, seq.system[key]) if key in seq.system else []
    return (found + [0.0] * count)[:count]


def _beams(seq: SeqFile, suffix: str, xs: list[float], ys: list[float]) -> tuple[Beam, ...]:
    """Return the beams of the vignetting factors of fields; none without factors."""
    factors = [_values(seq, key, len(ys)) for key in ("VUX", "VLX", "VUY", "VLY")]
    if not any(any(f) for f in factors):
        return ()
    if suffix != "AN" or any(xs):
        raise seq.refuse(
            "vignetting factors are read for field angles in the meridional plane only",
            "VUY",
            None,
            "YAN angles, and clear apertures in place of the factors otherwise",
        )
    beams = tuple(
        Beam.of_field(
            y,
            (lower_x - upper_x) / 2,
            (lower_y - upper_y) / 2,
            1 - (upper_x + lower_x) / 2,
            1 - (upper_y + lower_y) / 2,
        )
        for y, upper_x, lower_x, upper_y, lower_y in zip(ys, *factors, strict=True)
    )
    seq.import_log.substituted(
        "file",
        "VUX, VLX, VUY, VLY: vignetting factors by clear apertures: those of the file, and "
        "where it has none those that pass the beams of the factors",
    )
    return beams


def aperture_of(seq: SeqFile) -> dict[str, float]:
    """Return the size of the beam by the name that a prescription has for it."""
    names = {
        "EPD": "entrance_pupil_diameter_mm",
        "FNO": "f_number",
        "NA": "f_number",
        "NAO": "object_na",
    }
    stated = [key for key in names if key in seq.system]
    if len(stated) != 1:
        raise seq.refuse(
            "the file states no aperture" if not stated else "the file states two apertures",
            "EPD",
            ", ".join(stated) or None,
            "one of EPD, FNO, NA, NAO",
        )
    key = stated[0]
    value = seq.numbers(key, seq.system[key])[0]
    if value <= 0 or (key in ("NA", "NAO") and value >= 1):
        raise seq.refuse("the aperture is wrong", key, value, "> 0 (NA, NAO: < 1)")
    if key == "NAO" and not seq.near():
        raise seq.refuse(
            "a numerical aperture in object space has no meaning for an object at infinity",
            key,
            value,
            "EPD, FNO or NA",
        )
    if key == "NA":
        seq.import_log.substituted("file", f"NA {value:g}: by the f-number 1/(2 NA)")
        value = 1 / (2 * value)
    return {names[key]: value}
