"""``gpusim export-web``."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.cli.render import rectangle_of
from gpusim.errors import UserError
from gpusim.library.expose import expose
from gpusim.scene import make_scene
from gpusim.sensor.sensor import Sensor
from gpusim.web.bundle import write_page

SIDES = 960, 720  # of the part of a larger sensor that is shown, pixels
MOST_PIXELS = 1_000_000  # the page develops a frame at once


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    *,
    tile: str | None,
    tolerance: str,
    probes: int | None,
    seed: int,
    show: bool,
) -> None:
    """Write the page of a camera before a scene into the folder `out`."""
    camera = load_camera(camera_name)
    rectangle = middle(camera.sensor) if tile is None else rectangle_of(tile)
    if rectangle[2] * rectangle[3] > MOST_PIXELS:
        raise UserError(
            "the page shows less than that",
            field="--tile",
            value=tile,
            allowed=f"{MOST_PIXELS:,} pixels at most",
        )
    scene = make_scene(scene_name, None, None, frame=camera.frame)
    with staging(out) as folder, screen.progress_bar(show) as progress:
        light = expose(camera, scene, tolerance, probes=probes, tile=rectangle, progress=progress)
        progress("files", 0, 1)
        write_page(light, folder, seed)
        light.capture(seed=seed).save(folder / "picture.png")
        light.release()
        progress("files", 1, 1)
    if show:
        Console().print(
            f"{out / 'index.html'}: open it in a browser that has WebGPU", soft_wrap=True
        )


def middle(sensor: Sensor) -> tuple[int, int, int, int]:
    """Return the whole sensor (x, y, width, height), or the middle of a larger one."""
    if sensor.rows * sensor.cols <= MOST_PIXELS:
        return 0, 0, sensor.cols, sensor.rows
    width, height = (
        min(most, have) for most, have in zip(SIDES, (sensor.cols, sensor.rows), strict=True)
    )
    return (sensor.cols - width) // 8 * 4, (sensor.rows - height) // 8 * 4, width, height
