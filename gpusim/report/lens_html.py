"""The page on a lens as one HTML file: the figure and every number behind it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from gpusim.lens.account import Account
from gpusim.lens.prescription import ASPHERE_POWERS, Surface
from gpusim.lens.system import Checked, System
from gpusim.report.lens_facts import checks_table, identity, lens_facts
from gpusim.report.lens_figure import svg
from gpusim.report.lens_page import LensPage
from gpusim.report.page import document, pairs


def lens_html(page: LensPage, checks: Sequence[Checked], account: Account) -> str:
    """Return the page as an HTML document that needs no other file.

    Parameters
    ----------
    page : LensPage
    checks : sequence of Checked
        The source's figures beside those that were found.
    account : Account
        What the reader made of the lens file.
    """
    lens = page.system.prescription
    picture = base64.b64encode(svg(page).encode()).decode()
    figure = (
        f'<figure><img class="sheet" src="data:image/svg+xml;base64,{picture}" '
        'alt="Layout, PSFs, MTF, through focus, distortion, lateral colour, illumination">'
        "</figure>"
    )
    notes = escape(lens.notes)
    return document(
        escape(lens.title),
        escape("; ".join(filter(None, [lens.patent, *lens.history]))),
        figure,
        "<h2>Check values of the source</h2>",
        _table(("Quantity", "Indices", "Source", "Found", "Verdict"), checks_table(checks))
        if checks
        else "<p>The source states none, or not for a lens that was changed.</p>",
        "<h2>Data</h2>",
        pairs(dict([*identity(lens), *lens_facts(page.bank, page.system)])),
        f"<p>{notes}</p>",
        "<h2>Surfaces</h2>",
        _table(
            ("", "Radius [mm]", "To the next [mm]", "Glass behind", "Clear radius [mm]", "Shape"),
            [_surface(page.system, number) for number in range(1, len(lens.surfaces) + 1)],
        ),
        "<h2>What became of the lens file</h2>",
        _table(("Surface", "", "What"), [(str(r.where), r.how, r.what) for r in account.rows]),
        "<h2>How it was computed</h2>",
        pairs(page.bank.provenance),
    )


def _surface(system: System, number: int) -> tuple[str, ...]:
    """Return the row of a surface."""
    lens = system.prescription
    surface = lens.surfaces[number - 1]
    clear = system.semi_diameter_mm[number - 1]
    curvature = surface.vertex_curvature
    last = number == len(lens.surfaces)
    space = system.image_z_mm - system.geometry.vertex_z[-1] if last else surface.thickness
    is_stop = number == lens.stop
    if is_stop:
        clear = min(clear, system.stop_radius_mm)
    return (
        f"{number} stop" if is_stop else str(number),
        f"{1 / curvature:.6g}" if curvature else "plane",
        f"{space:.6g}",
        surface.glass or "air",
        f"{clear:.5g}",
        _shape(surface),
    )


def _shape(surface: Surface) -> str:
    """Return conic constant and polynomial of a surface, empty for a sphere."""
    terms = zip(ASPHERE_POWERS, surface.asphere.coefficients, strict=True)
    parts = [f"conic {surface.conic:g}"] if surface.conic else []
    parts += [f"a{power} {value:g}" for power, value in terms if value]
    return ", ".join(parts)


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of texts."""
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )
