"""Figures of chief rays: layout, distortion grid, lateral colour, and angles at the image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from gpusim.lens.section import beam, elements
from gpusim.report.drawing import SOFT, panel
from gpusim.report.lens.colours import PALETTE, wavelength_colour
from gpusim.report.lens.frame import (
    DASHES,
    DEGREE,
    MICRO,
    WIDTH,
    against_field_up,
    field_handles,
    key,
    line_handles,
    sheet,
    wide_enough,
)
from gpusim.report.lens.layout import draw_layout
from gpusim.report.lens.study import GRID, Study
from gpusim.report.lens_page import RAYS

_LAYOUT = 2.0


def draw_section(studies: Sequence[Study]) -> Figure:
    """Draw each lens to its own scale with the rays of its fields in the y-z plane."""
    on = sheet("Layout", studies, (_LAYOUT + 0.2) * len(studies) + 0.35, stacked=True)
    key(on, on.top - 0.06, field_handles(studies[0])[: len(_beams(studies[0]))], 3)
    for number, study in enumerate(studies):
        bottom = on.top - 0.25 - (_LAYOUT + 0.2) * (number + 1) + 0.1
        axes = panel(on.figure, 0.15, bottom, WIDTH - 0.3, _LAYOUT)
        image_um = float(np.abs(study.chief_um).max())
        draw_layout(axes, study.system, elements(study.system), _beams(study), image_um)
    return on.figure


def _beams(study: Study) -> list[np.ndarray]:
    lead = 0.12 * study.system.image_z_mm
    return [
        beam(study.system, field.theta, RAYS, lead) for field in study.fields if field.azimuth == 0
    ]


def layout_table(study: Study) -> dict[str, np.ndarray]:
    """Return where the drawn rays are: before the lens, at each surface, in the image plane."""
    fields = [field for field in study.fields if field.azimuth == 0]
    columns = {name: [] for name in ("field", "ray", "surface", "z_mm", "y_mm")}
    for field, paths in zip(fields, _beams(study), strict=True):
        places, many = paths.shape[:2]
        columns["field"].append(np.full(places * many, field.name))
        columns["ray"].append(np.tile(np.arange(1, many + 1), places))
        columns["surface"].append(np.repeat(np.arange(places), many))
        columns["z_mm"].append(paths[..., 0].ravel())
        columns["y_mm"].append(paths[..., 1].ravel())
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def draw_grid(studies: Sequence[Study]) -> Figure:
    """Draw a square grid of the object: the ideal image as lines, the real one as crosses."""
    side = 3.4
    on = sheet("Distortion grid", studies, side + 0.95 + 0.19 * (len(studies) - 1))
    handles = [
        Line2D([], [], color="#9aa3ad", label="ideal"),
        *[
            Line2D([], [], color=PALETTE[number], marker=mark, linestyle="", label=label)
            for number, (mark, label) in enumerate(
                zip(
                    "x+",
                    [f"real, up to {_off(study):.2g} % off" for study in studies],
                    strict=False,
                )
            )
        ],
    ]
    key(on, on.top - 0.06, handles, 2)
    axes = panel(on.figure, 0.75, 0.5, side, side)
    for number, study in enumerate(studies):
        ideal, real = study.grid
        for lines in (ideal, ideal.swapaxes(0, 1)):
            for line in lines:
                axes.plot(*line.T, color="#9aa3ad", linewidth=0.8 if number == 0 else 0.5, zorder=1)
        axes.plot(*real.reshape(-1, 2).T, "x+"[number], color=PALETTE[number], markersize=5)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.set_adjustable("datalim")
    axes.grid(False)
    axes.margins(0.06)
    return on.figure


def _off(study: Study) -> float:
    """Return how far the real grid lies off the ideal one at most, percent of the ideal's reach."""
    ideal, real = study.grid
    reach = np.linalg.norm(ideal - ideal[GRID // 2, GRID // 2], axis=-1).max()
    return 100 * float(np.linalg.norm(real - ideal, axis=-1).max() / max(reach, 1e-12))


def grid_table(study: Study) -> dict[str, np.ndarray]:
    """Return ideal and real places of the distortion grid."""
    ideal, real = study.grid
    row, column = np.divmod(np.arange(GRID * GRID), GRID)
    return {
        "row": row,
        "column": column,
        **{
            f"{name}_{axis}_mm": values[..., k].ravel()
            for name, values in (("ideal", ideal), ("real", real))
            for k, axis in enumerate("xy")
        },
    }


def draw_lateral(studies: Sequence[Study]) -> Figure:
    """Draw where the chief rays of each wavelength land beside the primary's."""
    on = sheet("Lateral colour", studies, 3.5)
    airy = Line2D([], [], color=SOFT, linestyle=DASHES[1], label="Airy radius")
    key(on, on.top - 0.06, [*line_handles(studies), airy], 4)
    axes = panel(on.figure, 0.62, 0.5, WIDTH - 0.82, on.top - 0.85)
    for study, look in on.looks:
        for wavelength, shift in zip(study.lines[0], _lateral_um(study).T, strict=True):
            colour = wavelength_colour(wavelength)
            axes.plot(shift, np.degrees(study.theta), color=colour, **look)
    for side in (-1, 1):
        axes.axvline(side * studies[0].airy_um, color=SOFT, linestyle=DASHES[1], linewidth=0.9)
    axes.set(xlabel=f"from the primary wavelength's chief ray [{MICRO}m]")
    against_field_up(axes, studies)
    wide_enough(axes, least=1.1 * studies[0].airy_um)
    return on.figure


def _lateral_um(study: Study) -> np.ndarray:
    _, primary = study.lines
    return study.chief_um - study.chief_um[:, [primary]]


def lateral_table(study: Study) -> dict[str, np.ndarray]:
    """Return where chief rays land and how far from the primary wavelength's."""
    lines, _ = study.lines
    return {
        "field_deg": np.repeat(np.degrees(study.theta), len(lines)),
        "wavelength_nm": np.tile(lines, len(study.theta)),
        "image_y_mm": 1e-3 * study.chief_um.ravel(),
        "lateral_colour_um": _lateral_um(study).ravel(),
    }


def draw_angles(studies: Sequence[Study]) -> Figure:
    """Draw the angles of chief and marginal rays over the image."""
    on = sheet("Ray angles at the image", studies, 3.4)
    handles = [
        Line2D([], [], color=PALETTE[0], label="chief ray"),
        Line2D([], [], color=PALETTE[1], label="upper and lower rim"),
        Line2D([], [], color=PALETTE[2], linestyle=DASHES[1], label="sagittal rim"),
    ]
    key(on, on.top - 0.06, handles)
    axes = panel(on.figure, 0.62, 0.52, WIDTH - 0.82, on.top - 0.85)
    axes.axhline(0, color=SOFT, linewidth=0.7)
    for study, look in on.looks:
        table = angle_table(study)
        height = table["image_y_mm"]
        axes.plot(height, table["chief_ray_deg"], color=PALETTE[0], **look)
        for name in ("upper_marginal_deg", "lower_marginal_deg"):
            axes.plot(height, table[name], color=PALETTE[1], **look)
        axes.plot(
            height, table["sagittal_marginal_deg"], color=PALETTE[2], linestyle=DASHES[1], **look
        )
    axes.set(xlabel="image height [mm]", ylabel=f"from the image's normal [{DEGREE}]")
    heights = np.concatenate([angle_table(study)["image_y_mm"] for study in studies])
    axes.set_xlim(heights.min(), heights.max() if np.ptp(heights) > 0 else 1.0)
    axes.yaxis.set_major_locator(MaxNLocator(6))
    return on.figure


def angle_table(study: Study) -> dict[str, np.ndarray]:
    """Return what a simulation of pixels asks of a lens, at the primary wavelength.

    Over the image height: the chief ray's angle, positive where light travels away from the axis;
    those of the rims along the field, of the sagittal rim, and working f-numbers both ways.
    """
    arrivals = study.arrivals
    return {
        "field_deg": np.degrees(study.arrival_theta),
        "wavelength_nm": np.full(len(arrivals), study.primary_nm),
        "image_x_mm": np.array([one.x_mm for one in arrivals]),
        "image_y_mm": np.array([one.y_mm for one in arrivals]),
        "chief_ray_deg": np.array([one.chief_deg for one in arrivals]),
        "upper_marginal_deg": np.array([one.upper_deg for one in arrivals]),
        "lower_marginal_deg": np.array([one.lower_deg for one in arrivals]),
        "sagittal_marginal_deg": np.array([one.sagittal_deg[0] for one in arrivals]),
        "sagittal_marginal_other_deg": np.array([one.sagittal_deg[1] for one in arrivals]),
        "f_number_tangential": np.array([one.f_numbers[0] for one in arrivals]),
        "f_number_sagittal": np.array([one.f_numbers[1] for one in arrivals]),
    }
