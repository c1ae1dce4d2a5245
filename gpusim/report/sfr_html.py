"""Slanted edges as one HTML file: figures with their uncertainties, curves, picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from gpusim.report.sheet import Table, sheet

FIGURES = {"mtf50": "MTF50", "mtf50p": "MTF50P", "mtf30": "MTF30", "nyquist": "at Nyquist"}


def sfr_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file.

    Parameters
    ----------
    facts : mapping
        What the command found: see `gpusim.report.sfr_facts`.
    drawn : matplotlib.figure.Figure
    """
    shows = "Regions, edge spread functions and spatial frequency responses"
    summary = f"Slanted edges by gpusim {facts['gpusim']}; {facts['units']}."
    return sheet(facts["picture"], summary, drawn, shows, _table(facts["edges"]))


def _table(edges: list[Mapping[str, Any]]) -> Table:
    more = {"mtf50_lp_mm": "MTF50, lp/mm", "area_ratio": "Area ratio"}
    more = {key: name for key, name in more.items() if any(key in edge for edge in edges)}
    head = ["Edge", "Channel", "x, y, width, height", *FIGURES.values(), *more.values()]
    head += ["10 to 90 %, px", "Angle, deg"]
    rows = [
        (
            str(edge["edge"]), edge["channel"], ", ".join(map(str, edge["region"])),
            *(_shown(edge["figures"][key]) for key in FIGURES),
            *(f"{edge[key]:.4g}" for key in more), f"{edge['rise_px']:.2f}",
            f"{_shown(edge['angle_deg'], 2)} {edge['nearer_to']}",
        )
        for edge in edges
    ]  # fmt: skip
    return Table("Figures", head, rows, ["", "", "", *["number"] * (len(head) - 3)])


def _shown(figure: Mapping[str, float] | None, digits: int = 4) -> str:
    if figure is None:
        return "\N{EN DASH}"
    return f"{figure['value']:.{digits}f} \N{PLUS-MINUS SIGN} {figure['u']:.{digits}f}"
