"""Reader of Zemax sequential lens files (.zmx, UTF-16 or ANSI).

A file is lines of ``KEY value ...``; indented keys belong to the last ``SURF``. What would change
the optics and is not understood is refused by name; what is left out or read in another sense is
listed in the account. Nothing in a file is executed. The keywords are those of the files that
OpticStudio writes; their meaning is given in its manual under the editors that they come from.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from gpusim.errors import UserError
from gpusim.formats.agf import read_agf
from gpusim.formats.imported import INFINITE, ON_LINE, Beam, Fields, finished, radial_angle_deg
from gpusim.formats.text import decoded, finite
from gpusim.lens.account import Account
from gpusim.lens.glass import BOOKS, catalogue
from gpusim.lens.prescription import Prescription
from gpusim.lens.surface import ASPHERE_POWERS

# Surface keys that carry no optics: display, solves (their result stands beside them), comments,
# mirror substrate, mechanical size, propagation and coating-layout settings.
_HARMLESS_SURFACE_KEYS = frozenset(
    "COMM HIDE SLAB MIRR POPS MEMA OEMA FIMP PPAR PZUP VPAR VDSZ VCUR VCON MAZH MAZP CHZH "
    "SCOL SOPA HASH TCEX BDRO EDGE PRVT OVAL".split()
)
_READ_SURFACE_KEYS = frozenset(
    "TYPE CURV DISZ CONI PARM XDAT GLAS DIAM STOP CLAP FLAP COAT".split()
)
_REFUSED_SURFACE_KEYS = {
    "OBSC": "a central obscuration is not modelled",
    "SPID": "a spider is not modelled",
    "SQAP": "a rectangular aperture is not modelled",
    "SQOB": "a rectangular obscuration is not modelled",
    "ELAP": "an elliptical aperture is not modelled",
    "ELOB": "an elliptical obscuration is not modelled",
    "UDAD": "an aperture from a file is not modelled",
    "OBDC": "a decentred aperture is not modelled",
    "SCBD": "a tilted or decentred surface is not modelled",
}
# Fields and vignetting factors in files of about 2003 and before.
_OLD_KEYS = {
    "XFLD": "XFLN",
    "YFLD": "YFLN",
    "ZVDX": "VDXN",
    "ZVDY": "VDYN",
    "ZVCX": "VCXN",
    "ZVCY": "VCYN",
    "ZVAN": "VANN",
}
_EVEN_TERMS = 8  # PARM 1 to 8 of an even asphere: r^2 to r^16
# What OpticStudio writes as nd and Vd beside a glass of which it recorded none.
_NO_INDEX = {(0.0, 0.0), (1.5, 40.0)}


@dataclass
class _Block:
    """The lines of one surface, or of the head: key to the values of each occurrence."""

    number: int | None
    lines: dict[str, list[list[str]]] = field(default_factory=dict)

    def first(self, key: str) -> list[str] | None:
        return self.lines[key][0] if key in self.lines else None


class _Reader:
    """One file being read."""

    def __init__(self, text: str, file: Path) -> None:
        self.file = file
        self.account = Account()
        self.head = _Block(None)
        self.surfaces: list[_Block] = []
        self.vignetted = False  # some field has vignetting factors
        self.beams_known = True  # and all of them are in the meridional plane
        self.working = False  # the f-number is that of the beam from the object
        for line in text.splitlines():
            words = line.split()
            if not words:
                continue
            key, values = words[0].upper(), words[1:]
            if key == "SURF":
                if values[:1] != [str(len(self.surfaces))]:
                    raise self.refuse(
                        "the surfaces are not numbered in order: the file is damaged",
                        "SURF",
                        " ".join(values),
                        f"SURF {len(self.surfaces)}",
                    )
                self.surfaces.append(_Block(len(self.surfaces)))
                continue
            key = _OLD_KEYS.get(key, key)
            # Only indented lines belong to a surface; operands and settings may follow the last.
            indented = line[0] in " \t" and self.surfaces
            block = self.surfaces[-1] if indented else self.head
            block.lines.setdefault(key, []).append(values)

    def refuse(self, problem: str, where: str, value: object, allowed: str) -> UserError:
        return UserError(problem, file=self.file, field=where, value=value, allowed=allowed)

    def number(self, block: _Block, key: str, position: int = 0, default: float = 0.0) -> float:
        """Return one number of a key, or the default where the key or the number is missing."""
        values = block.first(key)
        if values is None or len(values) <= position:
            return default
        try:
            return finite(values[position])
        except ValueError as error:
            where = key if block.number is None else f"SURF {block.number} {key}"
            raise self.refuse(
                "a value is not a number", where, values[position], "a number"
            ) from error

    # --- the head -----------------------------------------------------------------------------

    def settings(self) -> tuple[dict[str, object], Fields]:
        """Return everything but the surfaces and fields as fields of a prescription; fields."""
        head = self.head
        mode = (head.first("MODE") or ["SEQ"])[0]
        if mode != "SEQ":
            raise self.refuse("the file is not a sequential lens", "MODE", mode, "SEQ")
        unit = (head.first("UNIT") or ["none"])[0]
        if unit != "MM":
            raise self.refuse("lens units other than millimetres are not read", "UNIT", unit, "MM")
        # ENVD temperature pressure adjust: at 20 degC and 1 atm the adjustment is none.
        at_home = self.number(head, "ENVD", 0, 20) == 20 and self.number(head, "ENVD", 1, 1) == 1
        if self.number(head, "ENVD", 2) != 0 and not at_home:
            raise self.refuse(
                "indices adjusted to an environment are not modelled",
                "ENVD",
                " ".join(head.first("ENVD")),
                "20 degC and 1 atm, or no adjustment (third number 0)",
            )
        used = {"MODE", "UNIT", "ENVD", "NAME", "NOTE", "GCAT"}
        wavelengths = self._wavelengths(used)
        fields = self._fields(used)
        aperture = self._aperture(used) | self._apodisation(used)
        if "RAIM" in head.lines:
            self.account.substituted("file", "RAIM: every ray is aimed at the real stop")
            used.add("RAIM")
        for key in sorted(set(head.lines) - {"WWGT"} if "WAVL" in used else head.lines):
            if key in used:
                self.account.read("file", key)
            else:
                self.account.ignored("file", key)
        self._find_catalogues()
        notes = [" ".join(values[1:]) for values in head.lines.get("NOTE", [])]
        return {
            "title": " ".join(head.first("NAME") or []) or self.file.stem,
            "patent": None,
            "source": f"Zemax file {self.file.name}",
            "notes": " ".join(note for note in notes if note),
            "units": "mm",
            "glass_catalogues": tuple(self.catalogues),
            "focus": "as-given",
            **wavelengths,
            **aperture,
        }, fields

    def _find_catalogues(self) -> None:
        """Find each catalogue of GCAT: a file of its name beside the lens, or one offline."""
        beside = {path.name.upper(): path for path in self.file.parent.glob("*.*")}
        self.catalogues: list[str] = []
        self.glasses: list[set[str]] = []
        self.wanted = [name.upper() for name in self.head.first("GCAT") or []]
        for name in self.wanted:
            if f"{name}.AGF" in beside:
                path = beside[f"{name}.AGF"]
                self.catalogues.append(path.name)
                self.account.read("file", f"GCAT {name}: from {path.name} beside the lens")
            elif name in BOOKS:
                self.catalogues.append(name)
            else:
                self.account.ignored("file", f"GCAT {name}: no such catalogue offline")

    def _has_glass(self, name: str) -> bool:
        """Whether a catalogue of the file, or any where it names none, holds the glass."""
        return any(
            name.upper()
            in (catalogue(entry) if entry in BOOKS else read_agf(self.file.parent / entry))
            for entry in self.catalogues or ([] if self.wanted else BOOKS)
        )

    def _wavelengths(self, used: set[str]) -> dict[str, object]:
        """Read ``WAVM i um weight`` lines, or the one ``WAVL um um ...`` of old files."""
        head = self.head
        key = "WAVL" if "WAVL" in head.lines and "WAVM" not in head.lines else "WAVM"
        if key == "WAVL":
            listed = [[str(i), word] for i, word in enumerate(head.first("WAVL"), start=1)]
        else:
            listed = head.lines.get("WAVM", [])
        # Old files do not say how many: as many as the line has.
        count = self.number(head, "FTYP", 3, len(listed) if key == "WAVL" else 1)
        wavelengths = []
        for values in listed:
            try:
                order, micrometres = int(values[0]), finite(values[1])
            except (IndexError, ValueError) as error:
                raise self.refuse(
                    "a wavelength is not a number", key, " ".join(values), "a number of um"
                ) from error
            if order <= count:
                wavelengths.append(micrometres * 1e3)
        if not wavelengths:
            raise self.refuse(
                "the file states no wavelength", key, None, "WAVM i um weight, or WAVL um um ..."
            )
        primary = int(self.number(head, "PWAV", 0, 1))
        if not 1 <= primary <= len(wavelengths):
            raise self.refuse(
                "the primary wavelength is not in the list",
                "PWAV",
                primary,
                f"1 to {len(wavelengths)}",
            )
        weights = "WWGT" if key == "WAVL" else "WAVM weights"
        self.account.ignored("file", f"{weights}: spectra are given where a bank is used")
        used |= {key, "PWAV"}
        return {
            "design_wavelengths_nm": tuple(wavelengths),
            "reference_nm": wavelengths[primary - 1],
        }

    def _fields(self, used: set[str]) -> Fields:
        head = self.head
        kinds = {0: "angle", 2: "paraxial image height", 3: "real image height"}
        if self.distance() is not None:
            kinds[1] = "object height"
        if "FTYP" not in head.lines:
            raise self.refuse("the file states no field type", "FTYP", None, "FTYP 0 (angle)")
        kind = self.number(head, "FTYP", 0)
        if kind not in kinds:
            name = {1: "object height", 4: "theodolite angle"}.get(kind, f"{kind:g}")
            raise self.refuse(
                "this field type is not read"
                + (": the object is at infinity" if self.distance() is None else ""),
                "FTYP",
                name,
                ", ".join(f"{number} {kind}" for number, kind in sorted(kinds.items())),
            )
        if self.number(head, "FTYP", 1) != 0:
            raise self.refuse(
                "an object-space telecentric lens", "FTYP", " ".join(head.first("FTYP")), "0"
            )
        stated = max(len(head.first("XFLN") or []), len(head.first("YFLN") or []))
        count = int(min(self.number(head, "FTYP", 2, stated), stated))
        if count < 1:
            raise self.refuse("the file states no field", "YFLN", None, "YFLN values")
        at = [(self.number(head, "XFLN", i), self.number(head, "YFLN", i)) for i in range(count)]
        size = radial_angle_deg if kind == 0 else math.hypot
        sizes = tuple(size(x, y) for x, y in at)
        used |= {"FTYP", "XFLN", "YFLN"}
        beams = []
        for i, (x, y) in enumerate(at):
            decentre_x, decentre_y, compress_x, compress_y, turn = (
                self.number(head, key, i) for key in ("VDXN", "VDYN", "VCXN", "VCYN", "VANN")
            )
            if (decentre_x, decentre_y, compress_x, compress_y) == (0, 0, 0, 0):
                if kind == 0 and x == 0:
                    beams.append(Beam(abs(y), 0.0, 0.0, 1.0, 1.0))
                continue
            self.vignetted = True
            if kind != 0 or x != 0 or turn != 0:
                self.beams_known = False
            mirror = -1 if y < 0 else 1
            beams.append(
                Beam(abs(y), decentre_x, mirror * decentre_y, 1 - compress_x, 1 - compress_y)
            )
        if self.vignetted:
            self.account.substituted(
                "file",
                "VDXN, VDYN, VCXN, VCYN, VANN: vignetting factors by the clear apertures of the "
                "surfaces, which the program sizes with them",
            )
        used |= {"VDXN", "VDYN", "VCXN", "VCYN", "VANN"}
        return Fields(kinds[int(kind)], sizes, tuple(beams) if self.vignetted else ())

    def distance(self) -> float | None:
        """Return the distance of the object; None at infinity.

        Raises
        ------
        UserError
            Where it does not lie before the lens.
        """
        object_ = self.surfaces[0]
        text = (object_.first("DISZ") or ["none"])[0]
        if text.upper() == "INFINITY" or self.number(object_, "DISZ") >= INFINITE:
            return None
        if self.number(object_, "DISZ") <= 0:
            raise self.refuse(
                "the object does not lie before the lens", "SURF 0 DISZ", text, "> 0, or INFINITY"
            )
        return self.number(object_, "DISZ")

    def _aperture(self, used: set[str]) -> dict[str, object]:
        head, distance = self.head, self.distance()
        if distance is not None and "OBNA" in head.lines:
            used.add("OBNA")
            if {"FNUM", "ENPD"} & head.lines.keys():
                raise self.refuse("the file states two apertures", "OBNA", None, "one of them")
            size = self.number(head, "OBNA")
            if self.number(head, "OBNA", 1) != 0:  # the half angle of the cone
                size = math.sin(math.radians(size))
            return {"object_na": size}
        for key, name in (("FNUM", "f_number"), ("ENPD", "entrance_pupil_diameter_mm")):
            if key in head.lines:
                used.add(key)
                self.working = key == "FNUM" and self.number(head, "FNUM", 1) != 0
                if "OBNA" in head.lines:
                    used.add("OBNA")
                    self.account.ignored("file", f"OBNA: the object is at infinity, {key} rules")
                return {name: self.number(head, key)}
        if "FLOA" in head.lines:
            used.add("FLOA")
            return {"stop_semi_diameter_mm": self.number(self.surfaces[self._stop()], "DIAM")}
        if "OBNA" in head.lines:
            raise self.refuse(
                "an aperture given as numerical aperture in object space has no meaning for an "
                "object at infinity",
                "OBNA",
                " ".join(head.lines["OBNA"][0]),
                "FNUM, ENPD or FLOA",
            )
        raise self.refuse("the file states no aperture", "FNUM", None, "FNUM, ENPD or FLOA")

    def _apodisation(self, used: set[str]) -> dict[str, object]:
        """GFAC type factor: 0 uniform, 1 Gaussian exp(-factor rho^2), 2 cosine cubed."""
        kind, factor = self.number(self.head, "GFAC", 0), self.number(self.head, "GFAC", 1)
        if kind not in (0, 1) or not 0 <= factor <= 100:
            raise self.refuse(
                "this apodisation of the pupil is not modelled",
                "GFAC",
                " ".join(self.head.first("GFAC")),
                "0 (uniform), or 1 (Gaussian) with a factor from 0 to 100",
            )
        used.add("GFAC")
        if kind == 0 or factor == 0:
            return {}
        self.account.substituted(
            "file",
            f"GFAC: Gaussian apodisation over the entrance pupil, factor {factor:g}, by the same "
            "over the stop, at which rays are aimed",
        )
        return {"gaussian_apodisation": factor}

    def _stop(self) -> int:
        stops = [block.number for block in self.surfaces if "STOP" in block.lines]
        if len(stops) != 1:
            raise self.refuse(
                "the file has no stop" if not stops else "the file has several stops",
                "STOP",
                stops or None,
                "one surface with STOP",
            )
        return stops[0]

    # --- the surfaces -------------------------------------------------------------------------

    def prescription(self) -> Prescription:
        """Return the whole file as a prescription."""
        if len(self.surfaces) < 3:
            raise self.refuse(
                "not a lens file, or a truncated one: it needs an object, a lens and an image",
                "SURF",
                f"{len(self.surfaces)} surfaces",
                "3 or more",
            )
        settings, fields = self.settings()
        if (distance := self.distance()) is not None:
            settings["object_distance_mm"] = distance
        stop = self._stop()
        if not 1 <= stop <= len(self.surfaces) - 2:
            raise self.refuse(
                "the stop is the object or the image", "STOP", stop, "a surface of the lens"
            )
        self._ends()
        rows = []
        in_air = True
        for block in self.surfaces[1:-1]:
            row = self._surface(block, is_stop=block.number == stop, in_air=in_air)
            if self.vignetted and not self.beams_known and "semi_diameter" not in row:
                if not in_air or "glass" in row:
                    raise self.refuse(
                        "vignetting factors off the meridional plane or of image heights need the "
                        "clear aperture of every surface",
                        f"SURF {block.number} DIAM",
                        None,
                        "a semi-diameter",
                    )
            in_air = "glass" not in row
            rows.append(row)
        return finished(
            settings | {"stop": stop, "surfaces": rows},
            fields,
            self.account,
            self.file,
            "Zemax",
            working_f_number=self.working,
        )

    def _ends(self) -> None:
        """Refuse what the model has no place for in the object and image surfaces."""
        object_, image = self.surfaces[0], self.surfaces[-1]
        text = (object_.first("DISZ") or ["none"])[0]
        if self.distance() is not None:
            self.account.read("file", f"SURF 0 DISZ {text}: object distance")
        elif text.upper() != "INFINITY":
            self.account.substituted("file", f"SURF 0 DISZ {text}: by infinity")
        for block in (object_, image):
            place = f"SURF {block.number}"
            if self.number(block, "CURV"):
                raise self.refuse(
                    "a curved object or image is not modelled",
                    f"{place} CURV",
                    self.number(block, "CURV"),
                    "0",
                )
            if "GLAS" in block.lines:
                raise self.refuse(
                    "the object or image lies in glass, or the file is truncated",
                    f"{place} GLAS",
                    " ".join(block.lines["GLAS"][0]),
                    "air",
                )
        if "DISZ" not in image.lines or self.number(image, "DISZ") != 0:
            raise self.refuse(
                "the last surface is not an image: the file is truncated",
                f"SURF {image.number} DISZ",
                " ".join(image.first("DISZ") or []) or None,
                "0",
            )

    def _surface(self, block: _Block, *, is_stop: bool, in_air: bool) -> dict[str, object]:
        place = f"SURF {block.number}"
        kind = (block.lines.get("TYPE", [["STANDARD"]])[0] or ["none"])[0]
        if kind not in ("STANDARD", "EVENASPH", "XASPHERE"):
            problem = (
                "coordinate breaks are not modelled"
                if kind == "COORDBRK"
                else f"surface type {kind} is not modelled"
            )
            raise self.refuse(problem, f"{place} TYPE", kind, "STANDARD, EVENASPH, XASPHERE")
        for key in block.lines:
            if key in _REFUSED_SURFACE_KEYS or key not in (
                _HARMLESS_SURFACE_KEYS | _READ_SURFACE_KEYS
            ):
                raise self.refuse(
                    _REFUSED_SURFACE_KEYS.get(
                        key, f"surface key {key} is not understood and may change the optics"
                    ),
                    f"{place} {key}",
                    " ".join(block.lines[key][0]),
                    ", ".join(sorted(_READ_SURFACE_KEYS)),
                )
        for key in ("CURV", "DISZ"):
            if not block.first(key):
                raise self.refuse(
                    "a surface is incomplete: the file is truncated", place, None, f"a {key} line"
                )
        row: dict[str, object] = {
            "curvature": self.number(block, "CURV"),
            "thickness": self.number(block, "DISZ"),
            "conic": self.number(block, "CONI"),
        }
        self._polynomial(block, kind, row)
        self._glass(block, row)
        read = [key for key in block.lines if key in _READ_SURFACE_KEYS - {"COAT"}]
        clips = "CLAP" in block.lines or "FLAP" in block.lines
        if in_air and "glass" not in row and not clips:
            if "DIAM" in block.lines:
                read.remove("DIAM")
                why = "the system aperture sets the stop" if is_stop else "nothing clips in air"
                self.account.ignored(block.number, f"DIAM: {why}")
        else:
            self._aperture_of(block, row)
        self.account.read(block.number, ", ".join(read))
        if "COAT" in block.lines:
            self.account.substituted(block.number, "COAT: coating by uncoated Fresnel losses")
        ignored = [key for key in block.lines if key in _HARMLESS_SURFACE_KEYS]
        if ignored:
            self.account.ignored(block.number, ", ".join(ignored))
        return row

    def _indexed(self, block: _Block, key: str) -> dict[int, float]:
        """Return the values of ``KEY i value`` lines that are not 0."""
        found = {}
        for values in block.lines.get(key, []):
            try:
                order, value = int(values[0]), finite(values[1])
            except (IndexError, ValueError) as error:
                raise self.refuse(
                    "a parameter is not a number",
                    f"SURF {block.number} {key}",
                    " ".join(values),
                    f"{key} i value",
                ) from error
            if value:
                found[order] = value
        return found

    def _polynomial(self, block: _Block, kind: str, row: dict[str, object]) -> None:
        """Even aspheres: PARM i is the coefficient of r^(2i).

        Extended aspheres: XDAT 1 is the number of terms, XDAT 2 the normalisation radius R, and
        XDAT 2 + i the coefficient of (r/R)^(2i).
        """
        place = f"SURF {block.number}"
        lines = {
            f"{key} {order}": value
            for key in ("PARM", "XDAT")
            for order, value in self._indexed(block, key).items()
        }
        terms = {}
        if kind == "EVENASPH":
            names = {f"PARM {i}": 2 * i for i in range(1, _EVEN_TERMS + 1)}
            terms = {names[line]: lines.pop(line) for line in names.keys() & lines.keys()}
        elif kind == "XASPHERE":
            count, radius = lines.pop("XDAT 1", 0.0), lines.pop("XDAT 2", 0.0)
            # A radius whose 30th power is no double is no length of a lens either.
            if count < 0 or not 1e-10 < radius < 1e10:
                raise self.refuse(
                    "an extended asphere is incomplete",
                    f"{place} XDAT",
                    f"{count:g} terms, normalisation radius {radius:g}",
                    "XDAT 1 terms, XDAT 2 normalisation radius in mm",
                )
            names = {f"XDAT {i + 2}": 2 * i for i in range(1, len(ASPHERE_POWERS) + 1)}
            terms = {
                names[line]: lines.pop(line) / radius ** names[line]
                for line in names.keys() & lines.keys()
            }
            # Coefficients beyond the stated number of terms count for nothing.
            terms = {power: value for power, value in terms.items() if power <= 2 * count}
            lines = {line: v for line, v in lines.items() if int(line.split()[1]) - 2 <= count}
        if lines:
            line, value = next(iter(lines.items()))
            raise self.refuse(
                "a surface parameter is not understood",
                f"{place} {line}",
                value,
                "PARM 1 to 8 of an EVENASPH, up to 15 terms of an XASPHERE",
            )
        if terms:
            row["asphere"] = {f"a{power}": value for power, value in terms.items()}

    def _glass(self, block: _Block, row: dict[str, object]) -> None:
        """GLAS name mode pickup nd Vd dPgF ...: a catalogue glass, or the model glass."""
        values = block.first("GLAS")
        if values is None:
            return
        place = f"SURF {block.number} GLAS"
        name = values[0] if values else ""
        if name.upper() == "MIRROR":
            raise self.refuse("mirrors are not modelled", place, name, "a refracting glass")
        if not name:
            raise self.refuse("a glass has no name", place, None, "GLAS name ...")
        nd, vd = self.number(block, "GLAS", 3), self.number(block, "GLAS", 4)
        stated = (nd, vd) not in _NO_INDEX and nd > 1
        if name != "___BLANK" and (not stated or self._has_glass(name)):
            if self.wanted and not self.catalogues:
                raise self.refuse(
                    f"none of the file's glass catalogues is available, so glass {name!r} of "
                    f"surface {block.number} is unknown",
                    "GCAT",
                    " ".join(self.wanted),
                    f"{', '.join(BOOKS)}, or an .agf file of that name beside the lens",
                )
            row["glass"] = name
            return
        law = ON_LINE
        row["glass"], row["nd"], row["vd"] = "model", nd, vd
        if departs := self.number(block, "GLAS", 5):
            row["dpgf"] = departs
            law = f"by a model glass {departs:+g} off the normal line in P_g,F"
        if vd == 0:  # OpticStudio's model glass without dispersion
            del row["vd"]
            row.pop("dpgf", None)
            row["glass"], law = "constant", "by one index at every wavelength"
        what = "model glass" if name == "___BLANK" else f"{name}, which no catalogue has here,"
        self.account.substituted(block.number, f"GLAS: {what} nd {nd:g}, Vd {vd:g} {law}")

    def _aperture_of(self, block: _Block, row: dict[str, object]) -> None:
        """DIAM is the semi-diameter; CLAP a ring, of which only the outer edge is modelled."""
        sizes = [self.number(block, "DIAM")]
        for key in ("CLAP", "FLAP"):
            if self.number(block, key, 0) != 0:
                raise self.refuse(
                    "a central obscuration is not modelled",
                    f"SURF {block.number} {key}",
                    " ".join(block.lines[key][0]),
                    "an inner radius of 0",
                )
        sizes.append(self.number(block, "CLAP", 1))
        sizes = [size for size in sizes if size > 0]
        if sizes:
            row["semi_diameter"] = min(sizes)


def parse_zmx(content: bytes, file: Path) -> Prescription:
    """Read a Zemax lens file.

    Parameters
    ----------
    content : bytes
        The file: UTF-16 (with or without byte-order mark), UTF-8 or ANSI.
    file : Path
        Its name, for error texts; catalogue files are looked for beside it.

    Returns
    -------
    Prescription
        With ``focus: as-given``: the image plane is where the file has it; its ``account`` says
        what became of each line.

    Raises
    ------
    UserError
        Where the file is no lens, is truncated, or holds what is not modelled.
    """
    return _Reader(decoded(content), file).prescription()
