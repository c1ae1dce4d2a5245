"""The surfaces of a CODE V lens file as a prescription has them: shape, glass, clear aperture."""

from __future__ import annotations

import re

from gpusim.formats.imported import ON_LINE
from gpusim.formats.seq_commands import Row, SeqFile
from gpusim.lens.glass import BOOKS, catalogue

_CODE = re.compile(r"(\d{6})$|(\d{3,7})\.(\d{3,7})$")


def surface_of(seq: SeqFile, row: Row, curvatures: bool) -> dict[str, object]:
    """Return a surface as the fields of the prescription."""
    where = f"S{row.number}"
    result: dict[str, object] = {"thickness": row.thickness, "conic": row.conic}
    if curvatures or row.shape == 0:  # a radius of 0 is a plane
        result["curvature"] = row.shape
    else:
        result["radius"] = row.shape
    terms = {key: value for key, value in row.asphere.items() if value}
    if terms and not row.is_asphere:
        raise seq.refuse(
            "asphere coefficients at a surface that is no asphere", where, None, "ASP first"
        )
    if terms:
        result["asphere"] = terms
    if row.clear is not None:
        result["semi_diameter"] = row.clear
    if row.glass and row.glass.upper() != "AIR":
        result |= _glass(seq, row, where)
    seq.import_log.read(row.number, ", ".join(dict.fromkeys(row.keys)))
    if row.ignored:
        seq.import_log.ignored(row.number, ", ".join(dict.fromkeys(row.ignored)))
    return result


def _glass(seq: SeqFile, row: Row, where: str) -> dict[str, object]:
    """``NAME_CATALOGUE`` without hyphens, a six-digit code, or a fictitious nnnnnn.vvvvvv."""
    name = row.glass.upper()
    if name in seq.private or row.quoted:
        raise seq.refuse(
            "glasses of a private catalogue (PRV) are not read", where, row.glass,
            "a catalogue glass, or nnnnnn.vvvvvv",
        )  # fmt: skip
    code = _CODE.match(name)
    if code:
        nd_digits, vd_digits = (name[:3], name[3:]) if code[1] else (code[2], code[3])
        nd = 1 + int(nd_digits) / 10 ** len(nd_digits)
        vd = int(vd_digits) / 10 ** (len(vd_digits) - 2)
        seq.import_log.substituted(row.number, f"glass {row.glass}: nd {nd:g}, Vd {vd:g} {ON_LINE}")
        return {"glass": "model", "nd": nd, "vd": vd}
    bare, underscore, book = name.rpartition("_")
    if not underscore:
        return {"glass": row.glass}
    if beside := seq.catalogue_beside(book):
        seq.files[beside] = None
        return {"glass": f"{book}/{bare}"}
    if book not in BOOKS:
        raise seq.refuse(
            f"surface {row.number} names an unknown glass catalogue", where, row.glass,
            f"{', '.join(BOOKS)}, or an .agf file of that name beside the lens",
        )  # fmt: skip
    # CODE V leaves the hyphens out: NBK7 is N-BK7.
    pages = [page for page in catalogue(book) if page.replace("-", "") == bare.replace("-", "")]
    return {"glass": f"{book}/{pages[0] if len(pages) == 1 else bare}"}
