"""Field curvature with distortion, and longitudinal colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gpusim.report.drawing import INK, SOFT, panel
from gpusim.report.lens.colours import wavelength_colour
from gpusim.report.lens.frame import (
    DASHES,
    Sheet,
    against_field_up,
    key,
    line_handles,
    sheet,
    unit_of,
    way_handles,
    wide_enough,
)
from gpusim.report.lens.study import ZONES, Study
from gpusim.report.lens_facts import distortions

WIDE = 4.45  # inches to the right ends of panels


def draw_curvature(studies: Sequence[Study]) -> Figure:
    """Draw tangential and sagittal focus over the field, and the distortion beside them.

    Without an axis there is no distortion by a law of projection: the grid shows it.
    """
    laws = list(dict.fromkeys(name for study in studies for name in distortion(study)))
    on = sheet(f"Field curvature{' and distortion' if laws else ''}", studies, 3.75)
    key(on, on.top - 0.06, line_handles(studies), 5)
    key(on, on.top - 0.28, way_handles(studies[0]))
    tall = on.top - 1.2
    left = panel(on.figure, 0.62, 0.5, 1.8 if laws else WIDE - 0.62, tall)
    factor, unit = unit_of(max(np.abs(study.focus_mm).max() for study in studies))
    for study, look in on.looks:
        for line, wavelength in enumerate(study.lines[0]):
            for way, dash in enumerate(DASHES):
                left.plot(
                    factor * study.focus_mm[:, line, way],
                    np.degrees(study.theta),
                    color=wavelength_colour(wavelength),
                    linestyle=dash,
                    **look,
                )
    left.set(title="focus", xlabel=f"from the image plane [{unit}]")
    against_field_up(left, studies)
    wide_enough(left)
    left.xaxis.set_major_locator(MaxNLocator(4))
    if laws:
        _draw_distortion(on, laws, panel(on.figure, 2.85, 0.5, 1.58, tall))
    return on.figure


def _draw_distortion(on: Sheet, laws: list[str], axes: Axes) -> None:
    for study, look in on.looks:
        for name, percent in distortion(study).items():
            dash = DASHES[laws.index(name)]
            axes.plot(percent, np.degrees(study.theta), color=INK, linestyle=dash, **look)
    # The first of two laws is drawn solid and the second dashed.
    axes.set(title=f"distortion, {', '.join(laws)}", xlabel="%")
    against_field_up(axes, on.studies)
    axes.set_ylabel("")
    wide_enough(axes, least=0.1)
    axes.xaxis.set_major_locator(MaxNLocator(4))


def distortion(study: Study) -> dict[str, np.ndarray]:
    """Return the distortion in percent by the law of projection, of a lens with an axis."""
    if not study.centred or len(study.fields) == 1:
        return {}
    _, primary = study.lines
    return distortions(np.degrees(study.theta), study.chief_um[:, primary])


def curvature_table(study: Study) -> dict[str, np.ndarray]:
    """Return tangential and sagittal focus by field and wavelength."""
    lines, _ = study.lines
    tangential, sagittal = (study.focus_mm[..., way].ravel() for way in (0, 1))
    return {
        "field_deg": np.repeat(np.degrees(study.theta), len(lines)),
        "wavelength_nm": np.tile(lines, len(study.theta)),
        "tangential_mm": tangential,
        "sagittal_mm": sagittal,
    }


def distortion_table(study: Study) -> dict[str, np.ndarray]:
    """Return the primary wavelength's chief rays and their distortion."""
    _, primary = study.lines
    names = {
        "f tan \N{GREEK SMALL LETTER THETA}": "f_tan_percent",
        "f \N{GREEK SMALL LETTER THETA}": "f_theta_percent",
    }
    return {
        "field_deg": np.degrees(study.theta),
        "image_y_mm": 1e-3 * study.chief_um[:, primary],
        **{names[name]: percent for name, percent in distortion(study).items()},
    }


def draw_longitudinal(studies: Sequence[Study]) -> Figure:
    """Draw focus against the zone of the stop, and the focus of close rays against wavelength."""
    on = sheet("Longitudinal colour", studies, 3.5)
    key(on, on.top - 0.06, line_handles(studies), 5)
    centred = [pair for pair in on.looks if pair[0].centred]
    wide = 1.6 if centred else 3.7
    right = panel(on.figure, WIDE - wide, 0.5, wide, on.top - 1.0)
    reach = max(np.abs(_shift_mm(study)).max() for study in studies)
    if centred:
        left = panel(on.figure, 0.62, 0.5, 1.55, on.top - 1.0)
        reach_left = max(np.nanmax(np.abs(study.zones_mm)) for study, _ in centred)
        factor, unit = unit_of(reach_left)
        for study, look in centred:
            for wavelength, curve in zip(study.lines[0], study.zones_mm, strict=True):
                left.plot(factor * curve, ZONES, color=wavelength_colour(wavelength), **look)
        left.axvline(0, color=SOFT, linewidth=0.7, zorder=0)
        left.set(
            title="by zone",
            xlabel=f"from the image plane [{unit}]",
            ylabel="height in the stop [radii]",
            ylim=(0, 1),
        )
        left.xaxis.set_major_locator(MaxNLocator(4))
        wide_enough(left)
    factor, unit = unit_of(reach)
    for study, look in on.looks:
        for way, dash in zip(range(1 if study.centred else 2), DASHES, strict=False):
            right.plot(
                factor * _shift_mm(study)[:, way],
                study.colour_nm,
                color=INK,
                linestyle=dash,
                **look,
            )
    right.axvline(0, color=SOFT, linewidth=0.7, zorder=0)
    nm = np.concatenate([study.colour_nm for study in studies])
    right.set(
        title="close to the axis",
        xlabel=f"from the primary's [{unit}]",
        ylabel="wavelength [nm]",
        ylim=(nm.min(), nm.max()),
    )
    right.xaxis.set_major_locator(MaxNLocator(4))
    wide_enough(right)
    return on.figure


def _shift_mm(study: Study) -> np.ndarray:
    """Return the focus of close rays from that of the primary wavelength, shape (W, 2)."""
    colour = study.colour_mm
    at = [np.interp(study.primary_nm, study.colour_nm, colour[:, way]) for way in (0, 1)]
    return colour - np.array(at)


def longitudinal_table(study: Study) -> dict[str, np.ndarray]:
    """Return the focus of close rays on the axis against wavelength, from the image plane."""
    return {
        "wavelength_nm": study.colour_nm,
        "tangential_mm": study.colour_mm[:, 0],
        "sagittal_mm": study.colour_mm[:, 1],
    }


def zone_table(study: Study) -> dict[str, np.ndarray]:
    """Return where rays of the axial beam cross the axis, by wavelength and zone of the stop."""
    lines, _ = study.lines
    if not study.centred:
        return {}
    return {
        "wavelength_nm": np.repeat(lines, len(ZONES)),
        "stop": np.tile(ZONES, len(lines)),
        "focus_mm": study.zones_mm.ravel(),
    }
