"""One page on a lens: layout, PSFs, MTF, through focus, distortion, colour, illumination."""

from __future__ import annotations

import matplotlib
from matplotlib.figure import Figure

from gpusim.psf.bank import Bank
from gpusim.report.drawing import SOFT, STYLE, absent, facts, panel, titles, write
from gpusim.report.lens.curves import (
    draw_colour,
    draw_distortion,
    draw_focus,
    draw_light,
    draw_mtf,
    field_handles,
)
from gpusim.report.lens.layout import draw_layout, legend
from gpusim.report.lens.spread import draw_psfs
from gpusim.report.lens_facts import lens_facts, ready_facts
from gpusim.report.lens_page import BankPage, LensPage

FOOT = (
    "Tangential: spatial frequency along the radius. Sagittal: across it. Polychromatic: equal "
    "energy per nm, times the lens's transmission and pupil, chief rays where they land. "
    "Diffraction and aberrations from real rays."
)


READY_FOOT = (
    "Tangential: spatial frequency along the radius. Sagittal: across it. Polychromatic: equal "
    "energy per nm, times the bank's transmission and solid angle, chief rays where they land. MTF "
    "of the PSFs in the bank."
)


READY_ABSENT = (
    "Not drawn, because a bank does not hold it: the layout with its rays (no surfaces), and the "
    "MTF through focus (one image plane)."
)


def draw(page: LensPage, *, titled: bool = True) -> Figure:
    """Return the page as a figure, with its title or without."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 13.4 if titled else 12.6))
        if titled:
            head(figure, page.bank, top=13.4)
        layout = panel(figure, 0.55, 9.45, 6.45, 2.65)
        draw_layout(layout, page.system, page.elements, page.beams, page.bank.image_circle_um)
        legend(layout, field_handles(page, full=True))
        facts(figure, lens_facts(page.bank, page.system), left=7.55, top=12.35, width=4.05)
        draw_psfs(figure, page.bank, left=0.8, top=8.88, cell=1.17)
        draw_mtf(panel(figure, 7.75, 6.85, 3.85, 2.0), page)
        draw_focus(panel(figure, 7.75, 4.0, 3.85, 2.0), page)
        draw_distortion(panel(figure, 0.8, 0.95, 2.55, 2.2), page)
        draw_colour(panel(figure, 4.65, 0.95, 2.55, 2.2), page)
        draw_light(panel(figure, 8.55, 0.95, 2.55, 2.2), page, "traced")
        write(figure, 0.55, 0.28, FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def draw_ready(page: BankPage, *, titled: bool = True) -> Figure:
    """Return the page of a bank without a prescription: what it has no data for is said."""
    bank = page.bank
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 10.6 if titled else 9.8))
        if titled:
            head(figure, bank, top=10.6)
        facts(figure, ready_facts(bank), left=7.55, top=9.3, width=4.05)
        draw_psfs(figure, bank, left=0.8, top=8.88, cell=1.17)
        draw_mtf(panel(figure, 7.75, 4.0, 3.85, 2.0), page, fields=True)
        draw_distortion(panel(figure, 0.8, 0.95, 2.55, 2.2), page)
        colour = panel(figure, 4.65, 0.95, 2.55, 2.2)
        if len(page.chief_nm) > 1:
            draw_colour(colour, page)
        else:
            absent(colour, "Lateral colour", "the bank has one wavelength")
        draw_light(panel(figure, 8.55, 0.95, 2.55, 2.2), page, "bank")
        write(figure, 0.55, 0.42, READY_FOOT, fontsize=7, color=SOFT, va="center")
        write(figure, 0.55, 0.2, READY_ABSENT, fontsize=7, color=SOFT, va="center")
    return figure


def head(figure: Figure, bank: Bank, top: float) -> None:
    """Write what the lens is."""
    order = [f"f = {bank.efl_mm:.4g} mm", f"f/{bank.f_number:.3g}"]
    order.append(f"{2 * bank.field_deg[-1]:.4g}\N{DEGREE SIGN} full field")
    order.append(f"{bank.wavelengths_nm[0]:g} to {bank.wavelengths_nm[-1]:g} nm")
    if bank.provenance.get("patent", "none") != "none":
        order.append(bank.provenance["patent"])
    titles(figure, bank.provenance["title"], order, top)
