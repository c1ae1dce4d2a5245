"""``gpusim render``."""

from __future__ import annotations

import json
import math
import re
import sys
import tempfile
import textwrap
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim import report
from gpusim.calibrate.rates import adapter_costs, planned_costs
from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.cli.labels import seen_maps
from gpusim.cli.labels import write as write_labels
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.isp.develop import develop
from gpusim.isp.dng import has_dng, write_dng
from gpusim.isp.files import write_picture
from gpusim.isp.quad import PERIOD, quad_phase, write_bayer
from gpusim.isp.rawfile import read_raw
from gpusim.isp.settings import check_ev
from gpusim.library.labels import in_raw
from gpusim.library.recipe import recipe_of_raw
from gpusim.optics.methods import check_method
from gpusim.plan import Accuracy
from gpusim.render import capture as take
from gpusim.render.planning import planning
from gpusim.scene import make_scene
from gpusim.scene.exr import write_exr
from gpusim.scene.illumination import unevenly_lit
from gpusim.sensor.readout import Shot

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np

    from gpusim.camera import Camera
    from gpusim.gpu import Device
    from gpusim.plan.costs import Costs
    from gpusim.render import Capture
    from gpusim.scene.scene import Scene

KEPT_PLANES = {"electrons": "e-", "rate": "e-/s"}  # and their units
LENS_OPTIONS = {
    "focal_length_mm": "--focal-length",
    "f_number": "--f-number",
    "object_distance_m": "--object-distance",
    "focus_distance_m": "--focus-distance",
    "focus_shift_um": "--focus-shift",
}


@dataclass(frozen=True)
class RenderOptions:
    """What is asked of a render, as the command line writes it: see `gpusim render --help`.

    ``lens`` and ``sensor`` stand in place of the camera's: see `load_camera`.
    """

    exposure: str
    temperature_c: float | None
    luminance_cd_m2: float | None
    illuminant: str | None
    illumination: Path | None
    transfer: str | None
    upsampling: str | None
    chart_height: str | None
    projection: str
    labels: tuple[Path, ...]
    tolerance: str
    probes: int | None
    gain: float | None
    iso: int | None
    ev: float
    seed: int
    frame: int
    tile: str | None
    tile_px: int | None
    memory: str | None
    keep: str
    noise: bool
    method: str | None
    plan: Path | None
    best_effort: bool
    lens: Mapping[str, float | None]
    sensor: str | None


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    asked: RenderOptions,
    *,
    dry_run: bool,
    show: str,
) -> int:
    """Render one capture into the folder `out` and show what was done; return the exit code.

    `dry_run`: show the plan, and neither render nor write. `show`: "table", "json" or "nothing".
    """
    exposure_s = exposure_seconds(asked.exposure)
    planes = kept_planes(asked.keep)
    rectangle = None if asked.tile is None else rectangle_of(asked.tile)
    memory_bytes = None if asked.memory is None else bytes_of(asked.memory)
    accuracy = Accuracy.parse(asked.tolerance, asked.probes, best_effort=asked.best_effort)
    camera = _camera(camera_name, asked)
    check_ev(asked.ev)
    check_method(asked.method)  # before the lens is traced
    camera.sensor.dark_current_at(asked.temperature_c)  # refuses what is no temperature
    scene = _scene(scene_name, camera, asked)
    labels = {} if dry_run else seen_maps(asked.labels, camera, asked.projection)
    costs = None if asked.plan is None else planned_costs(asked.plan)
    device = default_device()
    planned = {"noise": asked.noise, "method": asked.method, "exposure_s": exposure_s}
    if dry_run:
        print(_plan_text(device, camera, scene, accuracy, costs, **planned))
        return 0
    with staging(out) as folder:
        with (
            screen.progress_bar(show != "nothing") as progress,
            tempfile.TemporaryDirectory(prefix="planes-", dir=folder) as work,
        ):
            capture = take(
                camera,
                scene,
                **planned,
                seed=asked.seed,
                frame=asked.frame,
                temperature_c=asked.temperature_c,
                accuracy=accuracy,
                memory_bytes=memory_bytes,
                tile=rectangle,
                tile_px=asked.tile_px,
                keep=planes,
                folder=Path(work),
                costs=costs,
                progress=progress,
            )
            progress("files", 0, 1)
            facts = write(capture, folder, asked.ev, labels)
            del capture  # its arrays are files of `work`
            progress("files", 1, 1)
    if show == "json":
        print(json.dumps(facts, indent=1, allow_nan=False))
    elif show == "table":
        screen.show_capture(facts, out)
    return 0 if facts["certificate"] is None or facts["certificate"]["met"] else 1


def _camera(name: str, asked: RenderOptions) -> Camera:
    """Return the camera, at the gain or the ISO speed that is asked for."""
    changes = {name: value for name, value in asked.lens.items() if value is not None}
    try:
        camera, gain, iso = load_camera(name, changes, asked.sensor), asked.gain, asked.iso
    except UserError as error:
        changed = (error.field or "").removeprefix("lens.")
        if changed in changes:  # it was typed: the camera's file is not to blame
            error.file, error.field = None, LENS_OPTIONS[changed]
        raise
    if gain is not None and iso is not None:
        raise UserError("both name the gain", field="--iso", value=iso, allowed="--gain or --iso")
    if gain is not None:
        return replace(camera, sensor=camera.sensor.at_gain(gain))
    if iso is not None:
        return replace(camera, sensor=camera.sensor.at_iso(iso))
    return camera


def _scene(name: str, camera: Camera, asked: RenderOptions) -> Scene:
    """Return the scene, in the light that is asked for."""
    scene = make_scene(
        name,
        asked.luminance_cd_m2,
        asked.illuminant,
        asked.projection,
        camera.frame,
        transfer=asked.transfer,
        upsampling=asked.upsampling,
        chart_height=asked.chart_height,
    )
    return scene if asked.illumination is None else unevenly_lit(scene, asked.illumination)


def _plan_text(
    device: Device,
    camera: Camera,
    scene: Scene,
    accuracy: Accuracy,
    costs: Costs | None,
    *,
    noise: bool,
    method: str | None,
    exposure_s: float,
) -> str:
    """Return the plan of a render in words; by the adapter's own rates where there are no costs."""
    with screen.progress_bar() as progress:
        costs = costs or adapter_costs(
            device, progress=lambda done, total: progress("calibrate", done, total)
        )
        found = planning(
            camera,
            scene,
            accuracy,
            costs,
            noise=noise,
            method=method,
            exposure_s=exposure_s,
            progress=lambda done, total: progress("lens", done, total),
        )
        progress("plan", 0, 1)
        text = found.plan(method).text()
    told = [textwrap.fill(f"{found.afforded}.")] if found.afforded else []
    return "\n".join([text, *told])


def exposure_seconds(text: str) -> float:
    """Return the exposure time that `text` names, as a decimal number or as a fraction."""
    above, slash, below = text.partition("/")
    try:
        seconds = float(above) / (float(below) if slash else 1.0)
    except (ValueError, ZeroDivisionError):
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise UserError(
            "the exposure time is not a positive number of seconds",
            field="--exposure",
            value=text,
            allowed="a number or a fraction above 0: 0.01, 2, 1/60",
        )
    return seconds


def rectangle_of(text: str) -> tuple[int, int, int, int]:
    """Return the rectangle x, y, width, height that `text` names."""
    if not re.fullmatch(r"\s*\d{1,9}\s*(,\s*\d{1,9}\s*){3}", text, re.ASCII):
        raise UserError(
            "the tile is not a rectangle of pixels",
            field="--tile",
            value=text,
            allowed="four whole numbers x,y,width,height: 1000,760,256,256",
        )
    x, y, width, height = (int(part) for part in text.split(","))
    return x, y, width, height


def bytes_of(text: str) -> int:
    """Return the memory that `text` names."""
    found = re.fullmatch(r"\s*(\d{1,9}(?:\.\d*)?)\s*([MG]i?B)\s*", text, re.IGNORECASE | re.ASCII)
    nbytes = 0
    if found:
        base = 1024 if "i" in found[2].lower() else 1000
        nbytes = int(float(found[1]) * base ** (2 if found[2][0] in "mM" else 3))
    if nbytes < 1:
        raise UserError(
            "the memory is not a size",
            field="--memory",
            value=text,
            allowed="a number above 0 and its unit: 512MiB, 1.5GiB, 800MB",
        )
    return nbytes


def kept_planes(text: str) -> tuple[str, ...]:
    """Return the names of planes in a list with commas."""
    planes = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in planes:
        if name not in KEPT_PLANES:
            raise UserError(
                "there is no such plane to keep",
                field="--keep",
                value=name,
                allowed=", ".join(KEPT_PLANES),
            )
    return planes


def write(
    capture: Capture,
    folder: Path,
    ev: float = 0.0,
    labels: Mapping[str, np.ndarray] | None = None,
) -> dict[str, Any]:
    """Write all files of a capture into `folder`; return the facts of the report.

    The picture is shown brighter by `ev` stops, and the raw's BaselineExposure says so. A quad
    Bayer sensor gives a Bayer raw of all pixels and one of all cells besides, and a picture of
    each. `labels`: maps on the lit pixels of the sensor, by the names of their files.
    """
    planes = {name: getattr(capture, name) for name in KEPT_PLANES}
    kept = {f"{name}.exr": plane for name, plane in planes.items() if plane is not None}
    areas = capture.areas
    sensor = capture.camera.sensor.cut(*areas.lit[:2])
    raw = "raw.dng" if has_dng(sensor) else "raw.tif"
    taken = datetime.now(UTC)
    names = [raw, "developed.png", "report.json", "report.html"]
    write_dng(
        folder / raw,
        capture.raw,
        sensor,
        active_area=areas.active,
        masked_areas=areas.masked,
        white_e=capture.white_e,
        exposure_s=capture.exposure_s,
        transmission=capture.transmission,
        optics=capture.optics,
        place=areas.lit[:2],
        temperature_c=capture.temperature_c,
        ev=ev,
        taken=taken,
    )
    developed = develop(folder / raw).picture
    write_picture(folder / "developed.png", developed)
    if quad_phase(sensor.cfa.letters) is not None and min(areas.lit[2:]) >= 2 * PERIOD:
        frame = read_raw(folder / raw)
        for kind in ("remosaiced", "binned"):
            write_bayer(frame, folder / f"{kind}.dng", binned=kind == "binned")
        write_picture(folder / "binned.png", develop(folder / "binned.dng").picture)
        names += ["remosaiced.dng", "binned.dng", "binned.png"]
    for name, plane in kept.items():
        write_exr(folder / name, {"Y": plane}, units=KEPT_PLANES[Path(name).stem])
    names += kept
    for name, seen in (labels or {}).items():
        write_labels(folder / name, in_raw(seen, areas, capture.raw.shape), "--labels")
        names.append(name)
    facts = report.facts(capture, files=names, command=["gpusim", *sys.argv[1:]])
    facts["recipe"] = recipe_of_raw(
        capture.recipe,
        capture.camera.sensor,
        capture.recipe,
        capture.rect,
        Shot(capture.exposure_s, capture.seed, capture.frame, capture.temperature_c),
        raw=folder / raw,
        noise=capture.recipe["noise"],
        ev=ev,
        taken=taken,
    )
    facts["patches"] = report.patch_facts(capture, developed)
    (folder / "report.json").write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n")
    (folder / "report.html").write_text(
        report.page(facts, developed, capture.psfs), encoding="utf-8"
    )
    return facts
