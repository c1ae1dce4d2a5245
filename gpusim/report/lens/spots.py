"""Spot diagrams, and maps of the wavefront with its Zernike terms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator

from gpusim.lens.analysis.zernike import TERMS, orders
from gpusim.report.drawing import INK, LINE, SOFT, panel, write
from gpusim.report.lens.colours import PALETTE, wavelength_colour
from gpusim.report.lens.frame import (
    LOOKS,
    MICRO,
    WIDTH,
    field_handles,
    field_name,
    key,
    line_handles,
    sheet,
)
from gpusim.report.lens.study import Study
from gpusim.report.lens_page import round_above, round_near

_CELLS = 3  # pictures in a row
_CELL, _GAP = 1.36, 0.12
_MARKS = "osD^v"
_BARS = np.arange(2, 23)  # Noll's terms but piston, to the second spherical


def _places(on, count: int, top: float, step: float) -> list[tuple[float, float]]:
    """Return where the lower left corners of pictures lie, inches."""
    left = (WIDTH - _CELLS * _CELL - (_CELLS - 1) * _GAP) / 2
    return [
        (left + (k % _CELLS) * (_CELL + _GAP), top - (k // _CELLS) * step - _CELL)
        for k in range(count)
    ]


def draw_spots(studies: Sequence[Study]) -> Figure:
    """Draw where rays land, with the Airy circle, all to one scale."""
    step = _CELL + 0.78
    rows = [-(-len(study.fields) // _CELLS) for study in studies]
    on = sheet("Spot diagrams", studies, step * sum(rows) + 0.6, stacked=True)
    handles = [*_spot_handles(studies), _airy_handle()]
    key(on, on.top - 0.06, handles, 4)
    top = on.top - 0.42 - 0.19 * (len(handles) > 4)
    # Beyond twice the largest RMS radius lie a few rays of flare.
    widest = max(spot.rms_um for study in studies for spot in study.spots)
    airy = max(study.airy_um for study in studies)
    half = round_above(max(2.2 * widest, 1.3 * airy))
    for study, count in zip(studies, rows, strict=True):
        for number, place in enumerate(_places(on, len(study.fields), top, step)):
            axes = panel(on.figure, *place, _CELL, _CELL)
            _spot(axes, study, number, half)
            spot = study.spots[number]
            text = f"RMS {spot.rms_um:.3g} {MICRO}m\nGEO {spot.geometric_um:.3g} {MICRO}m"
            write(on.figure, place[0], place[1] - 0.06, text, fontsize=8.5, color=INK, va="top")
            if number == 0:
                _bar(axes, half)
        top -= count * step
    return on.figure


def _spot_handles(studies: Sequence[Study]) -> list[Line2D]:
    handles = line_handles(studies)
    for number, handle in enumerate(handles):
        handle.set(linestyle="", marker=_MARKS[number % len(_MARKS)], markersize=4)
    return handles


def _airy_handle() -> Line2D:
    return Line2D(
        [],
        [],
        linestyle="",
        marker="o",
        markersize=8,
        markerfacecolor="none",
        color=INK,
        label="Airy",
    )


def _spot(axes: Axes, study: Study, number: int, half: float) -> None:
    spot = study.spots[number]
    cx, cy = spot.centroid_um
    for line, wavelength in enumerate(study.lines[0]):
        axes.plot(
            spot.x_um[line] - cx,
            spot.y_um[line] - cy,
            _MARKS[line],
            color=wavelength_colour(wavelength),
            markersize=1.3,
            markeredgewidth=0,
            rasterized=True,
        )
    axes.add_patch(Circle((0, 0), study.airy_um, fill=False, color=INK, linewidth=0.9))
    axes.set(xlim=(-half, half), ylim=(-half, half), xticks=[], yticks=[], aspect="equal")
    axes.set_title(field_name(study, number), fontsize=8.5, pad=3)
    axes.spines[:].set(visible=True, color=LINE)
    axes.grid(False)


def _bar(axes: Axes, half: float) -> None:
    length = round_near(0.6 * half, (1, 2, 5))
    x, y = -0.9 * half, -0.9 * half
    axes.plot([x, x + length], [y, y], color=INK, linewidth=1.6, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} {MICRO}m",
        (x, y),
        (0, 2),
        textcoords="offset points",
        va="bottom",
        fontsize=8,
    )


def spot_table(study: Study) -> dict[str, np.ndarray]:
    """Return where each ray lands from the primary's chief ray, with the field's radii."""
    lines, _ = study.lines
    columns = {
        name: []
        for name in ("field", "wavelength_nm", "x_um", "y_um", "rms_um", "geometric_um", "airy_um")
    }
    for field, spot in zip(study.fields, study.spots, strict=True):
        size = spot.x_um.size
        columns["field"].append(np.full(size, field.name))
        columns["wavelength_nm"].append(np.repeat(lines, spot.x_um.shape[1]))
        columns["x_um"].append(spot.x_um.ravel())
        columns["y_um"].append(spot.y_um.ravel())
        columns["rms_um"].append(np.full(size, spot.rms_um))
        columns["geometric_um"].append(np.full(size, spot.geometric_um))
        columns["airy_um"].append(np.full(size, study.airy_um))
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def draw_wavefronts(studies: Sequence[Study]) -> Figure:
    """Draw the OPD over the stop, each field to its own scale, and its Zernike terms as bars."""
    step = _CELL + 1.05
    rows = [-(-len(study.fields) // _CELLS) for study in studies]
    on = sheet("Wavefront", studies, step * sum(rows) + 2.4, stacked=True)
    top = on.top - 0.22
    for study, count in zip(studies, rows, strict=True):
        for number, place in enumerate(_places(on, len(study.fields), top, step)):
            _map(on.figure, place, study, number)
        top -= count * step
    axes = panel(on.figure, 0.76, 0.55, WIDTH - 0.96, 1.35)
    _terms(axes, studies)
    key(on, 2.2, field_handles(studies[0]), 3)
    return on.figure


def _map(figure: Figure, place: tuple[float, float], study: Study, number: int) -> None:
    wave, _ = study.waves[number]
    axes = panel(figure, *place, _CELL, _CELL)
    reach = max(float(np.nanmax(np.abs(wave.opd_waves))), 1e-4)
    shown = axes.imshow(
        wave.opd_waves,
        extent=(-1.02, 1.02, -1.02, 1.02),
        origin="lower",
        cmap="RdBu_r",
        vmin=-reach,
        vmax=reach,
        interpolation="nearest",
    )
    axes.add_patch(Circle((0, 0), 1, fill=False, color=SOFT, linewidth=0.6))
    axes.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08), xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.set_title(field_name(study, number), fontsize=8.5, pad=3)
    scale = panel(figure, place[0] + 0.12, place[1] - 0.1, _CELL - 0.24, 0.07)
    bar = figure.colorbar(shown, cax=scale, orientation="horizontal")
    end = round_near(0.6 * reach, (1, 2, 5))  # away from the labels of the map beside it
    # 0 is the middle, and would touch longer numbers.
    bar.set_ticks([-end, end], labels=[f"\N{MINUS SIGN}{end:g}", f"{end:g}"])
    bar.ax.tick_params(labelsize=8, length=2, pad=1)
    bar.outline.set_visible(False)
    text = f"P\N{EN DASH}V {wave.peak_to_valley_waves:.3g}\nRMS {wave.rms_waves:.3g} waves"
    write(figure, place[0], place[1] - 0.36, text, fontsize=8.5, va="top")


def _terms(axes: Axes, studies: Sequence[Study]) -> None:
    """Draw the fields' Zernike terms side by side; those of a second lens are circles."""
    fields = max(len(study.fields) for study in studies)
    width = 0.8 / fields
    for lens, study in enumerate(studies):
        for number, (_, terms) in enumerate(study.waves):
            at = _BARS + (number - (fields - 1) / 2) * width
            if lens == 0:
                axes.bar(at, terms[_BARS - 1], width, color=PALETTE[number], linewidth=0)
            else:
                look = LOOKS[1] | {"linestyle": "", "markevery": 1}
                axes.plot(at, terms[_BARS - 1], color=PALETTE[number], **look)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    axes.set(
        xlim=(1.4, 22.6),
        xticks=[2, 4, 6, 8, 11, 14, 17, 20, 22],
        xlabel="Zernike term (Noll 1976)",
        ylabel="waves RMS",
    )
    axes.grid(False, axis="x")
    axes.yaxis.set_major_locator(MaxNLocator(5))


def wavefront_table(study: Study) -> dict[str, np.ndarray]:
    """Return the OPD of each field over the stop, at the primary wavelength."""
    columns = {name: [] for name in ("field", "stop_x", "stop_y", "opd_waves")}
    for field, (wave, _) in zip(study.fields, study.waves, strict=True):
        lit = np.isfinite(wave.opd_waves)
        x, y = np.meshgrid(wave.stop, wave.stop)
        columns["field"].append(np.full(lit.sum(), field.name))
        columns["stop_x"].append(x[lit])
        columns["stop_y"].append(y[lit])
        columns["opd_waves"].append(wave.opd_waves[lit])
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def zernike_table(study: Study) -> dict[str, np.ndarray]:
    """Return the Zernike terms of each field with RMS and peak to valley."""
    numbers = np.arange(1, TERMS + 1)
    pairs = np.array([orders(int(j)) for j in numbers])
    many = len(study.fields)
    return {
        "field": np.repeat([field.name for field in study.fields], TERMS),
        "term": np.tile(numbers, many),
        "n": np.tile(pairs[:, 0], many),
        "m": np.tile(pairs[:, 1], many),
        "coefficient_waves": np.concatenate([terms for _, terms in study.waves]),
        "rms_waves": np.repeat([wave.rms_waves for wave, _ in study.waves], TERMS),
        "peak_to_valley_waves": np.repeat(
            [wave.peak_to_valley_waves for wave, _ in study.waves], TERMS
        ),
    }
