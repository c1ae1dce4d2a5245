"""One page on a lens without symmetry: PSFs over both directions of the field, and maps of it."""

from __future__ import annotations

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import ndimage

from gpusim.psf.plane_bank import PlaneBank
from gpusim.report.drawing import INK, SOFT, STYLE, absent, facts, panel, titles, write
from gpusim.report.lens.colours import FIELD_COLOURS
from gpusim.report.lens.layout import draw_layout, legend
from gpusim.report.lens.spread import DECADES, PSF_SHARE, colour_image, psf_bar, psf_image
from gpusim.report.lens_facts import plane_facts
from gpusim.report.lens_page import CURVE_FIELDS, round_above
from gpusim.report.plane_page import PlanePage, field_light

_FOOT = (
    "Fields in degrees along x and y, seen as they lie on the upright image. Polychromatic: equal "
    "energy per nm, times the lens's transmission and pupil, chief rays where they land. Lateral "
    "colour: largest distance of two chief rays."
)
_TONES = LinearSegmentedColormap.from_list("", ["#f4f7fb", "#a9c3e2", "#2f5d94"])
_DEGREE, _MICRO = "\N{DEGREE SIGN}", "\N{MICRO SIGN}m"


def draw_plane(page: PlanePage, *, titled: bool = True) -> Figure:
    """Return the page as a figure, with its title or without."""
    bank = page.bank
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 14.4 if titled else 13.6))
        if titled:
            order = [f"f = {bank.efl_mm:.4g} mm", f"f/{bank.f_number:.3g}"]
            order.append(f"{bank.wavelengths_nm[0]:g} to {bank.wavelengths_nm[-1]:g} nm")
            titles(figure, bank.provenance["title"], order, top=14.4)
        _layout(panel(figure, 0.55, 10.45, 6.45, 2.65), page)
        facts(figure, plane_facts(bank, page.system), left=7.55, top=13.35, width=4.05)
        _psfs(figure, bank, left=0.8, bottom=3.95, side=5.95)
        for row, axis in enumerate("xy"):
            _map(
                panel(figure, 7.85, 7.25 - 3.3 * row, 3.5, 2.5),
                bank,
                page.mtf[row],
                title=f"MTF at {page.frequency:g} cycles/mm along {axis}",
                form="{:.2f}",
                limits=(0.0, 1.0),
            )
        _chief_rays(panel(figure, 0.8, 0.95, 2.9, 2.2), page)
        _map(
            panel(figure, 4.55, 0.95, 2.9, 2.2),
            bank,
            page.lateral_um,
            title=f"Lateral colour [{_MICRO}]",
            form="{:.1f}" if page.lateral_um.max() >= 10 else "{:.2f}",
        )
        light = bank.relative_illumination[..., bank.reference]
        limits = (0.9 * float(light.min()), float(light.max()))
        axes = panel(figure, 8.35, 0.95, 2.9, 2.2)
        _map(axes, bank, light, title="Relative illumination", form="{:.2f}", limits=limits)
        write(figure, 0.55, 0.28, _FOOT, fontsize=7, color=SOFT, va="center")
    return figure


def _layout(axes: Axes, page: PlanePage) -> None:
    """Draw the lens in the y-z plane, or say why not."""
    if page.system is None:
        absent(axes, "Layout", "the file holds a bank and no surfaces")
        return
    half_um = float(np.abs(page.bank.chief_y_um).max())
    draw_layout(axes, page.system, page.elements, page.beams, half_um)
    angles = [part * page.bank.field_y_deg[-1] for part in CURVE_FIELDS.values()]
    handles = [
        Line2D([], [], color=colour, label=f"y {angle:.3g}{_DEGREE}" if angle else "axis")
        for colour, angle in zip(FIELD_COLOURS.values(), angles, strict=True)
    ]
    legend(axes, handles)


def _psfs(figure: Figure, bank: PlaneBank, left: float, bottom: float, side: float) -> None:
    """Draw the polychromatic PSF of every field, all to one scale, where the field lies."""
    rows, columns = bank.psf.shape[:2]
    gap = 0.04
    cell = side / max(rows, columns) - gap
    half_um = _half_um(bank)
    light = field_light(bank)
    bottom += side - rows * (cell + gap)  # the upper row is always at the top
    for row, column in np.ndindex(rows, columns):
        shifts = [
            chief[row, column] - chief[row, column, bank.reference]
            for chief in (bank.chief_y_um, bank.chief_x_um)
        ]
        white = np.stack(
            [
                weight * ndimage.shift(psf.astype(float), by / bank.pitch_um, order=1)
                for weight, psf, by in zip(
                    light[row, column], bank.psf[row, column], np.transpose(shifts), strict=True
                )
            ]
        )
        place = (left + column * (cell + gap), bottom + row * (cell + gap))
        axes = panel(figure, *place, cell, cell)
        # Shown with its first direction across: x.
        picture = colour_image(white, bank).transpose(1, 0, 2)
        psf_image(axes, picture, bank.pitch_um, half_um)
        if row == rows - 1:
            angle = f"{bank.field_x_deg[column]:.3g}{_DEGREE}"
            axes.set_title(angle, loc="center", fontsize=8, fontweight="normal", pad=3)
        if column == 0:
            angle = f"{bank.field_y_deg[row]:.3g}{_DEGREE}"
            axes.set_ylabel(angle, labelpad=3, fontsize=8)
        if (row, column) == (0, 0):
            psf_bar(axes, half_um)
    up = bottom + rows * (cell + gap) + 0.28
    write(figure, left, up, "Point spread", fontsize=9.5, fontweight="bold")
    note = f"polychromatic, log stretch over {DECADES:g} decades; x to the right, y up"
    write(figure, left + 1.1, up, note, fontsize=7.5, color=SOFT)


def _half_um(bank: PlaneBank) -> float:
    """Return half the side of the pictures: round, and the widest PSF has PSF_SHARE within.

    The share is that of the light in the window.
    """
    size = bank.psf.shape[-1]
    at = np.abs(np.arange(size) - size // 2) * bank.pitch_um
    radius = np.maximum(at[:, None], at).ravel()
    order = np.argsort(radius, kind="stable")
    mean = bank.psf.mean(axis=2, dtype=float).reshape(-1, size * size)[:, order]
    within = np.cumsum(mean, axis=1)
    needed = max(radius[order][np.searchsorted(one, PSF_SHARE * one[-1])] for one in within)
    return min(round_above(max(needed, 2 * bank.pitch_um)), size // 2 * bank.pitch_um)


def _map(
    axes: Axes,
    bank: PlaneBank,
    values: np.ndarray,
    *,
    title: str,
    form: str,
    limits: tuple[float, float] | None = None,
) -> None:
    """Draw one number for each field, shaded and written out."""
    low, high = (0.0, max(float(values.max()), 1e-9)) if limits is None else limits
    axes.imshow(values, origin="lower", cmap=_TONES, vmin=low, vmax=high, aspect="auto")
    for row, column in np.ndindex(values.shape):
        value = values[row, column]
        dark = (value - low) / (high - low) > 0.7
        axes.text(
            column,
            row,
            form.format(value),
            color="white" if dark else INK,
            fontsize=6.5,
            ha="center",
            va="center",
        )
    axes.set(title=title)
    _fields(axes, bank)


def _fields(axes: Axes, bank: PlaneBank) -> None:
    """Label a map's rows and columns with their fields."""
    axes.grid(False)
    for axis, angles, name in (
        (axes.xaxis, bank.field_x_deg, "x"),
        (axes.yaxis, bank.field_y_deg, "y"),
    ):
        axis.set_ticks(range(len(angles)), [f"{angle:.3g}" for angle in angles])
        axis.set_tick_params(length=0, labelsize=7)
        axis.set_label_text(f"field {name} [{_DEGREE}]", fontsize=7.5)


def _chief_rays(axes: Axes, page: PlanePage) -> None:
    """Draw where chief rays land beside the ideal image, by arrows that are magnified."""
    ideal, away = 1e-3 * page.ideal_um, 1e-3 * page.away_um
    known = np.isfinite(ideal).all(axis=-1)
    longest = np.linalg.norm(away[known], axis=-1).max(initial=0)
    steps = [
        np.abs(np.diff(ideal[..., k], axis=1 - k)[np.isfinite(np.diff(ideal[..., k], axis=1 - k))])
        for k in (0, 1)
    ]
    spacing = min((step.min() for step in steps if step.size), default=1.0)
    magnified = max(1.0, round_above(spacing / longest) / 2) if longest > 0 else 1.0
    x, y = ideal[known].T
    u, v = magnified * away[known].T
    axes.plot(x, y, ".", color=SOFT, markersize=3)
    axes.quiver(
        x, y, u, v, angles="xy", scale_units="xy", scale=1, color=INK, width=0.006, headwidth=4
    )
    axes.set(title="Chief rays", xlabel="x [mm]", ylabel="y [mm]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    note = f"off f tan \N{GREEK SMALL LETTER THETA}, arrows {magnified:g} times as long"
    axes.set_title(note, loc="right", fontsize=7, fontweight="normal", color=SOFT)
