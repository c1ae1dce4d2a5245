"""Figures of white light: MTF over frequency, field and focus, encircled energy, illumination."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from scipy.interpolate import PchipInterpolator

from gpusim.report.drawing import INK, SOFT, panel
from gpusim.report.lens.colours import PALETTE
from gpusim.report.lens.frame import (
    DASHES,
    MICRO,
    WIDTH,
    Sheet,
    against_field,
    field_handles,
    key,
    sheet,
    unit_of,
    way_handles,
)
from gpusim.report.lens.study import Study
from gpusim.report.lens_page import round_above

_LIMIT = {"color": "#9aa3ad", "linewidth": 1.2, "linestyle": ":"}
_LIMIT_HANDLE = Line2D([], [], label="diffraction limit", **_LIMIT)


def _one(on: Sheet, above: float) -> Axes:
    """Return the only panel of a sheet."""
    return panel(on.figure, 0.62, 0.52, WIDTH - 0.82, on.top - 0.52 - above)


def draw_mtf_curves(studies: Sequence[Study]) -> Figure:
    """Draw the MTF against frequency."""
    on = sheet("MTF against frequency", studies, 3.4)
    key(on, on.top - 0.06, field_handles(studies[0]), 3)
    key(
        on,
        on.top - (0.28 if len(studies[0].fields) < 4 else 0.42),
        [*way_handles(studies[0]), _LIMIT_HANDLE],
    )
    axes = _one(on, 0.52 if len(studies[0].fields) < 4 else 0.66)
    for study, look in on.looks:
        axes.plot(study.frequencies, study.limit, **_LIMIT)
        for number, curves in enumerate(study.mtf):
            _pair(axes, study.frequencies, curves, PALETTE[number], look)
    top = max(study.frequencies[-1] for study in studies)
    axes.set(xlabel="spatial frequency [cycles/mm]", ylabel="MTF", xlim=(0, top), ylim=(0, 1.02))
    return on.figure


def _pair(axes: Axes, x: np.ndarray, curves: np.ndarray, colour: str, look: dict) -> None:
    for curve, dash in zip(curves, DASHES, strict=True):
        axes.plot(x, curve, color=colour, linestyle=dash, **look)


def mtf_table(study: Study) -> dict[str, np.ndarray]:
    """Return the MTF of each field and the diffraction limit against frequency."""
    many, count = len(study.fields), len(study.frequencies)
    return {
        "field": np.repeat([field.name for field in study.fields], count),
        "frequency_cy_mm": np.tile(study.frequencies, many),
        "tangential": study.mtf[:, 0].ravel(),
        "sagittal": study.mtf[:, 1].ravel(),
        "diffraction_limit": np.tile(study.limit, many),
    }


def draw_mtf_over_field(studies: Sequence[Study]) -> Figure:
    """Draw the MTF at three frequencies over the field."""
    on = sheet("MTF against field", studies, 3.4)
    wanted = studies[0].contrast_frequencies
    key(
        on,
        on.top - 0.06,
        [
            Line2D([], [], color=colour, label=f"{f:.4g} cycles/mm")
            for f, colour in zip(wanted, PALETTE, strict=False)
        ],
    )
    key(on, on.top - 0.28, way_handles(studies[0]))
    axes = _one(on, 0.52)
    for study, look in on.looks:
        degrees = np.degrees(study.contrast_theta)
        mtf = np.array([one.mtf for one in study.across])
        fine = np.linspace(degrees[0], degrees[-1], 121)
        for k, colour in enumerate(PALETTE[: len(wanted)]):
            curves = [
                PchipInterpolator(degrees, mtf[:, way, k])(fine) if degrees[-1] else mtf[0, way, k]
                for way in (0, 1)
            ]
            _pair(axes, fine, np.broadcast_to(curves, (2, 121)), colour, look)
    axes.set(ylabel="MTF", ylim=(0, 1.02))
    against_field(axes, studies)
    return on.figure


def mtf_over_field_table(study: Study) -> dict[str, np.ndarray]:
    """Return the MTF at three frequencies over the field."""
    wanted = study.contrast_frequencies
    mtf = np.array([one.mtf for one in study.across])
    return {
        "field_deg": np.repeat(np.degrees(study.contrast_theta), len(wanted)),
        "frequency_cy_mm": np.tile(wanted, len(mtf)),
        "tangential": mtf[:, 0].ravel(),
        "sagittal": mtf[:, 1].ravel(),
    }


def draw_through_focus(studies: Sequence[Study]) -> Figure:
    """Draw the MTF at the chosen frequency against the place of the image plane."""
    on = sheet(f"MTF through focus at {studies[0].frequency:.4g} cycles/mm", studies, 3.4)
    many = len(studies[0].fields) > 3
    key(on, on.top - 0.06, field_handles(studies[0]), 3)
    key(on, on.top - (0.42 if many else 0.28), way_handles(studies[0]))
    axes = _one(on, 0.66 if many else 0.52)
    reach = max(study.depth_mm[-1] for study in studies)
    factor, unit = unit_of(reach)
    axes.axvline(0, color=SOFT, linewidth=0.7)
    for study, look in on.looks:
        for number, curves in enumerate(study.through_focus):
            _pair(axes, factor * study.depth_mm, curves, PALETTE[number], look)
    axes.set(
        xlabel=f"shift of the image plane away from the lens [{unit}]",
        ylabel="MTF",
        xlim=(-factor * reach, factor * reach),
        ylim=(0, 1.02),
    )
    axes.xaxis.set_major_locator(MaxNLocator(6))
    return on.figure


def through_focus_table(study: Study) -> dict[str, np.ndarray]:
    """Return the MTF at the chosen frequency against the place of the image plane."""
    many, count = len(study.fields), len(study.depth_mm)
    return {
        "field": np.repeat([field.name for field in study.fields], count),
        "frequency_cy_mm": np.full(many * count, study.frequency),
        "shift_mm": np.tile(study.depth_mm, many),
        "tangential": study.through_focus[:, 0].ravel(),
        "sagittal": study.through_focus[:, 1].ravel(),
    }


def draw_energy(studies: Sequence[Study]) -> Figure:
    """Draw the encircled energy, as far as the worst field needs for nine tenths."""
    on = sheet("Encircled energy", studies, 3.3)
    many = len(studies[0].fields) > 3
    key(on, on.top - 0.06, field_handles(studies[0]), 3)
    key(on, on.top - (0.42 if many else 0.28), [_LIMIT_HANDLE])
    axes = _one(on, 0.66 if many else 0.52)
    needed = 0.0
    for study, look in on.looks:
        axes.plot(study.radius_um, study.encircled_limit, **_LIMIT)
        for number, curve in enumerate(study.encircled):
            axes.plot(study.radius_um, curve, color=PALETTE[number], **look)
            needed = max(needed, float(np.interp(0.9, curve, study.radius_um)))
    axes.set(
        xlabel=f"radius about the centre of mass [{MICRO}m]",
        ylabel="share of the light",
        xlim=(0, round_above(needed)),
        ylim=(0, 1.02),
    )
    return on.figure


def energy_table(study: Study) -> dict[str, np.ndarray]:
    """Return the encircled energy of each field and of a perfect lens."""
    many, count = len(study.fields), len(study.radius_um)
    return {
        "field": np.repeat([field.name for field in study.fields], count),
        "radius_um": np.tile(study.radius_um, many),
        "share": study.encircled.ravel(),
        "diffraction_limit": np.tile(study.encircled_limit, many),
    }


def draw_illumination(studies: Sequence[Study]) -> Figure:
    """Draw the relative illumination beside the cos^4 law."""
    on = sheet("Relative illumination at 550 nm", studies, 3.0)
    law = {"color": "#9aa3ad", "linewidth": 1.2, "linestyle": ":"}
    key(
        on,
        on.top - 0.06,
        [Line2D([], [], color=INK, label="traced"), Line2D([], [], label="cos$^4$", **law)],
    )
    axes = _one(on, 0.3)
    for study, look in on.looks:
        degrees = np.degrees(study.contrast_theta)
        axes.plot(degrees, study.illumination, color=INK, **look)
        fine = np.linspace(degrees[0], degrees[-1], 121)
        axes.plot(fine, np.maximum(np.cos(np.radians(fine)), 0) ** 4, **law)
    axes.set(ylabel="of the middle's", ylim=(0, max(1.02, axes.dataLim.y1 * 1.02)))
    against_field(axes, studies)
    return on.figure


def illumination_table(study: Study) -> dict[str, np.ndarray]:
    """Return the relative illumination over the field."""
    return {
        "field_deg": np.degrees(study.contrast_theta),
        "relative_illumination": study.illumination,
    }
