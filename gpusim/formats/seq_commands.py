"""The commands of a CODE V lens file, and the system and surfaces that they belong to."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from gpusim.formats.imported import INFINITE
from gpusim.formats.reading import Reading
from gpusim.formats.text import finite

# Coefficients of r^4, r^6 ... r^20 (CODE V has no I).
_ASPHERE = {letter: f"a{4 + 2 * i}" for i, letter in enumerate("ABCDEFGHJ")}
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
READ_OF_SYSTEM = frozenset(
    "RDM DIM EPD FNO NA NAO WL REF XAN YAN XOB YOB XIM YIM XRI YRI VUX VLX VUY VLY PRV".split()
)
_SURFACE = re.compile(r"S(\d+|O|I)$")


@dataclass
class Row:
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


class SeqFile(Reading):
    """One file being read.

    Attributes
    ----------
    rows : list of Row
        The object, and the surfaces of the lens.
    image : Row or None
    stop : int or None
        Number of the surface.
    system : dict of str to list of str
        Commands that belong to no surface, and their values.
    solved : bool
        Whether the image is at the paraxial focus.
    system_ignored : list of str
    private : set of str
        Glasses of the file's own catalogue.
    files : dict of str to None
        Catalogue files beside the lens that its glasses name, in their order.
    """

    def __init__(self, text: str, file: Path) -> None:
        super().__init__(file)
        self.rows: list[Row] = []
        self.image: Row | None = None
        self.stop: int | None = None
        self.system: dict[str, list[str]] = {}
        self.solved = False
        self.system_ignored: list[str] = []
        self.private: set[str] = set()
        self.files: dict[str, None] = {}
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

    def near(self) -> bool:
        """Whether the object is not at infinity."""
        return self.rows[0].thickness < INFINITE

    def curvatures(self) -> bool:
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
        elif key in READ_OF_SYSTEM:
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
                ", ".join(sorted(_READ_OF_SURFACE | READ_OF_SYSTEM)),
            )

    def _ignore(self, target: Row | None, key: str) -> None:
        (self.system_ignored if target is None else target.ignored).append(key)

    def _target(self, key: str, values: list[str]) -> Row | None:
        """Return the surface that a command is about: the one it names, or the open one."""
        qualifier = _SURFACE.match(values[0].upper()) if values else None
        if qualifier is None or key in READ_OF_SYSTEM:
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
        row = Row(len(self.rows))
        where = name if name in ("SO", "SI") else f"S{row.number}"
        row.shape, row.thickness = self.numbers(where, values[:2], 2)
        if len(values) > 2:
            self._glass_word(row, where, values[2:])
        row.keys.append("S")
        if name == "SI":
            self.image = row
        else:
            self.rows.append(row)

    def _glass_word(self, row: Row, where: str, words: list[str]) -> None:
        row.quoted = words[0][:1] in "'\""
        row.glass = words[0].strip("'\"")
        modes = [word.upper() for word in [row.glass, *words[1:]]]
        if "REFL" in modes or "TIRO" in modes:
            raise self.refuse("mirrors are not modelled", where, " ".join(words), "a glass or air")
        if set(modes[1:]) - {"REFR"}:
            raise self.refuse(
                "words follow the glass that are not understood", where, " ".join(words), "REFR"
            )

    def _of_surface(self, row: Row, key: str, where: str, values: list[str]) -> None:
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
            if key == ("RDY" if self.curvatures() else "CUY") and shape:
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

    def _clear(self, row: Row, where: str, values: list[str]) -> None:
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


def _is_number(word: str) -> bool:
    try:
        finite(word)
    except ValueError:
        return False
    return True


def _is_zero(word: str) -> bool:
    return _is_number(word) and finite(word) == 0
