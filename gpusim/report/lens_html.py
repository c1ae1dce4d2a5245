"""The page on a lens as one HTML file: the figure and every number behind it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from matplotlib.figure import Figure

from gpusim.formats.ready import ReadyLens
from gpusim.lens.checks import Checked
from gpusim.lens.import_log import ImportLog
from gpusim.lens.surface import ASPHERE_POWERS, Surface
from gpusim.lens.system import System
from gpusim.report.drawing import card
from gpusim.report.lens.plots import PLOTS, draw_plot
from gpusim.report.lens.sheet import draw, draw_ready
from gpusim.report.lens.study import Study
from gpusim.report.lens_facts import (
    checks_table,
    identity,
    lens_facts,
    plane_facts,
    ready_facts,
    ready_identity,
)
from gpusim.report.lens_page import BankPage, LensPage
from gpusim.report.page import document, pairs
from gpusim.report.plane_figure import draw_plane
from gpusim.report.plane_page import PlanePage


def lens_html(
    page: LensPage, checks: Sequence[Checked], import_log: ImportLog, studies: Sequence[Study] = ()
) -> str:
    """Return the page as an HTML document that needs no other file.

    Parameters
    ----------
    page : LensPage
    checks : sequence of Checked
        The source's figures beside those that were found.
    import_log : ImportLog
        What the reader made of the lens file.
    studies : sequence of Study
        Lenses whose single figures are shown below the page.
    """
    lens = page.system.prescription
    shown = "Layout, PSFs, MTF, through focus, distortion, lateral colour, illumination"
    notes = escape(lens.notes)
    return document(
        escape(lens.title),
        escape("; ".join(filter(None, [lens.patent, *lens.history]))),
        _sheet(draw(page, titled=False), shown),
        _figures(studies),
        "<h2>Check values of the source</h2>",
        _table(("Quantity", "Indices", "Source", "Found", "Verdict"), checks_table(checks))
        if checks
        else "<p>The source states none, or not for a lens that was changed.</p>",
        "<h2>Data</h2>",
        pairs(dict([*identity(lens), *lens_facts(page.bank, page.system)])),
        f"<p>{notes}</p>",
        "<h2>Surfaces</h2>",
        _surfaces(page.system),
        "<h2>What became of the lens file</h2>",
        _import_log(import_log),
        "<h2>How it was computed</h2>",
        pairs(page.bank.provenance),
    )


def ready_html(page: BankPage, lens: ReadyLens) -> str:
    """Return the page of a ready-made bank as an HTML document that needs no other file."""
    return document(
        escape(lens.title),
        escape(f"{lens.kind}, {lens.file}"),
        _sheet(
            draw_ready(page, titled=False),
            "PSFs, MTF, distortion, lateral colour, illumination",
        ),
        "<h2>Data</h2>",
        pairs(dict([*ready_identity(lens), *ready_facts(page.bank)])),
        f"<p>{escape(lens.notes)}</p>",
        "<h2>Where it comes from</h2>",
        pairs(page.bank.provenance),
    )


def plane_html(page: PlanePage, import_log: ImportLog, studies: Sequence[Study] = ()) -> str:
    """Return the page of a lens without symmetry as an HTML document that needs no other file."""
    bank, system = page.bank, page.system
    of_lens = (
        []
        if system is None
        else [
            "<h2>Surfaces</h2>",
            _surfaces(system),
            "<h2>What became of the lens file</h2>",
            _import_log(import_log),
        ]
    )
    return document(
        escape(bank.provenance["title"]),
        escape(bank.provenance["history"]),
        _sheet(
            draw_plane(page, titled=False),
            "Layout, PSFs over the field, MTF, chief rays, lateral colour, illumination",
        ),
        _figures(studies),
        "<h2>Data</h2>",
        pairs(dict(plane_facts(bank, system))),
        *of_lens,
        "<h2>How it was computed</h2>",
        pairs(bank.provenance),
    )


def _figures(studies: Sequence[Study]) -> str:
    """Return all single figures of one or two lenses, as many abreast as there is room."""
    if not studies:
        return ""
    pictures = "".join(_sheet(draw_plot(plot, studies), plot.title) for plot in PLOTS)
    note = (
        "Stop heights are relative to the stop's radius. An OPD is positive where the wavefront "
        "is ahead of its sphere. Curves of single wavelengths are of the design wavelengths, "
        "others of white light, 400 to 700 nm, of equal energy per nm."
    )
    return f'<h2>Figures</h2><p class="soft">{note}</p><div class="plots">{pictures}</div>'


def _sheet(figure: Figure, shown: str) -> str:
    """Return a figure as part of a document."""
    return f"<figure>{card(figure, shown)}</figure>"


def _import_log(import_log: ImportLog) -> str:
    rows = [(str(row.where), row.how, row.what) for row in import_log.rows]
    return _table(("Surface", "", "What"), rows)


def _surfaces(system: System) -> str:
    count = len(system.prescription.surfaces)
    return _table(
        ("", "Radius [mm]", "To the next [mm]", "Glass behind", "Clear radius [mm]", "Shape"),
        [_surface(system, number) for number in range(1, count + 1)],
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
    """Return conic constant, polynomial and place of a surface, empty for a sphere on the axis."""
    terms = zip(ASPHERE_POWERS, surface.asphere.coefficients, strict=True)
    parts = [f"conic {surface.conic:g}"] if surface.conic else []
    parts += [f"a{power} {value:g}" for power, value in terms if value]
    if any(surface.decentre_mm):
        parts.append("decentred by {:g}, {:g} mm".format(*surface.decentre_mm))
    if any(surface.tilt_deg):
        parts.append("tilted by {:g}, {:g} deg".format(*surface.tilt_deg))
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
