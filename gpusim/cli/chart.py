"""``gpusim chart``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from rich.table import Table

from gpusim.cli.files import whole_file
from gpusim.cli.irradiance import bands_of
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.charts import CHARTS, FOLDER, is_chart
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.exr import write_exr
from gpusim.scene.preview import chart_radiance, chart_rgb
from gpusim.scene.spectral_exr import RADIANCE_UNITS, write_spectral_exr

# Rows of the drawing: those of the demonstration camera.
ROWS = 1520
SPECTRAL_ROWS = 380  # a quarter: 31 bands have 24 MB


def library() -> Table:
    """Return the charts that come with the package."""
    table = Table("chart", "", box=None, header_style="bold")
    for name in CHARTS:
        table.add_row(name, str(read_yaml(FOLDER / f"{name}.yaml", "the chart")["title"]))
    return table


def run(name: str, out: Path, bands: str | None) -> None:
    """Draw a chart as the eye would see it, or as linear radiance; with `bands` that of each."""
    if not is_chart(name):
        raise UserError(
            f"there is no chart of that name{perhaps(name, CHARTS)}",
            field="NAME",
            value=name,
            allowed=f"{', '.join(CHARTS)}, or a chart's file NAME.yaml",
        )
    lines = None if bands is None else bands_of(bands)
    with whole_file(out, (".png", ".exr") if lines is None else (".exr",)) as file:
        scene = make_scene(name)
        if lines is not None:
            radiance = chart_radiance(scene, SPECTRAL_ROWS, lines)
            write_spectral_exr(file, radiance, lines, RADIANCE_UNITS)
            print(out)
            return
        rgb = chart_rgb(scene, ROWS)
        if file.suffix.lower() == ".exr":
            write_exr(file, {"RGB": rgb}, scene.white_luminance_cd_m2)
        else:
            Image.fromarray(np.round(255 * encode_srgb(rgb)).astype(np.uint8)).save(file)
    print(out)
