"""Reader of CODE V sequential lens files (.seq).

A file is commands with values: separated by ``;`` or lines, continued with ``&``, with comments
after ``!``; names are recognised by their first three letters in either case. ``SO``, ``S`` and
``SI`` open the object, a surface and the image; the commands after one belong to it, or to the
surface that they name as ``S3``. What would change the optics and is not understood is refused by
name; what is left out or read in another sense is listed in the account. Nothing is executed.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

from gpusim.errors import UserError
from gpusim.formats.imported import INFINITE, ON_LINE, Beam, Fields, finished, radial_angle_deg
from gpusim.formats.text import decoded, finite
from gpusim.lens.account import Account
from gpusim.lens.glass import BOOKS, catalogue
from gpusim.lens.prescription import Prescription

# Coefficients of r^4, r^6 ... r^20 (CODE V has no I).
_ASPHERE = {letter: f"a{4 + 2 * i}" for i, letter in enumerate("ABCDEFGHJ")}
_UNITS_MM = {"M": 1.0, "C": 10.0, "I": 25.4}
# Nothing of these changes the optics: titles, display, tolerances, optimisation controls of
# curvature, thickness, conic and coefficients, solves and pickups (their result stands beside
# them), settings of analyses, the end of the file.
_HARMLESS = frozenset(
    "LEN TIT INI UID SLB CCY THC CUC KC AC BC CC DC EC FC GC HC JC GLC CCC KCC PIM PIY PIK HMY HCY "
    "UMY UCY CUM THM DER CLS WTW WTF TEM GO CA POL END".split()
)
_REFUSED = {
    **dict.fromkeys(
        "XDE YDE ZDE ADE BDE CDE DAR BEN REV DEC RET GLB".split(),
        "tilted and decentred surfaces are not read",
    ),
    **dict.fromkeys(
        "SPS SPL CYL AAS YTO XTO NSS UDS".split(),
        "this special surface type is not modelled",
    ),
    **dict.fromkeys(
        "DIF HOE HOR HWL HCT HCO HCC GRT GRO GRS".split(),
        "diffractive surfaces are not modelled",
    ),
    **dict.fromkeys(
        "REX REY ELX ELY ADX ADY ARO".split(),
        "rectangular, elliptical and decentred apertures are not modelled",
    ),
    **dict.fromkeys("PUI PUX PUY PUW".split(), "pupil apodisation is not modelled"),
    "ZOO": "zoom positions are not read",
    "TIR": "total reflection as a mirror is not modelled",
    "AFO": "an afocal lens forms no image",
    "TEL": "an object-space telecentric lens is not modelled",
}
_READ_OF_SURFACE = frozenset(
    "RDY CUY THI GLA CON ASP SPH K STO CIR CUF COM RMD".split() + list(_ASPHERE)
)
_READ_OF_SYSTEM = frozenset(
    "RDM DIM EPD FNO NA NAO WL REF XAN YAN XOB YOB XIM YIM XRI YRI VUX VLX VUY VLY PRV".split()
)
_SURFACE = re.compile(r"S(\d+|O|I)$")
_CODE = re.compile(r"(\d{6})$|(\d{3,7})\.(\d{3,7})$")


@dataclass
class _Row:
    """One surface as far as it has been read: values in the file's own unit."""

    number: int
    shape: float = 0.0
    thickness: float = 0.0
    glass: str = ""
    quoted: bool = False  # the glass stands in quotes: a private one
    is_asphere: bool = False
    asphere: dict[str, float] = field(default_factory=dict)
    conic: float = 0.0
    clear: float | None = None
    keys: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)


def _commands(text: str) -> list[list[str]]:
    """Split a file into commands, each a list of words; text in quotes is one word with its quote.

    A ``&`` at the end of a line continues it; ``!`` starts a comment outside quotes.
    """
    lines, held = [], ""
    for line in text.splitlines():
        line = re.match(r"""(?:[^!'"]|'[^']*'?|"[^"]*"?)*""", line)[0].rstrip()
        held += line
        if held.endswith("&"):
            held = held[:-1] + " "
            continue
        lines.append(held)
        held = ""
    lines.append(held)
    commands = []
    for line in lines:
        words: list[str] = []
        for word in re.findall(r"""'[^']*'?|"[^"]*"?|;|[^\s;'"]+""", line):
            if word == ";":
                commands.append(words)
                words = []
            else:
                words.append(word)
        commands.append(words)
    return [words for words in commands if words]


class _Reader:
    """One file being read."""

    def __init__(self, text: str, file: Path) -> None:
        self.file = file
        self.account = Account()
        self.rows: list[_Row] = []
        self.image: _Row | None = None
        self.stop: int | None = None
        self.system: dict[str, list[str]] = {}
        self.solved = False  # the image is at the paraxial focus
        self.system_ignored: list[str] = []
        self.private: set[str] = set()
        self.files: dict[str, None] = {}  # catalogue files beside the lens that its glasses name
        in_private = False
        for words in _commands(text):
            name = words[0].upper()
            if in_private:
                in_private = name[:3] != "END"
                if name[:1] in "'\"":
                    self.private.add(name.strip("'\""))
                continue
            in_private = name == "PRV"
            self._command(name, words[1:])

    def refuse(
        self, problem: str, where: str, value: object = None, allowed: str | None = None
    ) -> UserError:
        return UserError(problem, file=self.file, field=where, value=value, allowed=allowed)

    def numbers(self, where: str, words: list[str], count: int = 1) -> list[float]:
        """Return all values of a command as numbers: at least so many."""
        try:
            found = [finite(word) for word in words]
        except ValueError as error:
            raise self.refuse(
                "a value is not a number", where, " ".join(words), "numbers"
            ) from error
        if len(found) < count:
            raise self.refuse(
                "a value is missing: the file is truncated", where, " ".join(words) or None,
                f"{count} numbers",
            )  # fmt: skip
        return found

    # --- commands -----------------------------------------------------------------------------

    def _command(self, name: str, values: list[str]) -> None:
        if name in ("S", "SO", "SI") or (_SURFACE.match(name) and len(values) >= 2):
            self._surface(name, values)
            return
        key = name if len(name) < 3 else name[:3]
        target = self._target(key, values)
        if target is not None and values and _SURFACE.match(values[0].upper()):
            values = values[1:]
        where = key if target is None else f"S{target.number} {key}"
        if key in _REFUSED:
            # CODE V also writes what is switched off or 0.
            off = all(word.upper() in ("N", "NO", "OFF") or _is_zero(word) for word in values)
            if not (values and off) and not (key == "ZOO" and values[:1] == ["1"]):
                raise self.refuse(_REFUSED[key], where, " ".join(values) or None)
            self._ignore(target, key)
        elif key in _READ_OF_SYSTEM:
            self.system[key] = values
        elif key in _READ_OF_SURFACE:
            if target is None:
                raise self.refuse(
                    f"{key} belongs to a surface, and none is open", where, " ".join(values) or None
                )
            self._of_surface(target, key, where, values)
        elif key in _HARMLESS:
            if key in ("PIM", "PIY"):
                self.solved = True
            if key == "TIT":
                self.system["TIT"] = values
            self._ignore(None if key in ("DER", "CLS", "PIK", "GO", "WTW", "WTF") else target, key)
        else:
            raise self.refuse(
                f"command {key} is not understood and may change the optics",
                where,
                " ".join(values) or None,
                ", ".join(sorted(_READ_OF_SURFACE | _READ_OF_SYSTEM)),
            )

    def _ignore(self, target: _Row | None, key: str) -> None:
        (self.system_ignored if target is None else target.ignored).append(key)

    def _target(self, key: str, values: list[str]) -> _Row | None:
        """Return the surface that a command is about: the one it names, or the open one."""
        qualifier = _SURFACE.match(values[0].upper()) if values else None
        if qualifier is None or key in _READ_OF_SYSTEM:
            return self.image or (self.rows[-1] if self.rows else None)
        which = qualifier[1]
        if which == "I" and self.image is not None:
            return self.image
        index = 0 if which == "O" else int(which) if which != "I" else -1
        if not 0 <= index < len(self.rows):
            raise self.refuse(
                "a command names a surface that is not there", key, values[0],
                f"S0 to S{len(self.rows) - 1}",
            )  # fmt: skip
        return self.rows[index]

    def _surface(self, name: str, values: list[str]) -> None:
        """``S shape thickness glass``: the glass is air where it is left out."""
        if name == "SO" and self.rows:
            raise self.refuse("the file has several object surfaces", "SO", None, "one")
        if name != "SO" and not self.rows:
            raise self.refuse("a surface comes before the object", name, " ".join(values), "SO")
        if self.image is not None:
            raise self.refuse("a surface comes after the image", name, " ".join(values), "SI last")
        row = _Row(len(self.rows))
        where = name if name in ("SO", "SI") else f"S{row.number}"
        row.shape, row.thickness = self.numbers(where, values[:2], 2)
        if len(values) > 2:
            self._glass_word(row, where, values[2:])
        row.keys.append("S")
        if name == "SI":
            self.image = row
        else:
            self.rows.append(row)

    def _glass_word(self, row: _Row, where: str, words: list[str]) -> None:
        row.quoted = words[0][:1] in "'\""
        row.glass = words[0].strip("'\"")
        modes = [word.upper() for word in [row.glass, *words[1:]]]
        if "REFL" in modes or "TIRO" in modes:
            raise self.refuse("mirrors are not modelled", where, " ".join(words), "a glass or air")
        if set(modes[1:]) - {"REFR"}:
            raise self.refuse(
                "words follow the glass that are not understood", where, " ".join(words), "REFR"
            )

    def _of_surface(self, row: _Row, key: str, where: str, values: list[str]) -> None:
        row.keys.append(key)
        if key == "STO":
            if self.stop is not None:
                raise self.refuse("the file has several stops", where, None, "one STO")
            self.stop = row.number
        elif key in ("CON", "ASP", "SPH"):
            row.is_asphere = key == "ASP"
            if key == "SPH":
                row.conic, row.asphere = 0.0, {}
        elif key == "K":
            row.conic = self.numbers(where, values)[0]
        elif key in _ASPHERE:
            row.asphere[_ASPHERE[key]] = self.numbers(where, values)[0]
        elif key == "THI":
            row.thickness = self.numbers(where, values)[0]
        elif key in ("RDY", "CUY"):
            shape = self.numbers(where, values)[0]
            if key == ("RDY" if self._curvatures() else "CUY") and shape:
                shape = 1 / shape
            row.shape = shape
        elif key == "GLA":
            if not values:
                raise self.refuse("a glass has no name", where)
            self._glass_word(row, where, values)
        elif key == "RMD":
            if [word.upper() for word in values] != ["REFR"]:
                raise self.refuse(
                    "mirrors are not modelled", where, " ".join(values) or None, "REFR"
                )
        elif key == "CUF":
            if self.numbers(where, values)[0]:
                raise self.refuse("a Fresnel surface is not modelled", where, values[0], "0")
        elif key == "CIR":
            self._clear(row, where, values)
        # COM is a comment.

    def _clear(self, row: _Row, where: str, values: list[str]) -> None:
        """``CIR r`` clips at a radius; EDG is the glass's edge; OBS and HOL take the middle out."""
        kinds = [word.upper() for word in values if not _is_number(word)]
        labels = [kind for kind in kinds if kind[:1] == "L" or kind[:1] in "'\""]
        kinds = [kind for kind in kinds if kind not in labels]
        if kinds and kinds != ["EDG"] and kinds != ["CLR"]:
            raise self.refuse(
                "central obscurations and holes are not modelled",
                where,
                " ".join(values),
                "CIR radius, CIR EDG radius",
            )
        size = self.numbers(where, [word for word in values if _is_number(word)])[0]
        if kinds == ["EDG"]:
            row.ignored.append("CIR EDG: the edge of the glass clips no ray")
        elif row.clear is None or size < row.clear:
            row.clear = size

    # --- the whole ----------------------------------------------------------------------------

    def _curvatures(self) -> bool:
        """Whether the numbers of the S lines are curvatures."""
        if "RDM" not in self.system:
            # Programs that read such files differ in what they then assume.
            raise self.refuse(
                "the file does not say whether its surfaces have radii or curvatures",
                "RDM",
                None,
                "RDM Y (radii) or RDM N (curvatures)",
            )
        mode = (self.system["RDM"] or ["Y"])[0].upper()[:1]
        if mode not in "YN":
            raise self.refuse("the radius mode is not understood", "RDM", mode, "Y or N")
        return mode == "N"

    def prescription(self) -> Prescription:
        """Return the whole file as a prescription."""
        if len(self.rows) < 2 or self.image is None:
            raise self.refuse(
                "not a CODE V lens file, or a truncated one: it needs SO, S and SI",
                "SI" if self.rows else "SO",
                f"{max(len(self.rows) - 1, 0)} lens surfaces",
                "SO, one S or more, SI",
            )
        curvatures = self._curvatures()
        unit = (self.system.get("DIM") or [""])[0].upper()[:1]
        if unit not in _UNITS_MM:
            raise self.refuse(
                "the file does not state its unit of length",
                "DIM",
                " ".join(self.system.get("DIM", [])) or None,
                "M (mm), C (cm) or I (inch)",
            )
        self._ends()
        lens_rows = self.rows[1:]
        if self.stop is None or not 1 <= self.stop <= len(lens_rows):
            raise self.refuse(
                "the file has no stop" if self.stop is None else "the stop is not in the lens",
                "STO",
                self.stop,
                "STO at one surface of the lens",
            )
        wavelengths, reference = self._wavelengths()
        fields = self._fields()
        surfaces = [self._converted(row, curvatures) for row in lens_rows]
        defocus = self.image.thickness
        focus = "as-given"
        if self.solved and lens_rows[-1].thickness == 0 and defocus == 0:
            focus = "paraxial"
            del surfaces[-1]["thickness"]
        elif defocus:
            surfaces[-1]["thickness"] = lens_rows[-1].thickness + defocus
            self.account.read("file", f"SI {defocus:g}: defocus, added to the last thickness")
        title = " ".join(self.system.get("TIT", [])).strip("'\"")
        data = {
            "title": title or self.file.stem,
            "patent": None,
            "source": f"CODE V file {self.file.name}",
            "units": "mm",
            "glass_catalogues": tuple(self.files),
            "focus": focus,
            "design_wavelengths_nm": wavelengths,
            "reference_nm": reference,
            "stop": self.stop,
            "surfaces": surfaces,
            **self._aperture(),
        }
        if self._near():
            data["object_distance_mm"] = self.rows[0].thickness
        keys = [key for key in self.system if key in _READ_OF_SYSTEM]
        self.account.read("file", ", ".join(keys))
        if self.system_ignored:
            self.account.ignored("file", ", ".join(dict.fromkeys(self.system_ignored)))
        return finished(
            data,
            fields,
            self.account,
            self.file,
            "CODE V",
            unit_mm=_UNITS_MM[unit],
            working_f_number=True,
        )

    def _near(self) -> bool:
        """Whether the object is not at infinity."""
        return self.rows[0].thickness < INFINITE

    def _ends(self) -> None:
        object_, image = self.rows[0], self.image
        if not self._near():
            self.account.substituted("file", f"SO {object_.thickness:g}: object at infinity")
        elif object_.thickness > 0:
            self.account.read("file", f"SO {object_.thickness:g}: object distance")
        else:
            raise self.refuse(
                "the object does not lie before the lens",
                "SO",
                object_.thickness,
                f"> 0, from {INFINITE:g} on infinity",
            )
        for row, name in ((object_, "SO"), (image, "SI")):
            if row.shape or row.asphere or row.conic:
                raise self.refuse("a curved object or image is not modelled", name, row.shape, "0")
            if row.glass and row.glass.upper() != "AIR":
                raise self.refuse("the object or image lies in glass", name, row.glass, "air")

    def _wavelengths(self) -> tuple[tuple[float, ...], float]:
        if not self.system.get("WL"):
            raise self.refuse("the file states no wavelength", "WL", None, "WL nm nm ...")
        found = self.numbers("WL", self.system["WL"])
        if "REF" in self.system:
            reference = self.numbers("REF", self.system["REF"])[0]
        else:
            reference = (len(found) + 1) // 2
            if len(found) > 1:
                self.account.substituted("file", f"REF not stated: by wavelength {reference}")
        if reference not in range(1, len(found) + 1):
            raise self.refuse(
                "the reference wavelength is not in the list", "REF", f"{reference:g}",
                f"1 to {len(found)}",
            )  # fmt: skip
        return tuple(found), found[int(reference) - 1]

    def _fields(self) -> Fields:
        kinds = {
            "AN": "angle",
            "IM": "paraxial image height",
            "RI": "real image height",
            "OB": "object height",
        }
        stated = [suffix for suffix in kinds if {"X" + suffix, "Y" + suffix} & set(self.system)]
        if len(stated) != 1:
            raise self.refuse(
                "the file states no field" if not stated else "the file has two types of field",
                "YAN",
                ", ".join(stated) or None,
                "XAN, YAN angles; XOB, YOB object heights; XIM, YIM or XRI, YRI image heights",
            )
        suffix = stated[0]
        if suffix == "OB" and not self._near():
            raise self.refuse(
                "object heights are not read: the object is at infinity", "YOB", None, "YAN"
            )

        def values(key: str, count: int) -> list[float]:
            found = self.numbers(key, self.system[key]) if key in self.system else []
            return (found + [0.0] * count)[:count]

        names = ("X" + suffix, "Y" + suffix)
        count = max(len(self.system.get(name, [])) for name in names)
        xs, ys = (values(name, count) for name in names)
        size = radial_angle_deg if suffix == "AN" else math.hypot
        factors = [values(key, count) for key in ("VUX", "VLX", "VUY", "VLY")]
        beams = ()
        if any(any(f) for f in factors):
            if suffix != "AN" or any(xs):
                raise self.refuse(
                    "vignetting factors are read for field angles in the meridional plane only",
                    "VUY",
                    None,
                    "YAN angles, and clear apertures in place of the factors otherwise",
                )
            beams = tuple(
                Beam(
                    abs(y),
                    (lower_x - upper_x) / 2,
                    (lower_y - upper_y) / (-2 if y < 0 else 2),
                    1 - (upper_x + lower_x) / 2,
                    1 - (upper_y + lower_y) / 2,
                )
                for y, upper_x, lower_x, upper_y, lower_y in zip(ys, *factors, strict=True)
            )
            self.account.substituted(
                "file",
                "VUX, VLX, VUY, VLY: vignetting factors by clear apertures: those of the file, and "
                "where it has none those that pass the beams of the factors",
            )
        if not count:
            raise self.refuse("the file states no field", names[1], None, "values")
        sizes = tuple(size(x, y) for x, y in zip(xs, ys, strict=True))
        return Fields(kinds[suffix], sizes, beams)

    def _aperture(self) -> dict[str, float]:
        names = {
            "EPD": "entrance_pupil_diameter_mm",
            "FNO": "f_number",
            "NA": "f_number",
            "NAO": "object_na",
        }
        stated = [key for key in names if key in self.system]
        if len(stated) != 1:
            raise self.refuse(
                "the file states no aperture" if not stated else "the file states two apertures",
                "EPD",
                ", ".join(stated) or None,
                "one of EPD, FNO, NA, NAO",
            )
        key = stated[0]
        value = self.numbers(key, self.system[key])[0]
        if value <= 0 or (key in ("NA", "NAO") and value >= 1):
            raise self.refuse("the aperture is wrong", key, value, "> 0 (NA, NAO: < 1)")
        if key == "NAO" and not self._near():
            raise self.refuse(
                "a numerical aperture in object space has no meaning for an object at infinity",
                key,
                value,
                "EPD, FNO or NA",
            )
        if key == "NA":
            self.account.substituted("file", f"NA {value:g}: by the f-number 1/(2 NA)")
            value = 1 / (2 * value)
        return {names[key]: value}

    def _converted(self, row: _Row, curvatures: bool) -> dict[str, object]:
        """Return a surface as the fields of the prescription."""
        where = f"S{row.number}"
        result: dict[str, object] = {"thickness": row.thickness, "conic": row.conic}
        if curvatures or row.shape == 0:  # a radius of 0 is a plane
            result["curvature"] = row.shape
        else:
            result["radius"] = row.shape
        terms = {key: value for key, value in row.asphere.items() if value}
        if terms and not row.is_asphere:
            raise self.refuse(
                "asphere coefficients at a surface that is no asphere", where, None, "ASP first"
            )
        if terms:
            result["asphere"] = terms
        if row.clear is not None:
            result["semi_diameter"] = row.clear
        if row.glass and row.glass.upper() != "AIR":
            result |= self._glass(row, where)
        self.account.read(row.number, ", ".join(dict.fromkeys(row.keys)))
        if row.ignored:
            self.account.ignored(row.number, ", ".join(dict.fromkeys(row.ignored)))
        return result

    def _glass(self, row: _Row, where: str) -> dict[str, object]:
        """``NAME_CATALOGUE`` without hyphens, a six-digit code, or a fictitious nnnnnn.vvvvvv."""
        name = row.glass.upper()
        if name in self.private or row.quoted:
            raise self.refuse(
                "glasses of a private catalogue (PRV) are not read", where, row.glass,
                "a catalogue glass, or nnnnnn.vvvvvv",
            )  # fmt: skip
        code = _CODE.match(name)
        if code:
            nd_digits, vd_digits = (name[:3], name[3:]) if code[1] else (code[2], code[3])
            nd = 1 + int(nd_digits) / 10 ** len(nd_digits)
            vd = int(vd_digits) / 10 ** (len(vd_digits) - 2)
            self.account.substituted(
                row.number, f"glass {row.glass}: nd {nd:g}, Vd {vd:g} {ON_LINE}"
            )
            return {"glass": "model", "nd": nd, "vd": vd}
        bare, underscore, book = name.rpartition("_")
        if not underscore:
            return {"glass": row.glass}
        beside = {path.name.upper(): path.name for path in self.file.parent.glob("*.*")}
        if f"{book}.AGF" in beside:
            self.files[beside[f"{book}.AGF"]] = None
            return {"glass": f"{book}/{bare}"}
        if book not in BOOKS:
            raise self.refuse(
                f"surface {row.number} names an unknown glass catalogue", where, row.glass,
                f"{', '.join(BOOKS)}, or an .agf file of that name beside the lens",
            )  # fmt: skip
        # CODE V leaves the hyphens out: NBK7 is N-BK7.
        pages = [page for page in catalogue(book) if page.replace("-", "") == bare.replace("-", "")]
        return {"glass": f"{book}/{pages[0] if len(pages) == 1 else bare}"}


def _is_number(word: str) -> bool:
    try:
        finite(word)
    except ValueError:
        return False
    return True


def _is_zero(word: str) -> bool:
    return _is_number(word) and finite(word) == 0


def parse_seq(content: bytes, file: Path) -> Prescription:
    """Read a CODE V lens file.

    Parameters
    ----------
    content : bytes
        The file: UTF-16, UTF-8 or ANSI.
    file : Path
        Its name, for error texts; catalogue files are looked for beside it.

    Returns
    -------
    Prescription
        In mm, whatever the file's unit; its ``account`` says what became of each command.

    Raises
    ------
    UserError
        Where the file is no lens, is truncated, or holds what is not modelled.
    """
    return _Reader(decoded(content), file).prescription()
