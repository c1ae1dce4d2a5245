"""``gpusim cameras``."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from gpusim.camera import load_camera, presets


def library() -> Table:
    """Return the cameras that come with the package."""
    table = Table("camera", "pixels", "sensor", "lens", "", box=None, header_style="bold")
    for name in presets():
        camera = load_camera(name)
        sensor = camera.sensor
        table.add_row(
            name,
            f"{sensor.cols} x {sensor.rows}",
            Text(sensor.name),
            Text(camera.lens.title),
            Text(camera.title),
        )
    return table
