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

    def refuse(problem: str, where: str, value: object, allowed: str) -> UserError:
        return UserError(problem, file=file, field=where, value=value, allowed=allowed)

    import_log = ImportLog()
    comments, rows = [], []
    for number, line in enumerate(decoded(content).splitlines(), start=1):
        text, _, comment = line.partition("#")
        if comment.strip():
            comments.append(comment.strip())
        if not text.strip():
            continue
        try:
            values = [finite(word) for word in text.split()]
        except ValueError:
            values = []
        if len(values) == 1 and not rows:
            import_log.ignored(
                "file", f"nominal focal length {values[0]:g}: it follows from the rows"
            )
            continue
        if len(values) != 4:
            raise refuse(
                "not a row of a pbrt lens file",
                f"line {number}",
                text.strip()[:80],
                "radius, thickness, index, aperture diameter",
            )
        rows.append(values)
    stops = [i for i, (radius, *_) in enumerate(rows, start=1) if radius == 0]
    if len(rows) < 3:
        raise refuse(
            "not a pbrt lens file, or a truncated one: it needs two surfaces and a stop",
            "rows",
            len(rows),
            "3 or more",
        )
    if len(stops) != 1:
        raise refuse(
            "the file has no stop" if not stops else "the file has several stops",
            "radius",
            stops or None,
            "one row with a radius of 0",
        )
    stop = stops[0]
    surfaces = []
    before = 1.0  # index before the row
    for number, (radius, thickness, eta, diameter) in enumerate(rows, start=1):
        if number == stop and eta == 0:
            eta = 1.0
        if (eta != before) if number == stop else eta < 1:
            raise refuse(
                f"the index of row {number} is wrong",
                f"row {number}, index",
                f"{eta:g}",
                f"0, or {before:g} as before the stop" if number == stop else "1 (air) or more",
            )
        if diameter <= 0:
            raise refuse(
                f"the aperture of row {number} is wrong",
                f"row {number}, aperture diameter",
                f"{diameter:g}",
                "> 0 mm",
            )
        row = {"thickness": thickness, "semi_diameter": diameter / 2}
        row |= {"curvature": 0.0} if number == stop else {"radius": radius}
        if eta > 1:
            row |= {"glass": "constant", "nd": eta}
            import_log.substituted(number, f"glass of index {eta:g}: the same at every wavelength")
        if number == stop and eta == 1:  # a diaphragm in air is its own aperture
            del row["semi_diameter"]
        import_log.read(number, "radius, thickness, index, aperture diameter")
        surfaces.append(row)
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
