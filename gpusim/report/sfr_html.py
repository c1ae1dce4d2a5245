"""Slanted edges as one HTML file: figures with their uncertainties, curves, picture."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from matplotlib.figure import Figure

from gpusim.report.drawing import card
from gpusim.report.page import document

FIGURES = {"mtf50": "MTF50", "mtf50p": "MTF50P", "mtf30": "MTF30", "nyquist": "at Nyquist"}


def sfr_html(facts: Mapping[str, Any], drawn: Figure) -> str:
    """Return the page as an HTML document that needs no other file.

    Parameters
    ----------
    facts : mapping
        What the command found: see `gpusim.report.sfr_facts`.
    drawn : matplotlib.figure.Figure
    """
    shown = "Regions, edge spread functions and spatial frequency responses"
    plots = f"<figure>{card(drawn, shown)}</figure>"
    summary = f"Slanted edges by gpusim {facts['gpusim']}; {facts['units']}."
    return document(escape(facts["picture"]), escape(summary), plots, _table(facts))


def _table(facts: Mapping[str, Any]) -> str:
    more = [("mtf50_lp_mm", "MTF50, lp/mm"), ("area_ratio", "Area ratio")]
    more = [(key, name) for key, name in more if any(key in edge for edge in facts["edges"])]
    head = "".join(
        f'<th class="number">{name}</th>' for name in (*FIGURES.values(), *(n for _, n in more))
    )
    body = "".join(
        f"<tr><td>{edge['edge']}</td><td>{escape(edge['channel'])}</td>"
        f"<td>{', '.join(map(str, edge['region']))}</td>"
        + "".join(f'<td class="number">{_shown(edge["figures"][key])}</td>' for key in FIGURES)
        + "".join(f'<td class="number">{edge[key]:.4g}</td>' for key, _ in more)
        + f'<td class="number">{edge["rise_px"]:.2f}</td>'
        f'<td class="number">{_shown(edge["angle_deg"], 2)} {edge["nearer_to"]}</td></tr>'
        for edge in facts["edges"]
    )
    return (
        '<h2>Figures</h2><div class="scroll"><table><thead><tr><th>Edge</th><th>Channel</th>'
        f'<th>x, y, width, height</th>{head}<th class="number">10 to 90 %, px</th>'
        f'<th class="number">Angle, deg</th></tr></thead><tbody>{body}</tbody></table></div>'
    )


def _shown(figure: Mapping[str, float] | None, digits: int = 4) -> str:
    if figure is None:
        return "\N{EN DASH}"
    return f"{figure['value']:.{digits}f} \N{PLUS-MINUS SIGN} {figure['u']:.{digits}f}"
