"""The Kodak report: its numbers, figures and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.validate import kodak_figures as figures
from gpusim.validate.edges import AXES, WINDOW_PX
from gpusim.validate.kodak import BANDS, EFL_MM, REFERENCE, TOLERANCE, Edges
from gpusim.validate.kodak_table import TABLE_1, Row
from gpusim.validate.report import Report, Rows, Section

TITLE = "Validation: Kodak's simulator with a lens model of PSFs"
PAPER = (
    "R. Short, D. Williams and A. E. W. Jones, Image capture simulation using an accurate and "
    "realistic lens model, Proc. SPIE 3650, 138-147 (1999)"
)
CAPTIONS = {
    "positions": "Positions of edges against prediction, as table 1 of the paper lists them.",
    "edges": "An edge near the right-hand side in three bands, as figure 9 of the paper.",
    "mtf": "MTF at the centre, in mid-field and at the edge, as figures 10 to 12 of the paper.",
}
EXPLAINED = (
    "Errors are measured less predicted, pixels; of bands against green the predicted distance and "
    "the error of the measured one, ours and then the paper's of its own lens."
)
COLUMNS = ("edge", "x, y [px]", "R", "G", "B", "R to G", "B to G", "R to G", "B to G")


def numbers(edges: Edges) -> dict[str, Any]:
    """Return every number of the edges."""
    rows = []
    for (band, axis, number), one in edges.found.items():
        predicted, measured = edges.apart(band, axis, number)
        rows.append({
            "edge": number, "axis": axis, "band": band,
            "measured_px": one.measured_px, "predicted_px": one.predicted_px,
            "error_px": one.error_px, "to_green_predicted_px": predicted,
            "to_green_measured_px": measured, "mtf_error": one.mtf_error,
            "measured_mtf": one.measured_mtf.tolist(),
            "predicted_mtf": one.predicted_mtf.tolist(),
        })  # fmt: skip
    return {
        "efl_mm": EFL_MM,
        "window_px": WINDOW_PX,
        "tolerance": TOLERANCE,
        "paper_table_1": [_paper(place) for place in TABLE_1],
        "frequencies_cy_px": FREQUENCIES_CY_PX.tolist(),
        "edges": rows,
        "certificates": {
            name: {
                "total_rms": one.certificate.total_rms,
                "total_worst": one.certificate.total_worst,
                "met": one.certificate.met,
                "probes": one.certificate.probes,
            }
            for name, one in edges.captures.items()
        },
    }


def _paper(place: Row) -> dict[str, Any]:
    """Return a row of the paper's table; None where it cannot be read."""

    def known(values: Sequence[float]) -> list[float | None]:
        return [None if math.isnan(value) else value for value in values]

    lists = {name: known(getattr(place, name)) for name in ("position", "red", "blue")}
    return {"edge": place.number, "x": place.x, "y": place.y} | lists


def table(edges: Edges, axis: str) -> list[list[str]]:
    """Return rows of table 1 with our errors, and the paper's in the last two columns."""
    rows = []
    for place in TABLE_1:
        number = place.number
        own = [edges.found[band, axis, number].error_px for band in BANDS]
        apart = []
        for band in BANDS.replace(REFERENCE, ""):
            predicted, measured = edges.apart(band, axis, number)
            apart.append(f"{predicted:+.3f} {measured - predicted:+.4f}")
        theirs = [f"{one[0]:+.3f} {one[2]:+.3f}" for one in (place.red, place.blue)]
        where = f"{place.x:g}, {place.y:g}"
        rows.append([str(number), where, *(f"{e:+.4f}" for e in own), *apart, *theirs])
    return rows


def report(edges: Edges) -> Report:
    """Return the report of all edges."""
    drawn = {
        "positions": figures.draw_positions(edges),
        "edges": figures.draw_edges(edges),
        "mtf": figures.draw_mtfs(edges),
    }
    sections = [Section(CAPTIONS[name], name=name, figure=figure) for name, figure in drawn.items()]
    groups = (2, ""), (3, "Error, ours"), (2, "Predicted, error"), (2, "Paper")
    for axis in AXES:
        rows = Rows(COLUMNS, table(edges, axis), groups)
        sections.append(Section(f"Near-{axis} edges", EXPLAINED, rows=rows))
    who = edges.tracer, edges.independent
    return Report(
        "kodak", TITLE, PAPER, _judge(edges), edges.bars(), sections, numbers(edges), *who
    )


def _judge(edges: Edges) -> str:
    who = f"Predictions are by {edges.tracer}"
    if not edges.independent:
        who += ", which is NOT independent (optiland is: pip install .[judges])"
    return (
        f"{who}: rays, wavefronts and vignetting of a stand-in lens of {EFL_MM} mm and NA 0.22 "
        "with undercorrected lateral colour, for the paper publishes no prescription. Its indices "
        "of refraction are ours. The renders are planned for the tolerance, and certificates "
        "say what they keep. An edge's position is "
        f"the centroid of its line spread within {WINDOW_PX:g} px on either side, on both sides of "
        "the comparison; pictures are taken over the predicted light of an even scene."
    )
