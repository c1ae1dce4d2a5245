"""The Kodak report: its numbers, figures and tables."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.validate import kodak_camera_figures as camera_figures
from gpusim.validate import kodak_figures as figures
from gpusim.validate.certified import certificate_numbers, certificate_section
from gpusim.validate.edges import AXES, WINDOW_PX
from gpusim.validate.kodak import BANDS, EFL_MM, REFERENCE, TOLERANCE, Edges
from gpusim.validate.kodak_measured import Measured
from gpusim.validate.kodak_noise import INEFFICIENCIES, PATCHES
from gpusim.validate.kodak_table import TABLE_1, Row
from gpusim.validate.report import Report, Rows, Section
from gpusim.validate.tracers import SHARED, independence_bar

TITLE = "Validation: Kodak's simulator with a lens model of PSFs"
PAPER = (
    "R. Short, D. Williams and A. E. W. Jones, Image capture simulation using an accurate and "
    "realistic lens model, Proc. SPIE 3650, 138-147 (1999)"
)
CAPTIONS = {
    "positions": "Positions of edges against prediction, as table 1 of the paper lists them.",
    "edges": "An edge near the right-hand side in three bands, as figure 9 of the paper.",
    "mtf": "MTF at the centre, in mid-field and at the edge, as figures 10 to 12 of the paper.",
    "squares": "Squares through the lens, as figures 7 and 8 of the paper.",
    "psfs": "Point-spread functions at three image points, as figure 6 of the paper.",
    "cost": "Error against run time at N samples a pixel.",
    "effects": "The full camera: effects off and on, as section 2 of the paper lists them.",
    "hue": "Hue shift by charge that is left behind in transfers.",
    "noise": "Parametric noise against the physical one.",
}
TEXTS = {
    "positions": (
        "Edges 1 and 2, next to the axis where the lens is sharpest, are rendered with 16 samples "
        "for each pixel: the planner takes 8 there, which leaves 1.6e-3 to 2.5e-3 (RMS) on their "
        "steepest pixels. The others have what the planner takes."
    ),
    "squares": (
        "The paper gives no size of its squares: ours are 32 pixels of 64. Shading, distortion and "
        "blur towards the corners are those of the stand-in lens."
    ),
    "psfs": "Misplaced is the share of the light that lies elsewhere than the tracer has it.",
    "cost": (
        "The paper works with N = 2 and calls it enough to show aliasing. On the axis, where this "
        "lens is sharpest, two samples for each pixel are not enough for its edges; away from it "
        "PSFs are wider, and they are. The engine chooses N from the tolerance."
    ),
    "effects": (
        "Each effect is switched on alone, and held against its law, worked out from the picture "
        "without it: see the bars. Shift of the filters, cross-talk and masks are our examples, "
        "for the paper gives no figures."
    ),
    "hue": (
        "The packet of a column holds a growing share of its neighbours' charge, which is of "
        "another filter. The paper names the effect and gives no figures."
    ),
    "noise": (
        "The paper's model has two numbers and the normal law. Its variance is the physical one; "
        "what it lacks is the skewness of counting, and saturation."
    ),
}
# Renders without a certificate, and why.
WITHOUT = {
    "edges 1 and 5 at N = 2, 3, 4, 8 and 16": (
        "what their sim grids err by is measured there: N is given, not planned for a tolerance"
    ),
}
EXPLAINED = {
    "vertical": (
        "Pixels along x. The paper's columns are its table 1, which lists near-vertical edges "
        "before its own lens: its lateral colour is another. A dash stands where the scan of the "
        "table is not legible."
    ),
    "horizontal": "Pixels along y. The paper rendered such edges too, and lists none of them.",
}
POSITIONS = "Errors are measured less predicted."
OFFSETS = "Places of red and blue less that of green: predicted, measured, and the error."


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
        "certificates": certificate_numbers(edges.certificates),
    }


def _paper(place: Row) -> dict[str, Any]:
    """Return a row of the paper's table; None where it cannot be read."""

    def known(values: Sequence[float]) -> list[float | None]:
        return [None if math.isnan(value) else value for value in values]

    lists = {name: known(getattr(place, name)) for name in ("position", "red", "blue")}
    return {"edge": place.number, "x": place.x, "y": place.y} | lists


def positions(edges: Edges, axis: str) -> Rows:
    """Return absolute errors of the edges, for near-vertical ones beside table 1 of the paper."""
    rows, told = [], axis == AXES[0]
    for place in TABLE_1:
        own = [edges.found[band, axis, place.number].error_px for band in BANDS]
        theirs = [_signed(error, 3) for error in place.position] if told else []
        where = f"{place.x:g}, {place.y:g}"
        rows.append([str(place.number), where, *(_signed(e, 4) for e in own), *theirs])
    papers = [f"{band}, paper" for band in BANDS] if told else []
    return Rows(("edge", "x, y [px]", *BANDS, *papers), rows)


def offsets(edges: Edges, axis: str) -> Rows:
    """Return edges of red and blue from those of green, near-vertical ones beside the paper's."""
    rows, told = [], axis == AXES[0]
    others = dict(zip(BANDS.replace(REFERENCE, ""), ("red", "blue"), strict=True))
    for place in TABLE_1:
        row = [str(place.number)]
        for band, name in others.items():
            predicted, measured = edges.apart(band, axis, place.number)
            row += [_signed(predicted, 3), _signed(measured, 3), _signed(measured - predicted, 4)]
            row += [_signed(value, 3) for value in getattr(place, name)] if told else []
        rows.append(row)
    parts, head = ("predicted", "measured", "error"), ["edge"]
    for band in others:
        head += [f"{band} to {REFERENCE}, {part}" for part in parts]
        head += [f"{part}, paper" for part in parts] if told else []
    return Rows(head, rows)


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign; a dash for none."""
    return "-" if math.isnan(value) else f"{value:+.{digits}f}"


def report(found: Measured) -> Report:
    """Return the report of all that was measured."""
    edges = found.edges
    drawn = {
        "squares": camera_figures.draw_squares(found.effects),
        "psfs": camera_figures.draw_psfs(found.psfs),
        "positions": figures.draw_positions(edges),
        "edges": figures.draw_edges(edges),
        "mtf": figures.draw_mtfs(edges),
        "cost": camera_figures.draw_costs(found.costs),
        "effects": camera_figures.draw_effects(found.effects),
        "hue": camera_figures.draw_hues(found.hues),
        "noise": camera_figures.draw_noises(found.noises),
    }
    sections = [
        Section(CAPTIONS[name], TEXTS.get(name, ""), name=name, figure=figure)
        for name, figure in drawn.items()
    ]
    for axis in AXES:
        for title, told, rows in (
            (f"Near-{axis} edges: positions", POSITIONS, positions(edges, axis)),
            (f"Near-{axis} edges: between bands", OFFSETS, offsets(edges, axis)),
        ):
            sections.append(Section(title, f"{told} {EXPLAINED[axis]}", rows=rows))
    certificates = edges.certificates | dict(found.effects.certificates)
    sections.append(certificate_section(certificates, WITHOUT))
    who = edges.tracer, edges.independent
    bars = [independence_bar(edges.independent), *found.bars()]
    return Report("kodak", TITLE, PAPER, _judge(edges), bars, sections, all_numbers(found), *who)


def all_numbers(found: Measured) -> dict[str, Any]:
    """Return every number of the report."""
    effects, hues = found.effects, found.hues
    return numbers(found.edges) | {
        "psfs": [
            {"where": one.where, "field_deg": one.field_deg, "misplaced": one.elsewhere}
            for one in found.psfs.found
        ],
        "effects": {
            one.name: {"told": one.told, "error": one.bar.value, "bar": one.bar.bound}
            for one in effects.found
        },
        "effect_certificates": certificate_numbers(effects.certificates),
        "hue": {
            "left_behind": list(INEFFICIENCIES),
            "columns": hues.columns.tolist(),
            "ratios_rg_bg": hues.ratios.tolist(),
            "expected_rg_bg": hues.expected.tolist(),
            "patches": list(PATCHES),
            "hue_shift_deg_of_coloured_patches": hues.hue_deg[..., -1].tolist(),
            "delta_e_2000_at_the_last_column": hues.delta_e.tolist(),
        },
        "noise": [dataclasses.asdict(one) for one in found.noises.levels],
        "cost": [dataclasses.asdict(one) | {"median_s": one.median_s} for one in found.costs.found],
    }


def _judge(edges: Edges) -> str:
    who = f"Predictions are by {edges.tracer}"
    if not edges.independent:
        who += ", which is NOT independent (optiland is: pip install .[judges])"
    return (
        f"{who}: rays, wavefronts and vignetting of a stand-in lens of {EFL_MM} mm and NA 0.22 "
        f"with undercorrected lateral colour, for the paper publishes no prescription. {SHARED} "
        "The renders are planned for the tolerance, and certificates "
        "say what they keep. An edge's position is "
        f"the centroid of its line spread within {WINDOW_PX:g} px on either side, on both sides of "
        "the comparison; pictures are taken over the predicted light of an even scene."
    )
