"""The head of a Zemax lens file: wavelengths, fields, vignetting factors and aperture."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gpusim.formats.imported import Beam, FieldKind, Fields
from gpusim.formats.text import finite
from gpusim.formats.zmx_glasses import Glasses
from gpusim.formats.zmx_lines import ZmxFile


@dataclass(frozen=True)
class System:
    """What a file says of everything but its surfaces.

    Attributes
    ----------
    data : dict
        By the names that a prescription has for it.
    fields : Fields
    beams_known : bool
        Whether all fields that have vignetting factors lie in the meridional plane.
    working : bool
        Whether the f-number is that of the beam from the object.
    glasses : Glasses
    """

    data: dict[str, object]
    fields: Fields
    beams_known: bool
    working: bool
    glasses: Glasses


def system_of(zmx: ZmxFile) -> System:
    """Read the head of a file."""
    head = zmx.head
    mode = (head.first("MODE") or ["SEQ"])[0]
    if mode != "SEQ":
        raise zmx.refuse("the file is not a sequential lens", "MODE", mode, "SEQ")
    unit = (head.first("UNIT") or ["none"])[0]
    if unit != "MM":
        raise zmx.refuse("lens units other than millimetres are not read", "UNIT", unit, "MM")
    # ENVD temperature pressure adjust: at 20 degC and 1 atm the adjustment is none.
    at_home = zmx.number(head, "ENVD", 0, 20) == 20 and zmx.number(head, "ENVD", 1, 1) == 1
    if zmx.number(head, "ENVD", 2) != 0 and not at_home:
        raise zmx.refuse(
            "indices adjusted to an environment are not modelled",
            "ENVD",
            " ".join(head.first("ENVD")),
            "20 degC and 1 atm, or no adjustment (third number 0)",
        )
    used = {"MODE", "UNIT", "ENVD", "NAME", "NOTE", "GCAT"}
    wavelengths = _wavelengths(zmx, used)
    fields, meridional = _fields(zmx, used)
    aperture = _aperture(zmx, used) | _apodisation(zmx, used)
    if "RAIM" in head.lines:
        zmx.import_log.substituted("file", "RAIM: every ray is aimed at the real stop")
        used.add("RAIM")
    for key in sorted(set(head.lines) - {"WWGT"} if "WAVL" in used else head.lines):
        if key in used:
            zmx.import_log.read("file", key)
        else:
            zmx.import_log.ignored("file", key)
    glasses = Glasses(zmx)
    notes = [" ".join(values[1:]) for values in head.lines.get("NOTE", [])]
    data = {
        "title": " ".join(head.first("NAME") or []) or zmx.file.stem,
        "patent": None,
        "source": f"Zemax file {zmx.file.name}",
        "notes": " ".join(note for note in notes if note),
        "units": "mm",
        "glass_catalogues": tuple(glasses.catalogues),
        "focus": "as-given",
        **wavelengths,
        **aperture,
    }
    if (distance := zmx.distance()) is not None:
        data["object_distance_mm"] = distance
    working = "f_number" in aperture and zmx.number(head, "FNUM", 1) != 0
    return System(data, fields, meridional, working, glasses)


def _wavelengths(zmx: ZmxFile, used: set[str]) -> dict[str, object]:
    """Read ``WAVM i um weight`` lines, or the one ``WAVL um um ...`` of old files."""
    head = zmx.head
    key = "WAVL" if "WAVL" in head.lines and "WAVM" not in head.lines else "WAVM"
    if key == "WAVL":
        listed = [[str(i), word] for i, word in enumerate(head.first("WAVL"), start=1)]
    else:
        listed = head.lines.get("WAVM", [])
    # Old files do not say how many: as many as the line has.
    count = zmx.number(head, "FTYP", 3, len(listed) if key == "WAVL" else 1)
    wavelengths = []
    for values in listed:
        try:
            order, micrometres = int(values[0]), finite(values[1])
        except (IndexError, ValueError) as error:
            raise zmx.refuse(
                "a wavelength is not a number", key, " ".join(values), "a number of um"
            ) from error
        if order <= count:
            wavelengths.append(micrometres * 1e3)
    if not wavelengths:
        raise zmx.refuse(
            "the file states no wavelength", key, None, "WAVM i um weight, or WAVL um um ..."
        )
    primary = int(zmx.number(head, "PWAV", 0, 1))
    if not 1 <= primary <= len(wavelengths):
        raise zmx.refuse(
            "the primary wavelength is not in the list",
            "PWAV",
            primary,
            f"1 to {len(wavelengths)}",
        )
    weights = "WWGT" if key == "WAVL" else "WAVM weights"
    zmx.import_log.ignored("file", f"{weights}: spectra are given where a bank is used")
    used |= {key, "PWAV"}
    return {
        "design_wavelengths_nm": tuple(wavelengths),
        "reference_nm": wavelengths[primary - 1],
    }


def _fields(zmx: ZmxFile, used: set[str]) -> tuple[Fields, bool]:
    """Return the fields, and whether all their beams are known: those in the meridional plane."""
    head = zmx.head
    kind = _field_kind(zmx)
    stated = max(len(head.first("XFLN") or []), len(head.first("YFLN") or []))
    count = int(min(zmx.number(head, "FTYP", 2, stated), stated))
    if count < 1:
        raise zmx.refuse("the file states no field", "YFLN", None, "YFLN values")
    at = [(zmx.number(head, "XFLN", i), zmx.number(head, "YFLN", i)) for i in range(count)]
    used |= {"FTYP", "XFLN", "YFLN", "VDXN", "VDYN", "VCXN", "VCYN", "VANN"}
    beams, meridional = _beams(zmx, at, kind == "angle")
    if beams:
        zmx.import_log.substituted(
            "file",
            "VDXN, VDYN, VCXN, VCYN, VANN: vignetting factors by the clear apertures of the "
            "surfaces, which the program sizes with them",
        )
    return Fields.at(kind, at, beams), meridional


def _field_kind(zmx: ZmxFile) -> FieldKind:
    """Return what the field type is in a prescription."""
    head = zmx.head
    kinds: dict[int, FieldKind] = {0: "angle", 2: "paraxial image height", 3: "real image height"}
    if zmx.distance() is not None:
        kinds[1] = "object height"
    if "FTYP" not in head.lines:
        raise zmx.refuse("the file states no field type", "FTYP", None, "FTYP 0 (angle)")
    kind = zmx.number(head, "FTYP", 0)
    if kind not in kinds:
        name = {1: "object height", 4: "theodolite angle"}.get(kind, f"{kind:g}")
        raise zmx.refuse(
            "this field type is not read"
            + (": the object is at infinity" if zmx.distance() is None else ""),
            "FTYP",
            name,
            ", ".join(f"{number} {kind}" for number, kind in sorted(kinds.items())),
        )
    if zmx.number(head, "FTYP", 1) != 0:
        raise zmx.refuse(
            "an object-space telecentric lens", "FTYP", " ".join(head.first("FTYP")), "0"
        )
    return kinds[int(kind)]


def _beams(
    zmx: ZmxFile, at: list[tuple[float, float]], angles: bool
) -> tuple[tuple[Beam, ...], bool]:
    """Return the beams of the vignetting factors, none without them, and whether all are known."""
    beams, vignetted, meridional = [], False, True
    for i, (x, y) in enumerate(at):
        decentre_x, decentre_y, compress_x, compress_y, turn = (
            zmx.number(zmx.head, key, i) for key in ("VDXN", "VDYN", "VCXN", "VCYN", "VANN")
        )
        if (decentre_x, decentre_y, compress_x, compress_y) == (0, 0, 0, 0):
            if angles and x == 0:
                beams.append(Beam.of_field(y))
            continue
        vignetted = True
        if not angles or x != 0 or turn != 0:
            meridional = False
        beams.append(Beam.of_field(y, decentre_x, decentre_y, 1 - compress_x, 1 - compress_y))
    return (tuple(beams) if vignetted else ()), meridional


def _aperture(zmx: ZmxFile, used: set[str]) -> dict[str, object]:
    """Return the size of the beam by the name that a prescription has for it."""
    head, distance = zmx.head, zmx.distance()
    if distance is not None and "OBNA" in head.lines:
        used.add("OBNA")
        if {"FNUM", "ENPD"} & head.lines.keys():
            raise zmx.refuse("the file states two apertures", "OBNA", None, "one of them")
        size = zmx.number(head, "OBNA")
        if zmx.number(head, "OBNA", 1) != 0:  # the half angle of the cone
            size = math.sin(math.radians(size))
        return {"object_na": size}
    for key, name in (("FNUM", "f_number"), ("ENPD", "entrance_pupil_diameter_mm")):
        if key in head.lines:
            used.add(key)
            if "OBNA" in head.lines:
                used.add("OBNA")
                zmx.import_log.ignored("file", f"OBNA: the object is at infinity, {key} rules")
            return {name: zmx.number(head, key)}
    if "FLOA" in head.lines:
        used.add("FLOA")
        return {"stop_semi_diameter_mm": zmx.number(zmx.surfaces[zmx.stop()], "DIAM")}
    if "OBNA" in head.lines:
        raise zmx.refuse(
            "an aperture given as numerical aperture in object space has no meaning for an "
            "object at infinity",
            "OBNA",
            " ".join(head.lines["OBNA"][0]),
            "FNUM, ENPD or FLOA",
        )
    raise zmx.refuse("the file states no aperture", "FNUM", None, "FNUM, ENPD or FLOA")


def _apodisation(zmx: ZmxFile, used: set[str]) -> dict[str, object]:
    """GFAC type factor: 0 uniform, 1 Gaussian exp(-factor rho^2), 2 cosine cubed."""
    kind, factor = zmx.number(zmx.head, "GFAC", 0), zmx.number(zmx.head, "GFAC", 1)
    if kind not in (0, 1) or not 0 <= factor <= 100:
        raise zmx.refuse(
            "this apodisation of the pupil is not modelled",
            "GFAC",
            " ".join(zmx.head.first("GFAC")),
            "0 (uniform), or 1 (Gaussian) with a factor from 0 to 100",
        )
    used.add("GFAC")
    if kind == 0 or factor == 0:
        return {}
    zmx.import_log.substituted(
        "file",
        f"GFAC: Gaussian apodisation over the entrance pupil, factor {factor:g}, by the same "
        "over the stop, at which rays are aimed",
    )
    return {"gaussian_apodisation": factor}
