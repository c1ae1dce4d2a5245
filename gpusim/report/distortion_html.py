"""Distortion as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from gpusim.report.sheet import Table, sheet


def distortion_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file."""
    tables = [
        Table(
            "Local geometric distortion",
            ("r_d", "LGD, %", "u (k = 1), %"),
            [(one["radius"], one["value"], one["u"]) for one in facts["lgd_percent"]],
        ),
        Table(
            "Models",
            ("Model", "Coefficients", "Misses, px RMS", "Worst, px"),
            [
                (
                    name,
                    ", ".join(f"{value:.5g}" for value in one["coefficients"]),
                    one["rms_px"],
                    one["worst_px"],
                )
                for name, one in facts["models"].items()
            ],
        ),
    ]
    if facts["lateral_colour"]:
        tables.append(
            Table(
                f"Lateral colour against {facts['reference']}",
                ("Channel", "RMS, px", "Largest, outwards, px", "% of the way to the corner"),
                [
                    (
                        one["channel"],
                        one["rms_px"],
                        one["largest_radial_px"],
                        one["largest_radial_percent"],
                    )
                    for one in facts["lateral_colour"]
                ],
            )
        )
    summary = f"Distortion by gpusim {facts['gpusim']}; {facts['units']}."
    shows = "Marks, local geometric distortion over radius and picture, misses, lateral colour"
    return sheet(facts["picture"], summary, drawn, shows, *tables)
