#!/usr/bin/env python
"""What a batch costs beside its frames, and what it loses under kills: docs/batch-bars.md.

Every figure is a ratio or a difference within one run of this machine, but for the start of the
cluster. Kills are real ones (SIGKILL), at random times, of the whole batch or of its workers.

    python tools/batch_bars.py [--only NAME ...]
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
import yaml
from pyarrow import parquet

import gpusim as gs
from gpusim.batch.sweep import Sweep
from gpusim.batch.work import rendered
from gpusim.gpu import devices

PAGE = Path(__file__).resolve().parents[1] / "docs" / "batch-bars.md"
SMALL = {
    "title": "small",
    "lens": {"mtf": "diffraction-limited"},
    "sensor": {"preset": "imx477", "rows": 32, "cols": 48},
}
VGA, SIDE = (480, 640), 512
WARM = 20  # frames before rates are counted
VGA_FRAMES, SENSOR_FRAMES, SMALL_FRAMES, KILL_FRAMES = 200, 1000, 2000, 500
TAKEN = 1_700_000_000  # time in the raws, so that two batches have the same bytes
LIMIT_S = 900  # of one batch
KILLS_EVERY = 40  # frames, on average, from one kill to the next


@dataclass(frozen=True)
class Found:
    """One bar: what was measured, and what has to hold.

    ``below`` tells whether the figure has to be less than the bar.
    """

    what: str
    value: float
    bar: float
    unit: str
    below: bool = True
    note: str = ""

    @property
    def held(self) -> bool:
        """Whether it holds."""
        return self.value <= self.bar if self.below else self.value >= self.bar


class Batch:
    """One sweep in a folder of its own, run by the command."""

    def __init__(self, folder: Path, **sweep: object) -> None:
        self.folder = folder
        (folder / "small.yaml").write_text(yaml.safe_dump(SMALL))
        (folder / "sweep.yaml").write_text(yaml.safe_dump(sweep))

    def start(self, out: Path, *words: str) -> subprocess.Popen:
        """Start the command in a session of its own, so that all of it can be killed."""
        command = [sys.executable, "-m", "gpusim", "batch", str(self.folder / "sweep.yaml")]
        environment = os.environ | {"SOURCE_DATE_EPOCH": str(TAKEN)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package has it written
        return subprocess.Popen(
            [*command, "--out", str(out), "-q", *words], env=environment, start_new_session=True
        )

    def whole(self, out: Path) -> None:
        """Run it to its end."""
        if self.start(out).wait(timeout=LIMIT_S) != 0:
            raise SystemExit(f"the batch in {out} failed")


def sidecars(out: Path) -> list[Path]:
    """Return the sidecars of the frames that are done, in the order in which they came."""
    found = [path for path in out.glob("frame-*.json") if path.is_file()]
    return sorted(found, key=lambda path: path.stat().st_mtime_ns)


def rate(out: Path) -> float:
    """Return frames a second of a batch that is done, the first ones left out."""
    times = [path.stat().st_mtime_ns * 1e-9 for path in sidecars(out)][WARM:]
    return (len(times) - 1) / (times[-1] - times[0])


def alone(folder: Path) -> float:
    """Return frames a second of a loop in this process, which writes raws and no sidecars."""
    times = []
    for frame, taken in rendered(Sweep.load(folder / "sweep.yaml").frames):
        taken.save(folder / f"{frame.name}.dng")
        times.append(time.perf_counter())
    return (len(times) - WARM - 1) / (times[-1] - times[WARM])


def vga(folder: Path) -> list[Found]:
    """Compare a batch of one lens with a loop over the same light in one process."""
    seeds = {"range": [0, VGA_FRAMES]}
    rows, cols = VGA
    batch = Batch(folder, camera="demo", scenes=["colorchecker"], rows=rows, cols=cols,
                  tolerance="1e-2", probes=8, axes={"seed": seeds}, outputs=["raw"])  # fmt: skip
    loop = alone(folder)
    batch.whole(folder / "out")
    found = rate(folder / "out")
    note = f"{found:.1f} frames/s of {loop:.1f}; sidecars and fsync included, the loop has neither"
    what = f"{VGA_FRAMES} VGA frames of one lens, of the rate of one process without Dask"
    return [Found(what, found / loop, 0.9, "", below=False, note=note)]


def sensor(folder: Path) -> list[Found]:
    """Read frames of one light in this process, without files."""
    Batch(folder, camera="demo", scenes=["colorchecker"], rows=SIDE, cols=SIDE, tolerance="1e-2",
          probes=8, axes={"seed": {"range": [0, SENSOR_FRAMES]}}, outputs=["raw"])  # fmt: skip
    times = []
    for _ in rendered(Sweep.load(folder / "sweep.yaml").frames):
        times.append(time.perf_counter())
    each = (times[-1] - times[WARM]) / (len(times) - WARM - 1)
    what = f"{SENSOR_FRAMES} frames of {SIDE} x {SIDE}, the sensor alone, less writing"
    return [Found(what, SIDE**2 / each / 1e6, 40.0, "MP/s", below=False)]


def small(folder: Path) -> list[Found]:
    """Time and watch a batch of many small frames: the layer, the start, and the memory."""
    batch = Batch(folder, camera=str(folder / "small.yaml"), scenes=["colorchecker"],
                  tolerance="1e-2", probes=8, axes={"seed": {"range": [0, SMALL_FRAMES]}},
                  outputs=["raw"])  # fmt: skip
    out = folder / "out"
    began = time.time()
    process = batch.start(out)
    memory: list[tuple[int, float]] = []
    while process.poll() is None:
        time.sleep(0.25)
        for worker in workers_of(process):
            done = len(list(out.glob("frame-*.json")))
            with suppress(psutil.Error):  # ended meanwhile
                memory.append((done, worker.memory_info().rss / 2**20))
    if process.returncode != 0:
        raise SystemExit("the batch of small frames failed")
    first = sidecars(out)[0]
    start_s = first.stat().st_mtime - began - json.loads(first.read_text())["seconds"]
    layer_ms = 1e3 / rate(out) - 1e3 / alone(folder)
    tenth = SMALL_FRAMES // 10
    early = statistics.median(rss for done, rss in memory if tenth <= done < 2 * tenth)
    late = statistics.median(rss for done, rss in memory if done >= SMALL_FRAMES - tenth)
    note = f"{early:.0f} MiB after {tenth} frames, {late:.0f} MiB at the end"
    return [
        Found("overhead of the layer, over a loop in one process", layer_ms, 10.0, "ms a frame"),
        Found("from the command to the first task", start_s, 3.0, "s"),
        Found(f"growth of a worker's memory over {SMALL_FRAMES} frames", late - early, 8.0, "MiB",
              note=note),
    ]  # fmt: skip


def workers_of(process: subprocess.Popen) -> list[psutil.Process]:
    """Return the worker processes of a batch."""
    try:
        children = psutil.Process(process.pid).children()
        servers = [one for one in children if "forkserver" in " ".join(one.cmdline())]
        return [worker for server in servers for worker in server.children()]
    except psutil.Error:  # ended meanwhile
        return []


def kills(folder: Path) -> list[Found]:
    """Kill a batch again and again until it is done; compare it with one that nobody killed."""
    axes = {"seed": {"range": [0, KILL_FRAMES // 2]}, "exposure_s": [0.005, 0.02]}
    batch = Batch(folder, camera=str(folder / "small.yaml"), scenes=["colorchecker"],
                  tolerance="1e-2", probes=8, axes=axes, outputs=["raw", "truth"])  # fmt: skip
    whole, cut = folder / "whole", folder / "cut"
    batch.whole(whole)
    chance, killed = random.Random(1), {"batch": 0, "worker": 0}
    process = batch.start(cut)
    limit = time.monotonic() + LIMIT_S
    while time.monotonic() < limit:
        wanted = len(sidecars(cut)) + chance.randint(1, 2 * KILLS_EVERY)
        while process.poll() is None and len(sidecars(cut)) < wanted:
            time.sleep(0.02)
        if process.poll() is not None:
            break
        if chance.random() < 0.5 and (workers := workers_of(process)):
            chance.choice(workers).kill()
            killed["worker"] += 1
        else:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            killed["batch"] += 1
            process = batch.start(cut, "--resume")
    if process.wait(timeout=LIMIT_S) != 0:
        raise SystemExit("the batch that was killed did not end well")
    numbers = parquet.read_table(cut / "frames.parquet")["number"].to_pylist()
    lost = KILL_FRAMES - len(set(numbers))
    differing = sum(
        (cut / path.name).read_bytes() != path.read_bytes()
        for path in whole.iterdir()
        if path.suffix in (".dng", ".exr")
    )
    left = len(list(cut.glob(".*-frame-*")))
    note = f"the batch killed {killed['batch']} times, a worker {killed['worker']} times"
    return [
        Found(f"of {KILL_FRAMES} frames under random kills lost", lost, 0, "frames", note=note),
        Found("doubled", len(numbers) - len(set(numbers)), 0, "frames"),
        Found("files that differ from those of a batch that nobody killed", differing, 0, "files"),
        Found("half written files left", left, 0, "files"),
    ]


PARTS: dict[str, Callable[[Path], list[Found]]] = {
    "vga": vga,
    "sensor": sensor,
    "small": small,
    "kills": kills,
}


def page(found: list[Found]) -> str:
    """Return the table as Markdown."""
    lines = [
        "# What a batch costs, and what kills cost it",
        "",
        f"`tools/batch_bars.py` on {devices()[0]['adapter']}, {os.cpu_count()} cores, "
        f"gpusim {gs.__version__}.",
        "",
        "| what | measured | bar | held | |",
        "|---|---|---|---|---|",
    ]
    for one in found:
        sign = "at most" if one.below else "at least"
        lines.append(
            f"| {one.what} | {one.value:.3g} {one.unit} | {sign} {one.bar:g} {one.unit} | "
            f"{'yes' if one.held else '**no**'} | {one.note} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Measure, print and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS))
    names = parser.parse_args().only
    found = []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            new = PARTS[name](Path(folder))
        for one in new:
            print(name, one, flush=True)
        found += new
    if set(names) == set(PARTS):
        PAGE.write_text(page(found))
    sys.exit(0 if all(one.held for one in found) else 1)


if __name__ == "__main__":
    main()
