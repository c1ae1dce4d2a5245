"""The glasses of a Zemax lens file: its catalogues, and what a surface says of its glass."""

from __future__ import annotations

from gpusim.formats.agf import read_agf
from gpusim.formats.imported import ON_LINE
from gpusim.formats.zmx_lines import Block, ZmxFile
from gpusim.lens.glass import BOOKS, catalogue

# What OpticStudio writes as nd and Vd beside a glass of which it recorded none.
_NO_INDEX = {(0.0, 0.0), (1.5, 40.0)}


class Glasses:
    """The catalogues of GCAT: a file of its name beside the lens, or one offline.

    Attributes
    ----------
    wanted : list of str
        Those that the file names.
    catalogues : list of str
        Those of them that are there: names of files, or of the offline database.
    """

    def __init__(self, zmx: ZmxFile) -> None:
        self.zmx = zmx
        self.catalogues: list[str] = []
        self.wanted = [name.upper() for name in zmx.head.first("GCAT") or []]
        for name in self.wanted:
            if beside := zmx.catalogue_beside(name):
                self.catalogues.append(beside)
                zmx.import_log.read("file", f"GCAT {name}: from {beside} beside the lens")
            elif name in BOOKS:
                self.catalogues.append(name)
            else:
                zmx.import_log.ignored("file", f"GCAT {name}: no such catalogue offline")

    def has(self, name: str) -> bool:
        """Whether a catalogue of the file, or any where it names none, holds the glass."""
        return any(
            name.upper()
            in (catalogue(entry) if entry in BOOKS else read_agf(self.zmx.file.parent / entry))
            for entry in self.catalogues or ([] if self.wanted else BOOKS)
        )

    def put(self, block: Block, row: dict[str, object]) -> None:
        """GLAS name mode pickup nd Vd dPgF ...: a catalogue glass, or the model glass."""
        zmx, values = self.zmx, block.first("GLAS")
        if values is None:
            return
        place = f"SURF {block.number} GLAS"
        name = values[0] if values else ""
        if name.upper() == "MIRROR":
            raise zmx.refuse("mirrors are not modelled", place, name, "a refracting glass")
        if not name:
            raise zmx.refuse("a glass has no name", place, None, "GLAS name ...")
        nd, vd = zmx.number(block, "GLAS", 3), zmx.number(block, "GLAS", 4)
        stated = (nd, vd) not in _NO_INDEX and nd > 1
        if name != "___BLANK" and (not stated or self.has(name)):
            if self.wanted and not self.catalogues:
                raise zmx.refuse(
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
        if departs := zmx.number(block, "GLAS", 5):
            row["dpgf"] = departs
            law = f"by a model glass {departs:+g} off the normal line in P_g,F"
        if vd == 0:  # OpticStudio's model glass without dispersion
            del row["vd"]
            row.pop("dpgf", None)
            row["glass"], law = "constant", "by one index at every wavelength"
        what = "model glass" if name == "___BLANK" else f"{name}, which no catalogue has here,"
        zmx.import_log.substituted(block.number, f"GLAS: {what} nd {nd:g}, Vd {vd:g} {law}")
