"""Glass catalogues of Zemax (.agf, UTF-16 or ANSI), given as files beside a lens.

A file is lines of two letters and values; ``NM name formula number nd Vd ...`` opens a glass,
``CD`` holds the coefficients of its dispersion formula and ``LD`` the ends of its range in um;
``IT`` lines a wavelength in um, the internal transmission there and its thickness in mm. The other
lines (price, density, thermal data) do not change what is modelled.
"""

from __future__ import annotations

import difflib
import math
from functools import partial
from pathlib import Path

from pydantic import ValidationError

from gpusim.config.text import read_bytes
from gpusim.errors import UserError
from gpusim.formats.text import decoded, finite
from gpusim.lens.dispersion import D_LINE_NM, FORMULAS, formula_index
from gpusim.lens.glass import BOOKS, catalogue
from gpusim.lens.prescription import Prescription
from gpusim.lens.surface import Dispersion

# A formula must give the nd that its catalogue prints. The makers' do so to 5e-7; a catalogue that
# lost its higher coefficients, of which one is in circulation, misses by 1e-4 to 7e-3.
ND_TOLERANCE = 1e-4

Catalogue = tuple[Path, dict[str, dict[str, list[str]]]]  # a file, and what `read_agf` returns


def read_agf(path: Path) -> dict[str, dict[str, list[str]]]:
    """Return the glasses of a catalogue: upper-case name to its lines, key to values.

    Raises
    ------
    UserError
        Where the file cannot be read or holds no glass.
    """
    text = decoded(read_bytes(path, "the glass catalogue", allowed="a readable .agf file"))
    glasses: dict[str, dict[str, list[str]]] = {}
    lines: dict[str, list[str]] = {}  # those before the first glass belong to none
    for line in text.splitlines():
        key, *values = line.split() or [""]
        if key == "NM" and values:
            lines = glasses.setdefault(values[0].upper(), {})
        if key == "IT":
            lines.setdefault("IT", []).extend(values[:3])
            continue
        lines.setdefault(key, values)  # of a name that comes twice, the first counts
    if not glasses:
        raise UserError(
            "not a glass catalogue: it has no glass", file=path, allowed="NM, CD and LD lines"
        )
    return glasses


def dispersion_of(name: str, lines: dict[str, list[str]], path: Path) -> Dispersion:
    """Return the dispersion of one glass of a catalogue.

    Raises
    ------
    UserError
        Where a line is missing or incomplete, the formula is unknown, or its index is not that
        which the catalogue states.
    """
    numbers = partial(_numbers, lines, name, path)
    formula, _, nd = numbers("NM", 3)
    if formula not in FORMULAS:
        raise UserError(
            f"the dispersion formula of glass {name} is not known",
            file=path,
            field=f"{name} NM",
            value=f"{formula:g}",
            allowed=", ".join(f"{number} {title}" for number, title in FORMULAS.items()),
        )
    low, high = numbers("LD", 2)[:2]
    try:
        dispersion = Dispersion(
            formula=int(formula),
            coefficients=tuple(numbers("CD", 1)),
            range_um=(low, high),
            absorption=_absorption(numbers("IT", 0)),
        )
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"the dispersion of glass {name} is wrong",
            file=path,
            field=f"{name} {'LD' if 'range_um' in first['loc'] else 'CD'}",
            allowed=first["msg"].removeprefix("Value error, "),
        ) from error
    # Catalogues state 1 (or 0) as the nd of a material that is opaque at the d line.
    if nd > 1 and low * 1e3 <= D_LINE_NM <= high * 1e3:
        found = float(formula_index(dispersion.formula, dispersion.coefficients, D_LINE_NM))
        if abs(found - nd) > ND_TOLERANCE:
            raise UserError(
                f"the coefficients of glass {name} do not give the nd that the catalogue states",
                file=path,
                field=f"{name} CD",
                value=f"nd {found:.6f}",
                allowed=f"{nd:.6f}; are coefficients missing?",
            )
    return dispersion


def _numbers(
    lines: dict[str, list[str]], name: str, path: Path, key: str, count: int
) -> list[float]:
    """Return the numbers of a line of a glass: all of them, and at least so many."""
    words = lines.get(key, [])
    words = words[1:4] if key == "NM" else words
    try:
        found = [finite(word) for word in words]
    except ValueError:
        found = []
    if len(found) < count:
        raise UserError(
            f"glass {name} of the catalogue is incomplete",
            file=path,
            field=f"{name} {key}",
            value=" ".join(words) or None,
            allowed=f"at least {count} numbers",
        )
    return found


def _absorption(values: list[float]) -> tuple[tuple[float, float], ...] | None:
    """Return rows of nm and absorption per mm from triples of um, transmission and mm.

    -ln(T) / d; catalogues state 0 where the glass is opaque, and 1, or no thickness, for nothing.
    """
    rows = {}
    for um, passed, thick_mm in zip(values[::3], values[1::3], values[2::3], strict=False):
        if thick_mm > 0 and um > 0 and 0 <= passed <= 1:
            rows[1e3 * um] = max(-math.log(max(passed, 1e-6)) / thick_mm, 0.0)
    return tuple(sorted(rows.items())) or None


def with_file_catalogues(lens: Prescription) -> Prescription:
    """Return the lens with the dispersion of each glass that comes from a catalogue file.

    ``glass_catalogues`` names files (``*.agf``, from the lens file's folder) and the catalogues of
    the offline database, in the order in which a bare name is looked up.

    Raises
    ------
    UserError
        Where a catalogue is unknown or wrong, or holds no such glass.
    """
    files = _files(lens)
    if not files:
        return lens
    surfaces = list(lens.surfaces)
    for i, surface in enumerate(surfaces):
        if surface.glass in (None, "model", "constant") or surface.dispersion is not None:
            continue
        name, places = surface.glass.upper(), lens.glass_catalogues
        prefix, slash, bare = name.partition("/")
        if slash:
            places = [entry for entry in files if Path(entry).stem.upper() == prefix] or [prefix]
            name = bare
        place = next((p for p in places if p in files and name in files[p][1]), None)
        built_in = next((p for p in places if p in BOOKS and name in catalogue(p)), None)
        if place is None and built_in is None:
            raise UserError(
                f"glass {surface.glass!r} of surface {i + 1} is not in {', '.join(places)}",
                file=lens.file,
                field=f"surfaces.{i + 1}.glass",
                value=surface.glass,
                allowed="perhaps " + ", ".join(_near(name, files) or ["none"]),
            )
        if place is None or (built_in is not None and places.index(built_in) < places.index(place)):
            continue
        path, glasses = files[place]
        found = dispersion_of(name, glasses[name], path)
        surfaces[i] = surface.model_copy(update={"dispersion": found})
        lens.import_log.read(
            i + 1,
            f"glass {name} of {path.name}: formula {found.formula}, {FORMULAS[found.formula]}",
        )
    return lens.model_copy(update={"surfaces": tuple(surfaces)})


def _files(lens: Prescription) -> dict[str, Catalogue]:
    """Return the catalogue files that a lens names."""
    files = {}
    for entry in lens.glass_catalogues:
        if entry.lower().endswith(".agf"):
            path = (lens.file.parent if lens.file else Path()) / entry
            files[entry] = (path, read_agf(path))
        elif entry not in BOOKS:
            raise UserError(
                "no such glass catalogue",
                file=lens.file,
                field="glass_catalogues",
                value=entry,
                allowed=f"{', '.join(BOOKS)}, or the name of an .agf file",
            )
    return files


def _near(name: str, files: dict[str, Catalogue]) -> list[str]:
    """Return glasses with names like this one, each with its catalogue."""
    everything = {g: f"{book}/{page}" for book in BOOKS for g, page in catalogue(book).items()}
    for entry, (_, glasses) in files.items():
        everything |= {g: f"{Path(entry).stem.upper()}/{g}" for g in glasses}
    return [everything[n] for n in difflib.get_close_matches(name, everything, n=5, cutoff=0.5)]
