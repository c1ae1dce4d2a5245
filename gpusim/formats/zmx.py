"""Reader of Zemax sequential lens files (.zmx, UTF-16 or ANSI).

A file is lines of ``KEY value ...``; indented keys belong to the last ``SURF``. What would change
the optics and is not understood is refused by name; what is left out or read in another sense is
listed in the import log. Nothing in a file is executed. The keywords are those of the files that
OpticStudio writes; their meaning is given in its manual under the editors that they come from.
"""

from __future__ import annotations

from pathlib import Path

from gpusim.formats.imported import finished
from gpusim.formats.text import decoded
from gpusim.formats.zmx_lines import ZmxFile
from gpusim.formats.zmx_surfaces import surface_of
from gpusim.formats.zmx_system import system_of
from gpusim.lens.prescription import Prescription


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
        With ``focus: as-given``: the image plane is where the file has it; its ``import_log`` says
        what became of each line.

    Raises
    ------
    UserError
        Where the file is no lens, is truncated, or holds what is not modelled.
    """
    return _prescription(ZmxFile(decoded(content), file))


def _prescription(zmx: ZmxFile) -> Prescription:
    """Return the whole file as a prescription."""
    if len(zmx.surfaces) < 3:
        raise zmx.refuse(
            "not a lens file, or a truncated one: it needs an object, a lens and an image",
            "SURF",
            f"{len(zmx.surfaces)} surfaces",
            "3 or more",
        )
    system = system_of(zmx)
    stop = zmx.stop()
    if not 1 <= stop <= len(zmx.surfaces) - 2:
        raise zmx.refuse(
            "the stop is the object or the image", "STOP", stop, "a surface of the lens"
        )
    _ends(zmx)
    rows = []
    in_air = True
    for block in zmx.surfaces[1:-1]:
        row = surface_of(zmx, system.glasses, block, is_stop=block.number == stop, in_air=in_air)
        if system.fields.beams and not system.beams_known and "semi_diameter" not in row:
            if not in_air or "glass" in row:
                raise zmx.refuse(
                    "vignetting factors off the meridional plane or of image heights need the "
                    "clear aperture of every surface",
                    f"SURF {block.number} DIAM",
                    None,
                    "a semi-diameter",
                )
        in_air = "glass" not in row
        rows.append(row)
    return finished(
        system.data | {"stop": stop, "surfaces": rows},
        system.fields,
        zmx.import_log,
        zmx.file,
        "Zemax",
        working_f_number=system.working,
    )


def _ends(zmx: ZmxFile) -> None:
    """Refuse what the model has no place for in the object and image surfaces."""
    object_, image = zmx.surfaces[0], zmx.surfaces[-1]
    text = (object_.first("DISZ") or ["none"])[0]
    if zmx.distance() is not None:
        zmx.import_log.read("file", f"SURF 0 DISZ {text}: object distance")
    elif text.upper() != "INFINITY":
        zmx.import_log.substituted("file", f"SURF 0 DISZ {text}: by infinity")
    for block in (object_, image):
        place = f"SURF {block.number}"
        if zmx.number(block, "CURV"):
            raise zmx.refuse(
                "a curved object or image is not modelled",
                f"{place} CURV",
                zmx.number(block, "CURV"),
                "0",
            )
        if "GLAS" in block.lines:
            raise zmx.refuse(
                "the object or image lies in glass, or the file is truncated",
                f"{place} GLAS",
                " ".join(block.lines["GLAS"][0]),
                "air",
            )
    if "DISZ" not in image.lines or zmx.number(image, "DISZ") != 0:
        raise zmx.refuse(
            "the last surface is not an image: the file is truncated",
            f"SURF {image.number} DISZ",
            " ".join(image.first("DISZ") or []) or None,
            "0",
        )
