"""The Kodak report: its numbers, figures and tables."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

from gpusim.metrics.sfr import FREQUENCIES_CY_PX
from gpusim.validate import kodak_camera_figures as camera_figures
from gpusim.validate import kodak_figures as figures
from gpusim.validate.certified import certificate_numbers
from gpusim.validate.edges import AXES, WINDOW_PX
from gpusim.validate.kodak import BANDS, EFL_MM, REFERENCE, TOLERANCE, Edges
from gpusim.validate.kodak_measured import Measured
from gpusim.validate.kodak_noise import INEFFICIENCIES, PATCHES
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
    "squares": "Squares through the lens, as figures 7 and 8 of the paper.",
    "psfs": "Point-spread functions at three image points, as figure 6 of the paper.",
    "cost": "Error against run time at N samples a pixel.",
    "effects": "The full camera: effects off and on, as section 2 of the paper lists them.",
    "hue": "Hue shift by charge that is left behind in transfers.",
    "noise": "Parametric noise against the physical one.",
}
TEXTS = {
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
            for name, one in edges.lights.items()
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
    groups = (2, ""), (3, "Error, ours"), (2, "Predicted, error"), (2, "Paper")
    for axis in AXES:
        rows = Rows(COLUMNS, table(edges, axis), groups)
        sections.append(Section(f"Near-{axis} edges", EXPLAINED, rows=rows))
    who = edges.tracer, edges.independent
    return Report(
        "kodak", TITLE, PAPER, _judge(edges), found.bars(), sections, all_numbers(found), *who
    )


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
        "with undercorrected lateral colour, for the paper publishes no prescription. Its indices "
        "of refraction are ours. The renders are planned for the tolerance, and certificates "
        "say what they keep. An edge's position is "
        f"the centroid of its line spread within {WINDOW_PX:g} px on either side, on both sides of "
        "the comparison; pictures are taken over the predicted light of an even scene."
    )
