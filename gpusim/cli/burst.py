"""``gpusim burst``."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image, ImageDraw
from rich.console import Console

from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.cli.render import exposure_seconds, rectangle_of
from gpusim.errors import UserError
from gpusim.library.expose import expose
from gpusim.library.recipe import recipe_of_frame
from gpusim.scene import make_scene
from gpusim.scene.exr import write_exr

if TYPE_CHECKING:
    from gpusim.library.burst import Burst

LIGHT = "light.json"  # what makes the light again, which the frames share
FORMATS = ("npz", "dng", "exr")
MOST_FRAMES = 10_000  # their numbers have four digits in the names of files
THUMBNAIL_PX, COLUMNS, MOST_SHOWN = 320, 4, 16
GAP_PX, LABEL_PX = 6, 16  # between the pictures of the contact sheet; below each


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    *,
    frames: int,
    exposure: str | None,
    iso: str | None,
    truth: bool,
    form: str,
    seed: int,
    temperature_c: float | None,
    luminance_cd_m2: float | None,
    illuminant: str | None,
    tolerance: str,
    probes: int | None,
    tile: str | None,
    best_effort: bool,
    show: str,
) -> int:
    """Expose once, read `frames` times into the folder `out`; return the exit code.

    `show`: "table", "json" or "nothing".
    """
    _check(form, frames)
    exposures = None if exposure is None else [exposure_seconds(one) for one in exposure.split(",")]
    speeds = None if iso is None else [_speed(one) for one in iso.split(",")]
    camera = load_camera(camera_name)
    for speed in speeds or ():
        camera.sensor.at_iso(speed)  # refuses what it does not have, before the long work
    camera.sensor.dark_current_at(temperature_c)
    scene = make_scene(scene_name, luminance_cd_m2, illuminant, frame=camera.frame)
    with staging(out) as folder, screen.progress_bar(show != "nothing") as progress:
        light = expose(
            camera,
            scene,
            tolerance,
            probes=probes,
            tile=None if tile is None else rectangle_of(tile),
            exposure_s=None if exposures is None else max(exposures),
            best_effort=best_effort,
            progress=progress,
        )
        started = time.perf_counter()
        burst = light.burst(
            frames,
            exposures,
            iso=speeds,
            seed=seed,
            temperature_c=temperature_c,
            truth=truth,
            progress=progress,
        )
        seconds = time.perf_counter() - started
        names = _write(burst, form, folder, progress)
        contact_sheet(burst).save(folder / "frames.jpg", quality=88)
        facts = _facts(burst, seconds, [*names, "frames.jpg", "burst.json"])
        (folder / "burst.json").write_text(json.dumps(facts, indent=1) + "\n")
    if show == "json":
        print(json.dumps(facts, indent=1))
    elif show == "table":
        _say(facts, out)
    return 0 if light.certificate is None or light.certificate.met else 1


def _check(form: str, frames: int) -> None:
    """Refuse an unknown format, and too many frames."""
    if form not in FORMATS:
        raise UserError(
            "there is no such format", field="--format", value=form, allowed=", ".join(FORMATS)
        )
    if not 1 <= frames <= MOST_FRAMES:
        raise UserError(
            "so many frames are not taken",
            field="--frames",
            value=frames,
            allowed=f"1 to {MOST_FRAMES}",
        )


def _speed(text: str) -> int:
    if not text.strip().isdecimal():
        raise UserError(
            "not an ISO speed", field="--iso", value=text, allowed="whole numbers: 100,400"
        )
    return int(text)


def _write(burst: Burst, form: str, folder: Path, progress: Any) -> list[str]:
    """Write the frames; return the names of the files."""
    if form == "npz":
        arrays = {
            "raw": burst.raw,
            "exposure_s": burst.exposure_s,
            "iso": np.array([frame.iso for frame in burst]),
            "seed": np.uint64(burst.shots[0].seed),
        }
        if burst.truth_dn is not None:
            arrays["truth_dn"] = burst.truth_dn
        np.savez(folder / "burst.npz", **arrays)
        return ["burst.npz"]
    names = []
    if form == "dng":
        (folder / LIGHT).write_text(json.dumps(burst.light.recipe, indent=1) + "\n")
        names.append(LIGHT)
    for number, frame in enumerate(burst):
        name = f"frame-{number:04d}.{form}"
        taken = datetime.now(UTC)
        names.append(name)
        if form != "dng":
            frame.save(folder / name)
        else:
            frame.write_raw(folder / name, 0.0, taken)
            said = {"recipe": recipe_of_frame(frame, folder / name, taken, light=LIGHT)}
            sidecar = f"frame-{number:04d}.json"
            (folder / sidecar).write_text(json.dumps(said, indent=1) + "\n")
            names.append(sidecar)
        if burst.truth_dn is not None:
            name = f"truth-{number:04d}.exr"
            write_exr(folder / name, {"Y": burst.truth_dn[number]}, units="DN")
            names.append(name)
        progress("files", number + 1, len(burst))
    return names


def contact_sheet(burst: Burst) -> Image.Image:
    """Return the first frames, developed, with what they were taken with."""
    shown = [burst[number] for number in range(min(len(burst), MOST_SHOWN))]
    pictures = []
    for frame in shown:
        picture = frame.develop()
        picture.thumbnail((THUMBNAIL_PX, THUMBNAIL_PX))
        pictures.append(picture)
    wide, high = (max(size) for size in zip(*(one.size for one in pictures), strict=True))
    columns = min(COLUMNS, len(pictures))
    across, down = wide + GAP_PX, high + LABEL_PX
    size = columns * across - GAP_PX, -(-len(pictures) // columns) * down
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for number, (frame, picture) in enumerate(zip(shown, pictures, strict=True)):
        x, y = number % columns * across, number // columns * down
        sheet.paste(picture, (x, y))
        draw.text((x + 4, y + high + 2), _label(frame.exposure_s, frame.iso), fill="black")
    return sheet


def _label(exposure_s: float, iso: int) -> str:
    time_s = f"{exposure_s:.3g} s" if exposure_s >= 0.3 else f"1/{1 / exposure_s:.4g} s"
    return f"{time_s}, ISO {iso}"


def _facts(burst: Burst, seconds: float, files: list[str]) -> dict[str, Any]:
    light = burst.light
    certificate = None
    if light.certificate is not None:
        certificate = {
            name: value
            for name, value in asdict(light.certificate).items()
            if name not in ("points",)
        }
    return {
        "command": ["gpusim", *sys.argv[1:]],
        "camera": light.title,
        "scene": light.scene,
        "tolerance": light.tolerance,
        "certificate": certificate,
        "notes": list(light.notes),
        "rows": burst.raw.shape[1],
        "cols": burst.raw.shape[2],
        "read_out_s": seconds,
        "read_out_mp_per_s": burst.raw.size / seconds / 1e6,
        "frames": [
            {
                "exposure_s": frame.exposure_s,
                "iso": frame.iso,
                "seed": frame.shot.seed,
                "frame": frame.shot.frame,
                "saturated": float(frame.saturated.mean()),
            }
            for frame in burst
        ],
        "files": files,
    }


def _say(facts: dict[str, Any], out: Path) -> None:
    console = Console()
    certificate = facts["certificate"]
    verdict = "not certified"
    if certificate is not None:
        verdict = (
            f"total RMS {certificate['total_rms']:.1e}, worst {certificate['total_worst']:.1e}: "
            f"tolerance {facts['tolerance']} {'met' if certificate['met'] else 'NOT met'}"
        )
    lines = (
        f"{facts['camera']}, {facts['scene']}: light {verdict}",
        f"{len(facts['frames'])} frames of {facts['cols']} x {facts['rows']} pixels read out in "
        f"{facts['read_out_s']:.2f} s, {facts['read_out_mp_per_s']:.3g} MP/s",
        f"files in {out}: {facts['files'][0]}"
        + (f" ... {facts['files'][-3]}" if len(facts["files"]) > 3 else "")
        + ", frames.jpg, burst.json",
    )
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
