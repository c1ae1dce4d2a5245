"""``gpusim measure colour``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.cli.measured import deliver, numbers, print_table, say
from gpusim.metrics.colour import METHODS, measure_colour
from gpusim.metrics.picture import read_picture
from gpusim.report.colour_facts import colour_facts, colour_rows
from gpusim.report.colour_figure import draw_colour
from gpusim.report.colour_html import KINDS, colour_html


def colour(
    path: Path,
    illuminant: str,
    corners: str | None,
    out: Path | None,
    *,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure the colours of a ColorChecker in a picture."""
    planes = read_picture(path, linear=linear)
    given = None
    if corners is not None:
        allowed = "x,y of the middles of dark skin, bluish green, black and white: eight numbers"
        given = np.reshape(numbers(corners, 8, "--corners", allowed), (4, 2))
    found = measure_colour(planes, illuminant, given)
    facts = colour_facts(found)
    deliver(
        "colour",
        path,
        out,
        facts,
        colour_rows(facts),
        draw=lambda: draw_colour(found, planes, path.name),
        html=colour_html,
        show=show,
        as_json=as_json,
    )


def show(facts: dict[str, Any]) -> None:
    """Print a line for each patch, and what they say together."""
    kinds = list(facts["summary"])
    print_table(
        ("patch", *(f"{part} {KINDS[kind]}" for kind in kinds for part in ("xy off", "dE2000"))),
        [
            (
                one["name"].partition(" (")[0],
                *(
                    text
                    for kind in kinds
                    for text in (
                        f"{math.dist(one[kind]['xy'], one['chart_xy']):.4f}",
                        f"{one[kind]['delta_e_2000']:.2f}",
                    )
                ),
            )
            for one in facts["patches"]
        ],
    )
    for kind, one in facts["summary"].items():
        means = ", ".join(f"{key} {one[f'mean_delta_e_{key}']:.2f}" for key in METHODS)
        say(
            f"{KINDS[kind]}: mean dE {means}, largest dE2000 {one['largest_delta_e_2000']:.2f}; xy "
            f"of the 18 chromatic patches off by {one['mean_xy']:.4f} ({one['largest_xy']:.4f} at "
            "most)"
        )
    if facts["white_xy"] is not None:
        x, y = facts["white_xy"]
        say(f"white point of the greys: {x:.4f}, {y:.4f} (D65: 0.3127, 0.3290)")
    if facts["clipped"]:
        say(f"clipped: {', '.join(facts['clipped'])}")
