"""All single figures of a lens, by name, and their numbers as files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from gpusim.report import drawing
from gpusim.report.lens import fans, focal, frame, geometry, spots, white
from gpusim.report.lens.study import Study

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Plot:
    """A figure and its numbers.

    Attributes
    ----------
    name : str
        Name of its file.
    title : str
    draw : callable
        From one or two studies to a figure; the second lens is laid over the first or drawn below.
    tables : dict of str to callable
        By name of the file, from a study to columns of one length with units in their names; none
        where the lens has no such numbers.
    """

    name: str
    title: str
    draw: Callable[[Sequence[Study]], Figure]
    tables: dict[str, Callable[[Study], Columns]]


PLOTS = (
    Plot("layout", "Layout", geometry.draw_section, {"layout": geometry.layout_table}),
    Plot("ray-fans", "Ray fans", fans.draw_ray_fans, {"ray-fans": fans.ray_fan_table}),
    Plot("opd-fans", "OPD fans", fans.draw_opd_fans, {"opd-fans": fans.opd_fan_table}),
    Plot("spots", "Spot diagrams", spots.draw_spots, {"spots": spots.spot_table}),
    Plot(
        "wavefront",
        "Wavefront maps and Zernike terms",
        spots.draw_wavefronts,
        {"wavefront": spots.wavefront_table, "zernike": spots.zernike_table},
    ),
    Plot(
        "field-curvature",
        "Field curvature, astigmatism and distortion",
        focal.draw_curvature,
        {"field-curvature": focal.curvature_table, "distortion": focal.distortion_table},
    ),
    Plot(
        "longitudinal-colour",
        "Longitudinal colour",
        focal.draw_longitudinal,
        {
            "longitudinal-colour": focal.longitudinal_table,
            "longitudinal-aberration": focal.zone_table,
        },
    ),
    Plot(
        "lateral-colour",
        "Lateral colour",
        geometry.draw_lateral,
        {"lateral-colour": geometry.lateral_table},
    ),
    Plot(
        "distortion-grid",
        "Distortion grid",
        geometry.draw_grid,
        {"distortion-grid": geometry.grid_table},
    ),
    Plot("mtf", "MTF against frequency", white.draw_mtf_curves, {"mtf": white.mtf_table}),
    Plot(
        "mtf-field",
        "MTF against field",
        white.draw_mtf_over_field,
        {"mtf-field": white.mtf_over_field_table},
    ),
    Plot(
        "mtf-focus",
        "MTF through focus",
        white.draw_through_focus,
        {"mtf-focus": white.through_focus_table},
    ),
    Plot(
        "encircled-energy",
        "Encircled energy",
        white.draw_energy,
        {"encircled-energy": white.energy_table},
    ),
    Plot(
        "illumination",
        "Relative illumination",
        white.draw_illumination,
        {"illumination": white.illumination_table},
    ),
    Plot(
        "angles", "Ray angles at the image", geometry.draw_angles, {"angles": geometry.angle_table}
    ),
)


def draw_plot(plot: Plot, studies: Sequence[Study]) -> Figure:
    """Return a figure in the style of the package."""
    with matplotlib.rc_context(drawing.STYLE | frame.STYLE):
        return plot.draw(studies)


def tables(plot: Plot, studies: Sequence[Study]) -> dict[str, Columns]:
    """Return a figure's numbers by name; of two lenses, the first column says which."""
    found = {}
    for name, table in plot.tables.items():
        each = [_with_angles(table(study), study) for study in studies]
        each = [columns for columns in each if columns]
        if not each:
            continue
        if len(studies) > 1:
            for study, columns in zip(studies, each, strict=False):
                size = len(next(iter(columns.values())))
                columns["lens"] = np.full(size, study.label)
        names = dict.fromkeys(
            name for columns in each for name in ("lens", *columns) if name in columns
        )
        found[name] = {
            column: np.concatenate([_column(columns, column) for columns in each])
            for column in names
        }
    return found


def _with_angles(columns: Columns, study: Study) -> Columns:
    """Return a table with the angles beside the names of its fields."""
    if "field" not in columns:
        return columns
    angle = {field.name: (field.degrees, np.degrees(field.azimuth)) for field in study.fields}
    pairs = np.array([angle[name] for name in columns["field"]])
    beside = {"field_deg": pairs[:, 0]}
    if not study.centred:
        beside["azimuth_deg"] = pairs[:, 1]
    return {"field": columns["field"], **beside, **columns}


def _column(columns: Columns, name: str) -> np.ndarray:
    size = len(next(iter(columns.values())))
    return columns.get(name, np.full(size, np.nan))


def csv_text(columns: Columns) -> str:
    """Return a table as CSV: names in the first line, numbers to 10 digits, none where NaN."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for row in zip(*(values.tolist() for values in columns.values()), strict=True):
        writer.writerow([_cell(value) for value in row])
    return file.getvalue()


def _cell(value: object) -> object:
    if not isinstance(value, float):
        return value
    return "" if np.isnan(value) else f"{value:.10g}"


def json_text(studies: Sequence[Study]) -> str:
    """Return the numbers of all figures, by figure and table, with what was analysed."""
    figures: dict[str, Any] = {}
    for plot in PLOTS:
        figures[plot.name] = {
            "title": plot.title,
            "tables": {
                name: {column: _plain(values) for column, values in columns.items()}
                for name, columns in tables(plot, studies).items()
            },
        }
    lenses = [
        {
            "label": study.label,
            "title": study.system.prescription.title,
            "history": list(study.system.prescription.history),
            "wavelengths_nm": study.lines[0].tolist(),
            "primary_nm": study.primary_nm,
            "frequency_cy_mm": study.frequency,
        }
        for study in studies
    ]
    return json.dumps({"lenses": lenses, "figures": figures}, allow_nan=False)


def _plain(values: np.ndarray) -> list:
    listed = values.tolist()
    return [None if isinstance(one, float) and np.isnan(one) else one for one in listed]
