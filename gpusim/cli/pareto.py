"""``gpusim pareto``."""

from __future__ import annotations

import csv
import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

import gpusim
from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.cli.render import exposure_seconds
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.pareto import Point, Sweep, sweep
from gpusim.plan import Accuracy
from gpusim.report.pareto_figure import draw, png
from gpusim.report.words import NOTHING, duration, error, sigmas
from gpusim.scene import make_scene

if TYPE_CHECKING:
    from gpusim.camera import Camera

# A sweep renders twenty plans three times each.
REGION_PX = 512  # of the longer side, about the centre, unless the whole sensor is asked for


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    *,
    exposure: str,
    tolerance: str,
    probes: int,
    whole: bool,
) -> None:
    """Sweep tolerances and knobs; write table, figure and facts into `out` and show the table."""
    exposure_s = exposure_seconds(exposure)
    accuracy = Accuracy.parse(tolerance, probes)
    if not probes:
        raise UserError("Errors are certified.", field="--certify", value=0, allowed="1 or more")
    camera = load_camera(camera_name)
    if not whole:
        camera = region(camera)
    scene = make_scene(scene_name)
    device = default_device()
    with staging(out) as folder:
        with screen.progress_bar() as progress:
            found = sweep(camera, scene, accuracy, exposure_s, device, progress)
        rows, cols = camera.sensor.rows, camera.sensor.cols
        adapter = device.report()
        facts = (
            f"{cols} x {rows} px on {adapter['adapter']}; {found.probes} probes in float64, "
            f"{duration(found.truth_s)} once for all plans"
        )
        write(found, folder, {
            "gpusim": gpusim.__version__,
            "command": ["gpusim", *sys.argv[1:]],
            "camera": camera.title,
            "scene": scene.name,
            "rows": rows,
            "cols": cols,
            "exposure_s": exposure_s,
            "tolerance": accuracy.tolerance,
            "tolerance_unit": accuracy.unit,
            "device": {name: adapter[name] for name in ("adapter", "driver", "backend")},
            "probes": found.probes,
            "truth_s": found.truth_s,
        })  # fmt: skip
        title = f"{scene.name}, {camera.title}"
        figure = draw(found.points, title, facts, accuracy.unit, accuracy.tolerance)
        (folder / "pareto.png").write_bytes(png(figure))
    console = Console()
    console.print(table(found.points))
    for point in found.points:
        if point.obstacle:
            console.print(f"{point.name}: {point.obstacle}", markup=False, soft_wrap=True)
    console.print(facts, markup=False, highlight=False, soft_wrap=True)
    for name in ("pareto.csv", "pareto.json", "pareto.png"):
        console.print(str(out / name), markup=False, highlight=False, soft_wrap=True)


def region(camera: Camera) -> Camera:
    """Return the camera with a piece of its sensor, about the centre, of the sensor's shape."""
    sensor = camera.sensor
    share = min(1.0, REGION_PX / max(sensor.rows, sensor.cols))
    rows, cols = (max(1, round(side * share)) for side in (sensor.rows, sensor.cols))
    return dataclasses.replace(camera, sensor=sensor.roi(rows, cols))


def write(found: Sweep, folder: Path, facts: dict[str, Any]) -> None:
    """Write the points as a table of commas, and with all facts as JSON."""
    names = [field.name for field in dataclasses.fields(Point)]
    with (folder / "pareto.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(dataclasses.asdict(point) for point in found.points)
    points = [dataclasses.asdict(point) for point in found.points]
    text = json.dumps({**facts, "points": points}, indent=1, allow_nan=False)
    (folder / "pareto.json").write_text(text + "\n")


def table(points: tuple[Point, ...]) -> Table:
    """Return the points as a table, predicted next to certified."""
    head = ("", "plan", "time", "RMS", "worst", "predicted", "sigma", "nodes")
    shown = Table(*head, box=None, header_style="bold", pad_edge=False)
    shown.columns[1].no_wrap = True
    for column in (2, 3, 4, 5, 6):
        shown.columns[column].justify = "right"
    family = None
    for point in points:
        if point.family != family:
            family = point.family
            shown.add_row(Text(""), Text(family, style="bold"))
        mark = Text(">" if point.chosen else "")
        if point.obstacle:
            shown.add_row(mark, Text(point.name), NOTHING, style="dim")
            continue
        shown.add_row(
            mark,
            Text(point.name),
            duration(point.wall_s),
            error(point.rms_relative),
            error(point.worst_relative),
            error(point.predicted),
            sigmas(point.rms_sigma).removesuffix(" sigma"),
            Text(point.nodes.replace(" x ", "x")),
            style="bold" if point.chosen else "",
        )
    return shown
