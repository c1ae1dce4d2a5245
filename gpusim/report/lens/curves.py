"""Curves of the page on a lens: MTF, through focus, distortion, colour, illumination."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import PchipInterpolator

from gpusim.psf import otf
from gpusim.psf.bank import Bank
from gpusim.report.drawing import INK, SOFT, end_labels, roomy
from gpusim.report.lens.colours import FIELD_COLOURS, wavelength_colour
from gpusim.report.lens_facts import distortions, working_f_number
from gpusim.report.lens_page import BankPage, LensPage

_DASHES = {"tangential": "-", "sagittal": (0, (4, 2))}


def draw_mtf(axes: Axes, page: BankPage, *, fields: bool = False) -> None:
    """Draw the polychromatic MTF of a few fields and the diffraction limit.

    ``fields`` asks for their names in the panel.
    """
    axes.plot(page.frequency, page.limit, color="#9aa3ad", linewidth=1.1, linestyle=":")
    for field in page.curves:
        _pair(axes, page.frequency, field.against_frequency, FIELD_COLOURS[field.name])
    axes.set(
        title="MTF",
        xlabel="spatial frequency [cycles/mm]",
        xlim=(0, page.frequency[-1]),
        ylim=(0, 1),
    )
    handles = [
        Line2D([], [], color=INK, label="tangential"),
        Line2D([], [], color=INK, linestyle=_DASHES["sagittal"], label="sagittal"),
        Line2D([], [], color="#9aa3ad", linestyle=":", label="diffraction limit"),
    ]
    if fields:
        names = axes.legend(handles=field_handles(page, full=True), loc="upper right")
        axes.add_artist(names)
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        borderaxespad=0,
        columnspacing=1.0,
        handlelength=1.8,
        handletextpad=0.5,
    )


def _pair(axes: Axes, x: np.ndarray, pair: np.ndarray, colour: str) -> None:
    for values, direction in zip(pair, otf.DIRECTIONS, strict=True):
        axes.plot(x, values, color=colour, linestyle=_DASHES[direction], linewidth=1.3)


def draw_focus(axes: Axes, page: LensPage) -> None:
    """Draw the MTF through focus at one frequency."""
    in_um = page.focus_mm[-1] < 0.5
    factor, unit = (1e3, "\N{MICRO SIGN}m") if in_um else (1.0, "mm")
    axes.axvline(0, color=SOFT, linewidth=0.7)
    for pair, colour in zip(page.through_focus, FIELD_COLOURS.values(), strict=True):
        _pair(axes, factor * page.focus_mm, pair, colour)
    axes.set(
        title="Through focus",
        ylabel=f"MTF at {page.focus_frequency:g} cycles/mm",
        xlabel=f"shift of the image plane, away from the lens [{unit}]",
        xlim=(factor * page.focus_mm[0], factor * page.focus_mm[-1]),
        ylim=(0, 1),
    )
    axes.xaxis.set_major_locator(MaxNLocator(7))
    axes.legend(
        handles=field_handles(page),
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        borderaxespad=0,
        columnspacing=0.9,
        handlelength=1.0,
        handletextpad=0.4,
    )


def field_handles(page: BankPage, *, full: bool = False) -> list[Line2D]:
    """Return legend entries of the fields that have curves."""
    return [
        Line2D(
            [],
            [],
            color=FIELD_COLOURS[curves.name],
            label=_field_label(curves.name, curves.field_deg) if full else curves.name,
        )
        for curves in page.curves
    ]


def _field_label(name: str, field_deg: float) -> str:
    return name if field_deg == 0 else f"{name} ({field_deg:.3g}\N{DEGREE SIGN})"


def _against_field(axes: Axes, bank: Bank) -> None:
    axes.set(xlabel="field angle [\N{DEGREE SIGN}]", xlim=(0, bank.field_deg[-1]))
    axes.xaxis.set_major_locator(MaxNLocator(6))


def draw_distortion(axes: Axes, page: BankPage) -> None:
    """Draw the distortion against f tan(theta), and against f theta for wide lenses."""
    curves = distortions(page.chief_deg, page.chief_um[:, 0])
    axes.axhline(0, color=SOFT, linewidth=0.7)
    for percent, style in zip(curves.values(), _DASHES.values(), strict=False):
        axes.plot(page.chief_deg, percent, color=INK, linestyle=style)
    axes.set(title="Distortion", ylabel="%")
    _against_field(axes, page.bank)
    roomy(axes)
    end_labels(axes, [(float(percent[-1]), name, INK) for name, percent in curves.items()])


def draw_colour(axes: Axes, page: BankPage) -> None:
    """Draw where the chief rays of a few wavelengths land beside that of the reference."""
    bank = page.bank
    airy = 1.22e-3 * bank.reference_nm * working_f_number(bank)
    axes.axhspan(-airy, airy, color="#eceff3", linewidth=0, zorder=0)
    ends = []
    for line, wavelength in enumerate(page.chief_nm):
        shift, colour = page.chief_um[:, line] - page.chief_um[:, 0], wavelength_colour(wavelength)
        axes.plot(page.chief_deg, shift, color=colour)
        ends.append((float(shift[-1]), f"{wavelength:g} nm", colour))
    axes.set(title="Lateral colour", ylabel="\N{MICRO SIGN}m")
    _against_field(axes, bank)
    roomy(axes)
    end_labels(axes, ends)
    note = f"grey: Airy radius, {airy:.2g} \N{MICRO SIGN}m"
    axes.set_title(note, loc="right", fontsize=7.5, fontweight="normal", color=SOFT)


def draw_light(axes: Axes, page: BankPage, name: str) -> None:
    """Draw the relative illumination beside the cos^4 law."""
    bank = page.bank
    traced = bank.relative_illumination[:, bank.reference]
    fine = np.linspace(0, bank.field_deg[-1], 200)
    axes.plot(fine, _cos4(fine), color="#9aa3ad", linestyle=":")
    # Dots where it was computed; the curve between them keeps them and swings nowhere.
    axes.plot(fine, PchipInterpolator(bank.field_deg, traced)(fine), color=INK)
    axes.plot(bank.field_deg, traced, ".", color=INK, markersize=3.5, clip_on=False)
    axes.set(title="Relative illumination", ylim=(0, 1.02))
    _against_field(axes, bank)
    end_labels(
        axes,
        [
            (float(traced[-1]), name, INK),
            (float(_cos4(fine[-1])), "cos$^4$", SOFT),
        ],
    )


def _cos4(field_deg: np.ndarray) -> np.ndarray:
    return np.cos(np.radians(np.minimum(field_deg, 90.0))) ** 4
