"""Reader of Zemax sequential lens files (.zmx, UTF-16 or ANSI).

A file is lines of ``KEY value ...``; indented keys belong to the last ``SURF``. What would change
the optics and is not understood is refused by name; what is left out or read in another sense is
listed in the account. Nothing in a file is executed. The keywords are those of the files that
OpticStudio writes; their meaning is given in its manual under the editors that they come from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from gpusim.errors import UserError
from gpusim.lens.account import Account
from gpusim.lens.glass import BOOKS
from gpusim.lens.prescription import ASPHERE_POWERS, Prescription, validated

# Surface keys that carry no optics: display, solves (their result stands beside them), comments,
# mirror substrate, mechanical size, propagation and coating-layout settings.
_HARMLESS_SURFACE_KEYS = frozenset(
    "COMM HIDE SLAB MIRR POPS FLAP MEMA FIMP PPAR PZUP VPAR VDSZ VCUR VCON MAZH MAZP CHZH "
    "SCOL SOPA HASH TCEX BDRO EDGE PRVT OVAL".split()
)


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
        for line in text.splitlines():
            words = line.split()
            if not words:
                continue
            key, values = words[0].upper(), words[1:]
            if key == "SURF":
                self.surfaces.append(_Block(len(self.surfaces)))
                continue
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
            return float(values[position])
        except ValueError as error:
            where = key if block.number is None else f"SURF {block.number} {key}"
            raise self.refuse(
                "a value is not a number", where, values[position], "a number"
            ) from error

    # --- the head -----------------------------------------------------------------------------

    def settings(self) -> dict[str, object]:
        """Return everything but the surfaces, as fields of a prescription."""
        head = self.head
        mode = (head.first("MODE") or ["SEQ"])[0]
        if mode != "SEQ":
            raise self.refuse("the file is not a sequential lens", "MODE", mode, "SEQ")
        unit = (head.first("UNIT") or ["none"])[0]
        if unit != "MM":
            raise self.refuse("lens units other than millimetres are not read", "UNIT", unit, "MM")
        # GFAC type factor: type 0 is uniform, type 1 Gaussian, uniform where its factor is 0.
        if self.number(head, "GFAC", 0) > 1 or self.number(head, "GFAC", 1) != 0:
            raise self.refuse(
                "pupil apodisation is not modelled",
                "GFAC",
                " ".join(head.first("GFAC")),
                "0 0 (uniform)",
            )
        environment = head.first("ENVD") or []
        if len(environment) > 2 and float(environment[2]) != 0:
            raise self.refuse(
                "indices adjusted to an environment are not modelled",
                "ENVD",
                " ".join(environment),
                "no adjustment (third number 0)",
            )
        used = {"MODE", "UNIT", "GFAC", "ENVD", "NAME", "NOTE", "GCAT"}
        fields_and_lines = self._fields_and_wavelengths(used)
        aperture = self._aperture(used)
        for key in ("VDXN", "VDYN", "VCXN", "VCYN"):
            if any(float(v) for v in head.first(key) or []):
                self.account.substituted(
                    "file", f"{key}: vignetting factors by the clear apertures of the surfaces"
                )
            used.add(key)
        if "RAIM" in head.lines:
            self.account.substituted("file", "RAIM: every ray is aimed at the real stop")
            used.add("RAIM")
        for key in sorted(head.lines):
            if key in used:
                self.account.read("file", key)
            else:
                self.account.ignored("file", key)
        catalogues = [name.upper() for name in head.first("GCAT") or []]
        for name in catalogues:
            if name not in BOOKS:
                self.account.ignored("file", f"GCAT {name}: no such catalogue offline")
        self.catalogues = catalogues
        notes = [" ".join(values[1:]) for values in head.lines.get("NOTE", [])]
        return {
            "title": " ".join(head.first("NAME") or []) or self.file.stem,
            "patent": None,
            "source": f"Zemax file {self.file.name}",
            "notes": " ".join(note for note in notes if note),
            "units": "mm",
            "glass_catalogues": tuple(name for name in catalogues if name in BOOKS),
            "focus": "as-given",
            **fields_and_lines,
            **aperture,
        }

    def _fields_and_wavelengths(self, used: set[str]) -> dict[str, object]:
        head = self.head
        kind = head.first("FTYP")
        if kind is None:
            raise self.refuse("the file states no field type", "FTYP", None, "FTYP 0 (angle)")
        if self.number(head, "FTYP", 0) != 0:
            names = {"1": "object height", "2": "paraxial image height", "3": "real image height"}
            raise self.refuse(
                "only field angles are read",
                "FTYP",
                names.get(kind[0], kind[0]),
                "0 (field angle in degrees)",
            )
        if self.number(head, "FTYP", 1) != 0:
            raise self.refuse("an object-space telecentric lens", "FTYP", " ".join(kind), "0")
        count = int(self.number(head, "FTYP", 2, 1))
        lines = int(self.number(head, "FTYP", 3, 1))
        at = [(self.number(head, "XFLN", i), self.number(head, "YFLN", i)) for i in range(count)]
        wavelengths = []
        for values in head.lines.get("WAVM", []):
            try:
                order, micrometres = int(values[0]), float(values[1])
            except (IndexError, ValueError) as error:
                raise self.refuse(
                    "a wavelength is not a number", "WAVM", " ".join(values), "WAVM i um weight"
                ) from error
            if order <= lines:
                wavelengths.append(micrometres * 1e3)
        if not wavelengths:
            raise self.refuse("the file states no wavelength", "WAVM", None, "WAVM i um weight")
        primary = int(self.number(head, "PWAV", 0, 1))
        if not 1 <= primary <= len(wavelengths):
            raise self.refuse(
                "the primary wavelength is not in the list",
                "PWAV",
                primary,
                f"1 to {len(wavelengths)}",
            )
        used |= {"FTYP", "XFLN", "YFLN", "WAVM", "PWAV"}
        return {
            "design_wavelengths_nm": tuple(wavelengths),
            "reference_nm": wavelengths[primary - 1],
            "max_field_deg": max((x * x + y * y) ** 0.5 for x, y in at),
        }

    def _aperture(self, used: set[str]) -> dict[str, object]:
        head = self.head
        if "OBNA" in head.lines:
            raise self.refuse(
                "an aperture given as numerical aperture in object space",
                "OBNA",
                " ".join(head.lines["OBNA"][0]),
                "FNUM, ENPD or FLOA",
            )
        for key, name in (("FNUM", "f_number"), ("ENPD", "entrance_pupil_diameter_mm")):
            if key in head.lines:
                used.add(key)
                return {name: self.number(head, key)}
        if "FLOA" in head.lines:
            used.add("FLOA")
            stop = self._stop()
            return {"stop_semi_diameter_mm": self.number(self.surfaces[stop], "DIAM")}
        raise self.refuse("the file states no aperture", "FNUM", None, "FNUM, ENPD or FLOA")

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
        settings = self.settings()
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
            in_air = "glass" not in row
            rows.append(row)
        lens = validated(settings | {"stop": stop, "surfaces": rows}, self.file)
        steps = [f"substituted {text}" for text in self.account.listed("substituted")]
        lens = lens.derived("; ".join(["read from a Zemax file", *steps]))
        lens._account = self.account
        return lens

    def _ends(self) -> None:
        """Refuse what the model has no place for in the object and image surfaces."""
        object_, image = self.surfaces[0], self.surfaces[-1]
        distance = (object_.first("DISZ") or ["none"])[0]
        if distance.upper() != "INFINITY":
            raise self.refuse(
                "a finite object distance is not modelled", "SURF 0 DISZ", distance, "INFINITY"
            )
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
                    block.lines["GLAS"][0][0],
                    "air",
                )
        if "DISZ" not in image.lines or self.number(image, "DISZ") != 0:
            raise self.refuse(
                "the last surface is not an image: the file is truncated",
                f"SURF {image.number} DISZ",
                (image.first("DISZ") or [None])[0],
                "0",
            )

    def _surface(self, block: _Block, *, is_stop: bool, in_air: bool) -> dict[str, object]:
        place = f"SURF {block.number}"
        kind = (block.first("TYPE") or ["none"])[0]
        if kind not in ("STANDARD", "EVENASPH"):
            raise self.refuse(
                f"surface type {kind} is not modelled", f"{place} TYPE", kind, "STANDARD, EVENASPH"
            )
        for key in ("CURV", "DISZ"):
            if key not in block.lines:
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
        dummy = in_air and "glass" not in row
        self._aperture_of(block, row, ignore=dummy)
        if is_stop and dummy:
            self.account.ignored(block.number, "DIAM: the system aperture sets the stop")
        known = {"TYPE", "CURV", "DISZ", "CONI", "PARM", "GLAS", "DIAM", "STOP", "CLAP", "COAT"}
        if "COAT" in block.lines:
            self.account.substituted(block.number, "COAT: coating by uncoated Fresnel losses")
        for key in block.lines:
            if key in _HARMLESS_SURFACE_KEYS:
                self.account.ignored(block.number, key)
            elif key not in known:
                raise self.refuse(
                    f"surface key {key} is not understood and may change the optics",
                    f"{place} {key}",
                    " ".join(block.lines[key][0]),
                    ", ".join(sorted(known)),
                )
        self.account.read(block.number, ", ".join(k for k in block.lines if k in known))
        return row

    def _polynomial(self, block: _Block, kind: str, row: dict[str, object]) -> None:
        """PARM i of an even asphere is the coefficient of r^(2i)."""
        for values in block.lines.get("PARM", []):
            try:
                order, coefficient = int(values[0]), float(values[1])
            except (IndexError, ValueError) as error:
                raise self.refuse(
                    "a parameter is not a number",
                    f"SURF {block.number} PARM",
                    " ".join(values),
                    "PARM i value",
                ) from error
            if coefficient == 0:
                continue
            if kind != "EVENASPH" or not 1 <= order <= 8:
                raise self.refuse(
                    "a surface parameter is not understood",
                    f"SURF {block.number} PARM {order}",
                    coefficient,
                    "PARM 1 to 8 of an EVENASPH",
                )
            row.setdefault("asphere", {})[f"a{ASPHERE_POWERS[order - 1]}"] = coefficient

    def _glass(self, block: _Block, row: dict[str, object]) -> None:
        """GLAS name solve pickup nd Vd dPgF ...: a catalogue glass, or the model glass."""
        values = block.first("GLAS")
        if values is None:
            return
        place = f"SURF {block.number} GLAS"
        name = values[0] if values else ""
        if name.upper() == "MIRROR":
            raise self.refuse("mirrors are not modelled", place, name, "a refracting glass")
        if name != "___BLANK":
            if self.head.first("GCAT") and not any(c in BOOKS for c in self.catalogues):
                raise self.refuse(
                    f"none of the file's glass catalogues is available, so glass {name!r} of "
                    f"surface {block.number} is unknown",
                    "GCAT",
                    " ".join(self.catalogues),
                    ", ".join(BOOKS),
                )
            row["glass"] = name
            return
        row["glass"] = "model"
        row["nd"], row["vd"] = self.number(block, "GLAS", 3), self.number(block, "GLAS", 4)
        self.account.substituted(
            block.number,
            f"GLAS: model glass nd {row['nd']:g}, Vd {row['vd']:g} by Cauchy's two-term law",
        )

    def _aperture_of(self, block: _Block, row: dict[str, object], *, ignore: bool) -> None:
        """DIAM is the semi-diameter; CLAP a ring, of which only the outer edge is modelled."""
        place = f"SURF {block.number}"
        sizes = [] if ignore else [self.number(block, "DIAM")]
        if "CLAP" in block.lines:
            if self.number(block, "CLAP", 0) != 0:
                raise self.refuse(
                    "a central obscuration is not modelled",
                    f"{place} CLAP",
                    " ".join(block.lines["CLAP"][0]),
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
        Its name, for error texts.

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
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    elif b"\x00" in content[:64]:
        encoding = "utf-16-le"
    elif content[:3] == b"\xef\xbb\xbf":
        encoding = "utf-8-sig"
    else:
        encoding = "cp1252"
    reader = _Reader(content.decode(encoding, errors="replace"), file)
    return reader.prescription()
