"""The page on a lens as one HTML file: the figure and every number behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from gpusim.formats.ready import ReadyLens
from gpusim.lens.checks import Checked
from gpusim.lens.import_log import ImportLog
from gpusim.lens.surface import ASPHERE_POWERS, Surface
from gpusim.lens.system import System
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
from gpusim.report.plane_figure import draw_plane
from gpusim.report.plane_page import PlanePage
from gpusim.report.template import filled


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
    return _filled(
        page.bank.provenance,
        title=lens.title,
        summary="; ".join(filter(None, [lens.patent, *lens.history])),
        figure=draw(page, titled=False),
        shows="Layout, PSFs, MTF, through focus, distortion, lateral colour, illumination",
        plots=_plots(studies),
        checks=checks_table(checks),
        data=dict([*identity(lens), *lens_facts(page.bank, page.system)]),
        notes=lens.notes,
        **_surfaces(page.system, import_log),
    )


def ready_html(page: BankPage, lens: ReadyLens) -> str:
    """Return the page of a ready-made bank as an HTML document that needs no other file."""
    return _filled(
        page.bank.provenance,
        title=lens.title,
        summary=f"{lens.kind}, {lens.file}",
        figure=draw_ready(page, titled=False),
        shows="PSFs, MTF, distortion, lateral colour, illumination",
        data=dict([*ready_identity(lens), *ready_facts(page.bank)]),
        notes=lens.notes,
        origin="Where it comes from",
    )


def plane_html(page: PlanePage, import_log: ImportLog, studies: Sequence[Study] = ()) -> str:
    """Return the page of a lens without symmetry as an HTML document that needs no other file."""
    bank, system = page.bank, page.system
    return _filled(
        bank.provenance,
        title=bank.provenance["title"],
        summary=bank.provenance["history"],
        figure=draw_plane(page, titled=False),
        shows="Layout, PSFs over the field, MTF, chief rays, lateral colour, illumination",
        plots=_plots(studies),
        data=dict(plane_facts(bank, system)),
        **({} if system is None else _surfaces(system, import_log)),
    )


def _filled(provenance: Mapping[str, str], **values: Any) -> str:
    """Return a page of the parts that a lens has."""
    absent = dict.fromkeys(("plots", "checks", "notes", "surfaces", "import_log"))
    origin = {"origin": "How it was computed", "provenance": provenance}
    return filled("report/templates/lens.html", **absent | origin | values)


def _plots(studies: Sequence[Study]) -> list[tuple[str, Figure]]:
    """Return all single figures of one or two lenses by title."""
    return [(plot.title, draw_plot(plot, studies)) for plot in PLOTS] if studies else []


def _surfaces(system: System, import_log: ImportLog) -> dict[str, Any]:
    """Return the rows of a lens's surfaces, and what became of its file."""
    numbers = range(1, len(system.prescription.surfaces) + 1)
    return {
        "surfaces": [_surface(system, number) for number in numbers],
        "import_log": [(str(row.where), row.how, row.what) for row in import_log.rows],
    }


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
