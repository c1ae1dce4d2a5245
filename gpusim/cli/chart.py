"""``gpusim chart``."""

from __future__ import annotations

from collections.abc import Mapping
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
from gpusim.scene.bands import checked_size
from gpusim.scene.charts import CHARTS, FOLDER, is_chart
from gpusim.scene.colorimetry import encode_srgb
from gpusim.scene.exr import write_exr
from gpusim.scene.pictures import is_picture
from gpusim.scene.preview import chart_radiance, chart_rgb, picture_radiance
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


def run(name: str, out: Path, bands: str | None, **light: str | float | None) -> None:
    """Draw a chart as the eye would see it, or as linear radiance.

    With `bands` the spectral radiance of a chart or of a picture; `light`: as of `make_scene`.
    """
    if bands is not None:
        _write_bands(name, out, bands_of(bands), light)
        return
    _check_chart(name)
    with whole_file(out, (".png", ".exr")) as file:
        scene = make_scene(name, **light)
        rgb = chart_rgb(scene, ROWS)
        if file.suffix.lower() == ".exr":
            write_exr(file, {"RGB": rgb}, scene.white_luminance_cd_m2)
        else:
            Image.fromarray(np.round(255 * encode_srgb(rgb)).astype(np.uint8)).save(file)
    print(out)


def _check_chart(name: str) -> None:
    """Refuse what is no chart."""
    if is_picture(Path(name)):
        raise UserError(
            "a picture is no chart", field="NAME", value=name,
            allowed="with --bands, which writes its spectral radiance; or a chart",
        )  # fmt: skip
    if not is_chart(name):
        raise UserError(
            f"there is no chart of that name{perhaps(name, CHARTS)}",
            field="NAME",
            value=name,
            allowed=f"{', '.join(CHARTS)}, or a chart's file NAME.yaml",
        )


def _write_bands(
    name: str, out: Path, lines: np.ndarray, light: Mapping[str, str | float | None]
) -> None:
    """Write the spectral radiance of a chart or picture at wavelengths, nm."""
    if not is_picture(Path(name)):
        _check_chart(name)
    with whole_file(out, (".exr",)) as file:
        scene = make_scene(name, **light)
        first = max(scene.known, key=lambda one: one.first_nm)
        last = min(scene.known, key=lambda one: one.last_nm)
        if lines.min() < first.first_nm or lines.max() > last.last_nm:
            beyond = first if lines.min() < first.first_nm else last
            raise UserError(
                f"bands beyond the data: {beyond.what}",
                field="--bands",
                value=f"{lines.min():g} to {lines.max():g} nm",
                allowed=f"{first.first_nm:g} to {last.last_nm:g} nm",
            )
        if is_chart(name):
            radiance = chart_radiance(scene, SPECTRAL_ROWS, lines)
        else:
            checked_size(out, (lines.size, *scene.source.planes.shape[1:]))
            radiance = picture_radiance(scene, lines)
        write_spectral_exr(file, radiance, lines, RADIANCE_UNITS)
    print(out)
