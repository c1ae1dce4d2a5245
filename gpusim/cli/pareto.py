"""``gpusim pareto``."""

from __future__ import annotations

import csv
import dataclasses
import json
import sys
from collections.abc import Callable, Mapping
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
from gpusim.pareto import CHOSEN, Point, Sweep, sweep
from gpusim.pareto.turns import KINDS
from gpusim.plan import Accuracy
from gpusim.report.pareto_figure import draw, png
from gpusim.report.words import NOTHING, duration, error, sigmas
from gpusim.scene import make_scene

if TYPE_CHECKING:
    from gpusim.camera import Camera
    from gpusim.scene.scene import Scene

# A sweep renders twenty plans a dozen times each.
REGION_PX = 512  # of the longer side, about the centre, unless the whole sensor is asked for
WORDS = {"frame": "of a prepared frame", "first": "of a first frame"}


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    *,
    exposure: str,
    tolerance: str,
    probes: int,
    whole: bool,
    best_effort: bool,
) -> int:
    """Sweep tolerances and knobs; write table, figure and facts into `out` and show the table.

    Returns
    -------
    int
        The exit code: 1 where the chosen plan does not meet the tolerance asked for.
    """
    exposure_s = exposure_seconds(exposure)
    accuracy = Accuracy.parse(tolerance, probes, best_effort=best_effort)
    if not probes:
        raise UserError("Errors are certified.", field="--certify", value=0, allowed="1 or more")
    camera = load_camera(camera_name)
    if not whole:
        camera = region(camera)
    scene = make_scene(scene_name, frame=camera.frame)
    device = default_device()
    with staging(out) as folder:
        with screen.progress_bar() as progress:
            found = sweep(camera, scene, accuracy, exposure_s, device=device, progress=progress)
        rows, cols = camera.sensor.rows, camera.sensor.cols
        adapter = device.report()
        certificate = found.certificate
        facts = (
            f"{cols} x {rows} px on {adapter['adapter']}; {certificate.probes} probes in float64, "
            f"{duration(certificate.seconds)} once for all plans; times: medians of {found.rounds} "
            "rounds through all plans"
        )
        write(
            found,
            folder,
            _facts(found, camera, scene, accuracy, exposure_s=exposure_s, adapter=adapter),
        )
        title = f"{scene.name}, {camera.title}"
        figure = draw(found.points, title, facts, accuracy.unit)
        (folder / "pareto.png").write_bytes(png(figure))
    console = Console()
    console.print(table(found.points, accuracy.unit))
    paths = (str(out / name) for name in ("pareto.csv", "pareto.json", "pareto.png"))
    for line in (*_verdict(found, accuracy), facts, *paths):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 0 if certificate.met else 1


def _verdict(found: Sweep, accuracy: Accuracy) -> list[str]:
    """Return what is said below the table, line by line."""
    say, certificate = _say(accuracy.unit), found.certificate
    lines = [f"{point.name}: {point.obstacle}" for point in found.points if point.obstacle]
    if found.shortfall:
        lines.append(f"best effort: {found.shortfall}")
    lines += [regret_in_words(found.points[0], kind) for kind in KINDS]
    met = "within" if certificate.met else "BEYOND"
    lines.append(
        f"certificate of the chosen plan: {met} the tolerance "
        f"of {accuracy.text}: total RMS {say(certificate.total_rms)}, "
        f"worst {say(certificate.total_worst)}"
    )
    return lines


def _facts(
    found: Sweep,
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    *,
    exposure_s: float,
    adapter: Mapping[str, Any],
) -> dict[str, Any]:
    """Return what pareto.json says beside the points."""
    chosen, certificate = found.points[0], found.certificate
    return {
        "gpusim": gpusim.__version__,
        "command": ["gpusim", *sys.argv[1:]],
        "camera": camera.title,
        "scene": scene.name,
        "rows": camera.sensor.rows,
        "cols": camera.sensor.cols,
        "exposure_s": exposure_s,
        "tolerance": accuracy.tolerance,
        "tolerance_unit": accuracy.unit,
        "device": {name: adapter[name] for name in ("adapter", "driver", "backend")},
        "probes": certificate.probes,
        "truth_s": certificate.seconds,
        "rounds": found.rounds,
        "met": certificate.met,
        "shortfall": found.shortfall,
        "regret": chosen.regret,
        "fastest": chosen.fastest,
        "first_regret": chosen.first_regret,
        "first_fastest": chosen.first_fastest,
    }


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


def regret_in_words(chosen: Point, kind: str) -> str:
    """Say what the chosen plan takes over the fastest known."""
    by_kind = {
        "frame": (chosen.regret, chosen.fastest),
        "first": (chosen.first_regret, chosen.first_fastest),
    }
    regret, fastest = by_kind[kind]
    if regret is None:
        return f"regret {WORDS[kind]}: none, the chosen plan does not meet the tolerance"
    if fastest == chosen.name:
        return f"regret {WORDS[kind]}: 1, no plan that is known to meet the tolerance is faster"
    return f'regret {WORDS[kind]}: {regret:.2f}, the time over that of "{fastest}"'


def table(points: tuple[Point, ...], unit: str) -> Table:
    """Return the points as a table, predicted next to certified.

    The spread is that between the quartiles, over the median; a "!" marks plans of the planner that
    do not meet their own tolerance.
    """
    head = ("", "plan", "frame", "spread", "first", "RMS", "worst", "predicted", "regret")
    shown = Table(*head, box=None, header_style="bold", pad_edge=False, padding=(0, 1, 0, 0))
    # Figures are not cut: on narrow terminals the names are folded.
    shown.columns[1].overflow = "fold"
    for column in shown.columns[2:]:
        column.justify, column.no_wrap = "right", True
    say = _say(unit)
    family = None
    for point in points:
        if point.family != family:
            family = point.family
            shown.add_row(Text(""), Text(family, style="bold"))
        mark = Text(">" if point.chosen else "")
        if point.obstacle:
            shown.add_row(mark, Text(point.name), NOTHING, style="dim")
            continue
        spread = (point.frame_high_s - point.frame_low_s) / point.frame_s
        missed = " !" if point.family == CHOSEN and not point.met else ""
        shown.add_row(
            mark,
            Text(point.name),
            duration(point.frame_s),
            f"{spread:.0%}",
            duration(point.first_s),
            say(point.total_rms).removesuffix(" sigma") + missed,
            say(point.total_worst).removesuffix(" sigma"),
            error(point.predicted),
            "" if point.regret is None else f"{point.regret:.2f}",
            style="bold" if point.chosen else "",
        )
    return shown


def _say(unit: str) -> Callable[[float | None], str]:
    return sigmas if unit == "sigma" else error
