"""The Kodak report: its numbers, and the same as a page and as Markdown."""

from __future__ import annotations

import base64
import dataclasses
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.report.page import document
from gpusim.validate.bars import Bar
from gpusim.validate.edges import AXES, WINDOW_PX
from gpusim.validate.kodak import BANDS, EFL_MM, REFERENCE, TOLERANCE, Edges
from gpusim.validate.kodak_table import TABLE_1, Place

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
COLUMNS = ("edge", "x, y [px]", "R", "G", "B", "R to G", "B to G", "R to G", "B to G")


def numbers(edges: Edges, bars: Sequence[Bar]) -> dict[str, Any]:
    """Return every number of the report."""
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
        "paper": PAPER,
        "tracer": edges.tracer,
        "independent": edges.independent,
        "efl_mm": EFL_MM,
        "window_px": WINDOW_PX,
        "tolerance": TOLERANCE,
        "bars": [dataclasses.asdict(bar) | {"held": bar.held} for bar in bars],
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


def _paper(place: Place) -> dict[str, Any]:
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


def html(edges: Edges, bars: Sequence[Bar], pictures: Mapping[str, bytes]) -> str:
    """Return the page as HTML that needs no other file; ``pictures`` are PNG files by name."""
    sections = [f"<p>{escape(_judge(edges))}</p>", _bars(bars)]
    for name, picture in pictures.items():
        data = base64.b64encode(picture).decode()
        sections.append(
            f'<h2>{escape(CAPTIONS[name])}</h2><figure><img class="sheet" '
            f'src="data:image/png;base64,{data}" alt="{escape(CAPTIONS[name])}"></figure>'
        )
    for axis in AXES:
        sections.append(
            f"<h2>Near-{axis} edges</h2><p>{escape(_explained())}</p>{_rows(edges, axis)}"
        )
    return document(escape(TITLE), escape(PAPER), *sections)


def _bars(bars: Sequence[Bar]) -> str:
    verdicts = {True: '<td class="good">held</td>', False: '<td class="bad">NOT HELD</td>'}
    body = "".join(
        f'<tr><td>{escape(bar.name)}</td><td class="number">{bar.value:.4g}</td>'
        f'<td class="number">{bar.bound:g}</td><td>{escape(bar.unit)}</td>{verdicts[bar.held]}</tr>'
        for bar in bars
    )
    head = '<th>What</th><th class="number">Worst</th><th class="number">Bar</th><th></th><th></th>'
    return f"<h2>Bars</h2><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _rows(edges: Edges, axis: str) -> str:
    top = "".join(
        f'<th colspan="{count}">{name}</th>'
        for count, name in ((2, ""), (3, "Error, ours"), (2, "Predicted, error"), (2, "Paper"))
    )
    head = "".join(f'<th class="number">{escape(name)}</th>' for name in COLUMNS)
    body = "".join(
        "<tr>" + "".join(f'<td class="number">{escape(cell)}</td>' for cell in row) + "</tr>"
        for row in table(edges, axis)
    )
    return (
        f'<div class="scroll"><table><thead><tr>{top}</tr><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def markdown(edges: Edges, bars: Sequence[Bar], names: Mapping[str, str]) -> str:
    """Return the page as Markdown; ``names`` are the files of the figures."""
    lines = [f"# {TITLE}", "", f"{PAPER}.", "", _judge(edges), "", "## Bars", ""]
    lines += ["| what | worst | bar | unit | held |", "|---|---|---|---|---|"]
    lines += [
        f"| {bar.name} | {bar.value:.4g} | {bar.bound:g} | {bar.unit} | "
        f"{'yes' if bar.held else '**no**'} |"
        for bar in bars
    ]
    for name, file in names.items():
        lines += ["", f"## {CAPTIONS[name]}", "", f"![{CAPTIONS[name]}]({file})"]
    for axis in AXES:
        lines += ["", f"## Near-{axis} edges", "", _explained(), ""]
        lines += [f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
        lines += [f"| {' | '.join(row)} |" for row in table(edges, axis)]
    return "\n".join(lines) + "\n"


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


def _explained() -> str:
    return (
        "Errors are measured less predicted, pixels; of bands against green the predicted "
        "distance and the error of the measured one, ours and then the paper's of its own lens."
    )
