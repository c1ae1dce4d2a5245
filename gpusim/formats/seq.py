"""Reader of CODE V sequential lens files (.seq).

A file is commands with values: separated by ``;`` or lines, continued with ``&``, with comments
after ``!``; names are recognised by their first three letters in either case. ``SO``, ``S`` and
``SI`` open the object, a surface and the image; the commands after one belong to it, or to the
surface that they name as ``S3``. What would change the optics and is not understood is refused by
name; what is left out or read in another sense is listed in the import log. Nothing is executed.
"""

from __future__ import annotations

from pathlib import Path

from gpusim.formats.imported import INFINITE, finished
from gpusim.formats.seq_commands import READ_OF_SYSTEM, SeqFile
from gpusim.formats.seq_surfaces import surface_of
from gpusim.formats.seq_system import aperture_of, fields_of, wavelengths_of
from gpusim.formats.text import decoded
from gpusim.lens.prescription import Prescription

_UNITS_MM = {"M": 1.0, "C": 10.0, "I": 25.4}


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
        In mm, whatever the file's unit; its ``import_log`` says what became of each command.

    Raises
    ------
    UserError
        Where the file is no lens, is truncated, or holds what is not modelled.
    """
    return _prescription(SeqFile(decoded(content), file))


def _prescription(seq: SeqFile) -> Prescription:
    """Return the whole file as a prescription."""
    if len(seq.rows) < 2 or seq.image is None:
        raise seq.refuse(
            "not a CODE V lens file, or a truncated one: it needs SO, S and SI",
            "SI" if seq.rows else "SO",
            f"{max(len(seq.rows) - 1, 0)} lens surfaces",
            "SO, one S or more, SI",
        )
    curvatures = seq.curvatures()
    unit_mm = _unit_mm(seq)
    _ends(seq)
    lens_rows = seq.rows[1:]
    if seq.stop is None or not 1 <= seq.stop <= len(lens_rows):
        raise seq.refuse(
            "the file has no stop" if seq.stop is None else "the stop is not in the lens",
            "STO",
            seq.stop,
            "STO at one surface of the lens",
        )
    wavelengths, reference = wavelengths_of(seq)
    fields = fields_of(seq)
    surfaces = [surface_of(seq, row, curvatures) for row in lens_rows]
    focus = _focus(seq, surfaces[-1])
    title = " ".join(seq.system.get("TIT", [])).strip("'\"")
    data = {
        "title": title or seq.file.stem,
        "patent": None,
        "source": f"CODE V file {seq.file.name}",
        "units": "mm",
        "glass_catalogues": tuple(seq.files),
        "focus": focus,
        "design_wavelengths_nm": wavelengths,
        "reference_nm": reference,
        "stop": seq.stop,
        "surfaces": surfaces,
        **aperture_of(seq),
    }
    if seq.near():
        data["object_distance_mm"] = seq.rows[0].thickness
    keys = [key for key in seq.system if key in READ_OF_SYSTEM]
    seq.import_log.read("file", ", ".join(keys))
    if seq.system_ignored:
        seq.import_log.ignored("file", ", ".join(dict.fromkeys(seq.system_ignored)))
    return finished(
        data,
        fields,
        seq.import_log,
        seq.file,
        "CODE V",
        unit_mm=unit_mm,
        working_f_number=True,
    )


def _unit_mm(seq: SeqFile) -> float:
    """Return the file's unit of length."""
    unit = (seq.system.get("DIM") or [""])[0].upper()[:1]
    if unit not in _UNITS_MM:
        raise seq.refuse(
            "the file does not state its unit of length",
            "DIM",
            " ".join(seq.system.get("DIM", [])) or None,
            "M (mm), C (cm) or I (inch)",
        )
    return _UNITS_MM[unit]


def _focus(seq: SeqFile, last: dict[str, object]) -> str:
    """Return how the lens is focused, and put the defocus into its last surface."""
    thickness, defocus = seq.rows[-1].thickness, seq.image.thickness
    if seq.solved and thickness == 0 and defocus == 0:
        del last["thickness"]
        return "paraxial"
    if defocus:
        last["thickness"] = thickness + defocus
        seq.import_log.read("file", f"SI {defocus:g}: defocus, added to the last thickness")
    return "as-given"


def _ends(seq: SeqFile) -> None:
    """Refuse what the model has no place for in the object and image surfaces."""
    object_, image = seq.rows[0], seq.image
    if not seq.near():
        seq.import_log.substituted("file", f"SO {object_.thickness:g}: object at infinity")
    elif object_.thickness > 0:
        seq.import_log.read("file", f"SO {object_.thickness:g}: object distance")
    else:
        raise seq.refuse(
            "the object does not lie before the lens",
            "SO",
            object_.thickness,
            f"> 0, from {INFINITE:g} on infinity",
        )
    for row, name in ((object_, "SO"), (image, "SI")):
        if row.shape or row.asphere or row.conic:
            raise seq.refuse("a curved object or image is not modelled", name, row.shape, "0")
        if row.glass and row.glass.upper() != "AIR":
            raise seq.refuse("the object or image lies in glass", name, row.glass, "air")
