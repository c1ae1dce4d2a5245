"""Colours of a ColorChecker as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from gpusim.metrics.colour import METHODS
from gpusim.report.sheet import Table, sheet

KINDS = {"as_is": "as it is", "through_matrix": "by the matrix"}


def colour_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    kinds = list(facts["summary"])
    head = ["", *(f"mean Delta E {key}" for key in METHODS)]
    head += [*(f"largest {key}" for key in METHODS), "mean xy", "largest xy"]
    summary = Table(
        "Differences from the chart",
        head,
        [[KINDS[kind], *facts["summary"][kind].values()] for kind in kinds],
    )
    patches = Table(
        "Patches",
        [
            "Patch", "R", "G", "B", "chart x", "chart y",
            *(f"{name}, {KINDS[kind]}" for kind in kinds for name in ("x", "y", "Delta E 2000")),
        ],
        [
            [
                one["name"], *one["rgb"], *one["chart_xy"],
                *(
                    value
                    for kind in kinds
                    for value in (*one[kind]["xy"], one[kind]["delta_e_2000"])
                ),
            ]
            for one in facts["patches"]
        ],
    )  # fmt: skip
    rows = [[name, *row] for name, row in zip("XYZ", facts["matrix_rgb_to_xyz"], strict=True)]
    matrix = Table("Matrix from the picture's channels to XYZ", ["", "R", "G", "B"], rows)
    said = f"Colours by gpusim {facts['gpusim']}; chart under {facts['illuminant']}; "
    shows = "Places of the patches, patches side by side, chromaticities, differences"
    return sheet(
        facts["picture"], said + facts["units"] + ".", drawn, shows, summary, patches, matrix
    )
