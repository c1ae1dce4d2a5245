"""Reader of the lens files of pbrt's realistic camera (.dat).

Rows from the front of the lens to the film: radius of curvature, thickness, index behind the
surface (``eta``) and aperture diameter, in mm (Pharr, Jakob & Humphreys, Physically Based
Rendering, on the realistic camera). A radius of 0 is the aperture stop; 0 for its index is air.
``#`` starts a comment; a row of one number, before the others, is a nominal focal length. The last
thickness is a placeholder: the renderer moves the film to the focus. One index for each glass: such
a lens has no dispersion, and no colour errors.
"""

from __future__ import annotations

from pathlib import Path

from gpusim.errors import UserError
from gpusim.formats.imported import Fields, finished
from gpusim.formats.text import decoded, finite
from gpusim.lens.dispersion import D_LINE_NM
from gpusim.lens.import_log import ImportLog
from gpusim.lens.prescription import Prescription

Row = tuple[float, float, float, float]  # radius, thickness, index, aperture diameter


def parse_pbrt(content: bytes, file: Path) -> Prescription:
    """Read a lens file of pbrt.

    Parameters
    ----------
    content : bytes
        The file.
    file : Path
        Its name, for error texts.

    Returns
    -------
    Prescription
        With ``focus: best``; every glass is ``constant``.

    Raises
    ------
    UserError
        Where a row is not four numbers, the stop is missing or the rows are no lens.
    """
    import_log = ImportLog()
    rows, comments = _rows(decoded(content), file, import_log)
    stop = _stop(rows, file)
    surfaces = []
    before = 1.0  # index before the row
    for number, row in enumerate(rows, start=1):
        surface, eta = _surface(number, row, before, number == stop, file)
        if eta > 1:
            import_log.substituted(number, f"glass of index {eta:g}: the same at every wavelength")
        import_log.read(number, "radius, thickness, index, aperture diameter")
        surfaces.append(surface)
        before = eta
    del surfaces[-1]["thickness"]
    import_log.substituted("file", f"last thickness {rows[-1][1]:g}: by the best focus")
    import_log.substituted("file", "no dispersion stated: none, so the lens has no colour errors")
    data = {
        "title": comments[0] if comments else file.stem,
        "patent": None,
        "source": f"pbrt lens file {file.name}",
        "notes": "; ".join(comments[1:]),
        "units": "mm",
        "focus": "best",
        "reference_nm": D_LINE_NM,
        "stop_semi_diameter_mm": rows[stop - 1][3] / 2,
        "stop": stop,
        "surfaces": surfaces,
    }
    return finished(data, Fields("not stated"), import_log, file, "pbrt")


def _rows(text: str, file: Path, import_log: ImportLog) -> tuple[list[Row], list[str]]:
    """Return the rows of four numbers, and the comments."""
    rows, comments = [], []
    for number, line in enumerate(text.splitlines(), start=1):
        words, _, comment = line.partition("#")
        if comment.strip():
            comments.append(comment.strip())
        if not words.strip():
            continue
        try:
            values = [finite(word) for word in words.split()]
        except ValueError:
            values = []
        if len(values) == 1 and not rows:
            import_log.ignored(
                "file", f"nominal focal length {values[0]:g}: it follows from the rows"
            )
            continue
        if len(values) != 4:
            raise UserError(
                "not a row of a pbrt lens file",
                file=file,
                field=f"line {number}",
                value=words.strip()[:80],
                allowed="radius, thickness, index, aperture diameter",
            )
        rows.append(tuple(values))
    return rows, comments


def _stop(rows: list[Row], file: Path) -> int:
    """Return the number of the row that is the stop, from 1."""
    stops = [i for i, (radius, *_) in enumerate(rows, start=1) if radius == 0]
    if len(rows) < 3:
        raise UserError(
            "not a pbrt lens file, or a truncated one: it needs two surfaces and a stop",
            file=file,
            field="rows",
            value=len(rows),
            allowed="3 or more",
        )
    if len(stops) != 1:
        raise UserError(
            "the file has no stop" if not stops else "the file has several stops",
            file=file,
            field="radius",
            value=stops or None,
            allowed="one row with a radius of 0",
        )
    return stops[0]


def _surface(
    number: int, row: Row, before: float, is_stop: bool, file: Path
) -> tuple[dict[str, object], float]:
    """Return the fields of a row's surface, and the index behind it, of that before it."""
    radius, thickness, eta, diameter = row
    if is_stop and eta == 0:
        eta = 1.0
    if (eta != before) if is_stop else eta < 1:
        raise UserError(
            f"the index of row {number} is wrong",
            file=file,
            field=f"row {number}, index",
            value=f"{eta:g}",
            allowed=f"0, or {before:g} as before the stop" if is_stop else "1 (air) or more",
        )
    if diameter <= 0:
        raise UserError(
            f"the aperture of row {number} is wrong",
            file=file,
            field=f"row {number}, aperture diameter",
            value=f"{diameter:g}",
            allowed="> 0 mm",
        )
    surface: dict[str, object] = {"thickness": thickness}
    if not (is_stop and eta == 1):  # a diaphragm in air is its own aperture
        surface["semi_diameter"] = diameter / 2
    surface |= {"curvature": 0.0} if is_stop else {"radius": radius}
    if eta > 1:
        surface |= {"glass": "constant", "nd": eta}
    return surface, eta
