"""Stiff and extreme cases: each with what is expected, what came out, and a verdict.

Each module holds the cases of one part as a table of its own, ``CASES``; :data:`CASES` is all of
them. `made` has lenses and sensors of which everything is known, `table` what a verdict is.
"""

from __future__ import annotations

from collections.abc import Callable

from gpusim.stress import (
    angle,
    ccd,
    data_sheet,
    imaging,
    levels,
    noise,
    pixel,
    readout,
    sensor_files,
)
from gpusim.stress.table import Case, Row, judged

# In the order that light takes. A new part of the chain brings a module with its own table and a
# line here.
CASES: tuple[Case, ...] = (
    *imaging.CASES,
    *angle.CASES,
    *pixel.CASES,
    *noise.CASES,
    *ccd.CASES,
    *levels.CASES,
    *readout.CASES,
    *data_sheet.CASES,
    *sensor_files.CASES,
)


def run(
    names: tuple[str, ...] = (), progress: Callable[[str, int, int], None] | None = None
) -> list[Row]:
    """Run the cases, or those whose names are given; a defect in one does not stop the others."""
    chosen = [case for case in CASES if not names or case[0] in names]
    rows = []
    for done, (name, case, refusal) in enumerate(chosen):
        if progress is not None:
            progress("stress", done, len(chosen))
        rows.append(judged(name, case, refusal))
    if progress is not None:
        progress("stress", len(chosen), len(chosen))
    return rows
