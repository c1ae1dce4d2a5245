#!/usr/bin/env python
"""How long 10,000 frames take on 1, 8 and 64 adapters, and what binds: docs/scaling.md.

Rates are measured on this machine: a lens seen the first time, a light, a frame read and written,
the disk. The model is held against real batches of one and of two workers, and then asked about
adapters that this machine has not.

    python tools/scaling.py
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import gpusim as gs
from gpusim.batch.run import status
from gpusim.gpu import Recording, devices

PAGE = Path(__file__).resolve().parents[1] / "docs" / "scaling.md"
CAMERA, SCENES, ROWS, COLS = "demo", ["colorchecker", "slanted-edge"], 480, 640
SEEDS = 150  # frames of each light: a batch of 300 takes a minute or two
DISK_BYTES = 256 << 20  # written and brought to disk, to time it
FRAMES, LIGHTS = 10_000, 100  # of the batch that the model is asked about
FASTER = (1, 30)  # adapters as fast as this one, and so many times as fast


@dataclass(frozen=True)
class Rates:
    """What was measured; seconds of one worker by itself.

    Attributes
    ----------
    start_s : float
        From the command to the first task, and from the last one to the end.
    lens_s : float
        A lens seen the first time, once for a batch.
    light_s, light_core_s : float
        The optics of one scene; seconds of all cores together that it takes.
    device_share : float
        What the adapter does of light and lens; the host does the rest.
    frame_s : float
        A frame read out and written.
    frame_core_s : float
        Seconds of all cores together that it takes.
    frame_bytes, disk_bytes_s : float
    """

    start_s: float
    lens_s: float
    light_s: float
    light_core_s: float
    device_share: float
    frame_s: float
    frame_core_s: float
    frame_bytes: float
    disk_bytes_s: float


def parts(
    rates: Rates, frames: int, lights: int, workers: int, cores: float, faster: float = 1.0
) -> dict[str, float]:
    """Return the seconds of a batch by what takes them; their sum is the wall clock.

    Parameters
    ----------
    rates : Rates
    frames, lights, workers : int
    cores : float
        Those of all machines together, which share a disk that all workers write to.
    faster : float
        Speed of their adapters over the measured one's.
    """
    share = rates.device_share
    slower = share / faster + 1 - share
    exposing = max(-(-lights // workers) * rates.light_s, lights * rates.light_core_s / cores)
    reading = frames * max(rates.frame_s / workers, rates.frame_core_s / cores)
    writing = frames * rates.frame_bytes / rates.disk_bytes_s
    return {
        "start": rates.start_s,
        "lens": rates.lens_s * slower,
        "lights": exposing * slower,
        "frames": reading,
        "disk": max(writing - reading, 0.0),  # it writes while frames are read
    }


def sweep(scenes: list[str], **more: object) -> gs.Sweep:
    """Return frames of one lens: raws of SEEDS exposures a scene."""
    axes = {"seed": {"range": [0, SEEDS]}}
    given = {"rows": ROWS, "cols": COLS, "tolerance": 1e-2, "probes": 0}
    return gs.Sweep(camera=CAMERA, scenes=scenes, axes=axes, **given | more)


def timed_batch(folder: Path, workers: int) -> tuple[float, float, list[dict]]:
    """Return wall and core seconds of a batch, and its sidecars."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.perf_counter()
    batch = sweep(SCENES)
    batch.run(folder, workers=workers)
    wall = time.perf_counter() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    core = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    return wall, core, status(batch, folder).done


def measured(folder: Path) -> tuple[Rates, dict[int, float]]:
    """Return rates, and the wall clock of batches by number of workers."""
    camera = gs.Camera.load(CAMERA)
    f_number = 3 + time.time() % 1 / 10  # of a lens that no cache holds
    sensor = camera.sensor.roi(ROWS, COLS)
    camera = gs.Camera(camera.lens.stopped(f_number), sensor, "scaling")
    walls, on_device = [], []
    run = Recording.run

    def timed(self: Recording, *given: object) -> object:
        began = time.perf_counter()
        try:
            return run(self, *given)
        finally:
            on_device.append(time.perf_counter() - began)

    Recording.run = timed
    busy = 0.0  # cores, on the mean
    for scene in SCENES:
        started, used = time.perf_counter(), time.process_time()
        gs.expose(camera, gs.Scene.load(scene), 1e-2, probes=0)
        walls.append(time.perf_counter() - started)
        busy = (time.process_time() - used) / walls[-1]
    Recording.run = run
    block = os.urandom(DISK_BYTES)
    started = time.perf_counter()
    with (folder / "block").open("wb") as file:
        file.write(block)
        os.fsync(file.fileno())
    disk = DISK_BYTES / (time.perf_counter() - started)
    (folder / "block").unlink()
    timed_batch(folder / "warm", 1)  # lens, kernels and files of the program
    one, core, done = timed_batch(folder / "one", 1)
    two, _, _ = timed_batch(folder / "two", 2)
    lights = [frame["light_s"] for frame in done if frame["light_s"] > 0.1]
    frame_s = statistics.median(frame["seconds"] - frame["light_s"] for frame in done)
    size = statistics.mean(path.stat().st_size for path in (folder / "one").glob("*.dng"))
    start = one - sum(lights) - frame_s * len(done)
    rates = Rates(
        start_s=start,
        lens_s=walls[0] - walls[1],
        light_s=statistics.mean(lights),
        light_core_s=busy * statistics.mean(lights),
        device_share=sum(on_device) / sum(walls),
        frame_s=frame_s,
        frame_core_s=max(core - busy * sum(lights), 0.0) / len(done),
        frame_bytes=size,
        disk_bytes_s=disk,
    )
    return rates, {1: one, 2: two}


def page(rates: Rates, walls: dict[int, float]) -> str:
    """Return docs/scaling.md."""
    cores = os.cpu_count() or 1
    count = SEEDS * len(SCENES)
    lines = [
        "# Ten thousand frames",
        "",
        f"`tools/scaling.py` measures what a batch is made of ({devices()[0]['adapter']}, "
        f"{cores} cores; `{CAMERA}`, {COLS} x {ROWS} pixels, raws) and adds it up.",
        "",
        "| | measured |",
        "|---|---|",
        f"| start and end of a batch | {rates.start_s:.1f} s |",
        f"| a lens seen the first time | {rates.lens_s:.1f} s |",
        f"| a light: optics of one scene; core seconds | {rates.light_s:.2f} s; "
        f"{rates.light_core_s:.2f} s |",
        f"| a frame, read out and written; core seconds | {1e3 * rates.frame_s:.0f} ms; "
        f"{1e3 * rates.frame_core_s:.0f} ms |",
        f"| bytes of a raw; the disk | {rates.frame_bytes / 1e3:.0f} kB; "
        f"{rates.disk_bytes_s / 1e6:.0f} MB/s |",
        "",
        f"A batch of {count} frames of {len(SCENES)} lights, by the model and by the clock (what "
        "starts and ends a batch is taken from the first line; the second is the model's own):",
        "",
        "| workers | model | measured | model less measured |",
        "|---|---|---|---|",
    ]
    for workers, wall in walls.items():
        made = sum(parts(rates, count, len(SCENES), workers, cores).values()) - rates.lens_s
        lines.append(f"| {workers} | {made:.1f} s | {wall:.1f} s | {made / wall - 1:+.0%} |")
    lines += [
        "",
        f"{FRAMES} frames of {LIGHTS} lights on machines of {cores} cores and one adapter each, "
        "that share a disk as fast as this one: by the model, not measured. "
        f"{rates.device_share:.0%} of lens and light are the adapter's work; the rest is the "
        "host's, and no faster.",
        "",
        "| adapters | as fast as | in all | start | lens | lights | frames | disk | binds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for faster in FASTER:
        for workers in (1, 8, 64):
            took = parts(rates, FRAMES, LIGHTS, workers, cores * workers, faster)
            binds = max(took, key=lambda name: took[name])
            shown = " | ".join(f"{value:.0f} s" for value in took.values())
            speed = "this one" if faster == 1 else f"{faster} of it"
            lines.append(
                f"| {workers} | {speed} | {sum(took.values()):.0f} s | {shown} | {binds} |"
            )
    return "\n".join(lines) + "\n"


def main() -> int:
    """Measure, and write the page."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rates, walls = measured(Path(folder))
    print(json.dumps(rates.__dict__, indent=1))
    PAGE.write_text(page(rates, walls), encoding="utf-8")
    print(PAGE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
