"""Transverse ray fans and OPD fans, a pair for each field."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gpusim.lens.analysis.rays import Fan
from gpusim.report.drawing import SOFT, panel
from gpusim.report.lens.colours import wavelength_colour
from gpusim.report.lens.frame import MICRO, field_name, key, line_handles, sheet
from gpusim.report.lens.study import Study

_ROW, _HIGH = 1.55, 1.02  # inches from one field to the next, and of a panel


def draw_ray_fans(studies: Sequence[Study]) -> Figure:
    """Draw where rays land against where they meet the stop."""
    title = "Ray fans"
    return _draw(
        title, studies, (f"ey [{MICRO}m]", f"ex [{MICRO}m]"), (lambda f: f.y_um, lambda f: f.x_um)
    )


def draw_opd_fans(studies: Sequence[Study]) -> Figure:
    """Draw the OPD against where rays meet the stop."""
    opd = (lambda f: f.opd_waves,) * 2
    return _draw("OPD fans", studies, ("W [waves]", "W [waves]"), opd)


def _draw(
    title: str,
    studies: Sequence[Study],
    labels: tuple[str, str],
    values: tuple[Callable[[Fan], np.ndarray], Callable[[Fan], np.ndarray]],
) -> Figure:
    rows = max(len(study.fields) for study in studies)
    on = sheet(title, studies, _ROW * rows + 0.62)
    key(on, on.top - 0.06, line_handles(studies), 5)
    drawn = []
    for row in range(rows):
        bottom = on.top - 0.48 - _ROW * row - _HIGH
        for column, (label, value) in enumerate(zip(labels, values, strict=True)):
            axes = panel(on.figure, 0.66 + 2.22 * column, bottom, 1.55, _HIGH)
            drawn.append(axes)
            axes.axhline(0, color=SOFT, linewidth=0.7)
            axes.axvline(0, color=SOFT, linewidth=0.7)
            for study, look in on.looks:
                if row >= len(study.fields):
                    continue
                fan = study.fans[row][column]
                for wavelength, curve in zip(study.lines[0], value(fan), strict=True):
                    colour = wavelength_colour(wavelength)
                    axes.plot(fan.stop, curve, color=colour, **look)
            axes.set(xlim=(-1, 1), xticks=[-1, -0.5, 0, 0.5, 1])
            axes.set_xticklabels(["\N{MINUS SIGN}1", "", "0", "", "1"])
            if column == 0:
                axes.set_title(field_name(studies[0], min(row, len(studies[0].fields) - 1)))
            if row == rows - 1:
                axes.set_xlabel("stop y [radii]" if column == 0 else "stop x [radii]")
            axes.set_ylabel(label, labelpad=1)
    reach = max(np.abs(axes.dataLim.intervaly).max() for axes in drawn)
    for axes in drawn:  # one scale: fields are to be compared
        axes.set_ylim(*(np.array([-1.08, 1.08]) * max(reach, 1e-3)))
        axes.yaxis.set_major_locator(MaxNLocator(4, symmetric=True))
    return on.figure


def ray_fan_table(study: Study) -> dict[str, np.ndarray]:
    """Return transverse aberrations: field, fan, wavelength, place at the stop, ex and ey."""
    return _table(study, {"ex_um": lambda f: f.x_um, "ey_um": lambda f: f.y_um})


def opd_fan_table(study: Study) -> dict[str, np.ndarray]:
    """Return OPDs: field, fan, wavelength, place at the stop, W."""
    return _table(study, {"opd_waves": lambda f: f.opd_waves})


def _table(study: Study, values: dict[str, Callable[[Fan], np.ndarray]]) -> dict[str, np.ndarray]:
    lines, _ = study.lines
    columns = {name: [] for name in ("field", "fan", "wavelength_nm", "stop", *values)}
    for field, pair in zip(study.fields, study.fans, strict=True):
        for way, fan in zip("yx", pair, strict=True):
            size = fan.y_um.size
            columns["field"].append(np.full(size, field.name))
            columns["fan"].append(np.full(size, way))
            columns["wavelength_nm"].append(np.repeat(lines, len(fan.stop)))
            columns["stop"].append(np.tile(fan.stop, len(lines)))
            for name, value in values.items():
                columns[name].append(value(fan).ravel())
    return {name: np.concatenate(parts) for name, parts in columns.items()}
