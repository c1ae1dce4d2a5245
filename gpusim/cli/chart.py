"""``gpusim chart``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from rich.table import Table

from gpusim.cli.files import whole_file
from gpusim.config.names import perhaps
from gpusim.config.text import read_yaml
from gpusim.errors import UserError
from gpusim.scene import make_scene
from gpusim.scene.charts import CHARTS, FOLDER, is_chart
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.exr import write_exr
from gpusim.scene.preview import chart_rgb

# Rows of the drawing: those of the demonstration camera.
ROWS = 1520


def library() -> Table:
    """Return the charts that come with the package."""
    table = Table("chart", "", box=None, header_style="bold")
    for name in CHARTS:
        table.add_row(name, str(read_yaml(FOLDER / f"{name}.yaml", "the chart")["title"]))
    return table


def run(name: str, out: Path) -> None:
    """Draw a chart as the eye would see it, or as linear radiance."""
    if not is_chart(name):
        raise UserError(
            f"there is no chart of that name{perhaps(name, CHARTS)}",
            field="NAME",
            value=name,
            allowed=f"{', '.join(CHARTS)}, or a chart's file NAME.yaml",
        )
    with whole_file(out, (".png", ".exr")) as file:
        scene = make_scene(name)
        rgb = chart_rgb(scene, ROWS)
        if file.suffix.lower() == ".exr":
            write_exr(file, {"RGB": rgb}, scene.white_luminance_cd_m2)
        else:
            Image.fromarray(np.round(255 * encode_srgb(rgb)).astype(np.uint8)).save(file)
    print(out)
