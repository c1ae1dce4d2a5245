#!/usr/bin/env python
"""Time one named job, warm, and print one line of JSON or a table.

``render-demo`` times a whole capture of the demonstration camera, from the source to raw digital
numbers, with everything prepared and resident; its error is the certificate's. Each stage has a job
of its own on a frame of 12 MP. Its peers are a copy of as many bytes as it reads and writes, by a
kernel on the same device, and NumPy or SciPy where they do the same work; its error is the largest
difference from the float64 reference on a small sample, over the reference's largest value. Where
operations are counted, beside them stand those of as many multiply-adds by a kernel that does
nothing else.

Times are wall clock around a run that waits for the device, after a run to warm up. On a busy
machine ratios hold better than seconds.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from bench_jobs import JOBS, Run

from gpusim.errors import UserError
from gpusim.gpu import Device, Kernel, Recording, default_device

FRAME = (3040, 4056)  # rows and columns of the whole IMX477: 12.3 MP
REPEATS, SECONDS = 5, 10.0  # a run is repeated until one of them is reached,
QUICK_SECONDS = 1.0  # and a quick one for as long
COPY_BYTES = 64 << 20  # of the buffers between which is copied: larger than the caches
COPY = """
struct Params { count: u32, }
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read> from_: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> to: array<vec4f>;
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let i = id.y * 65536u + id.x;
    if (i < params.count) { to[i] = from_[i]; }
}
"""
# Eight chains of vec4f, so that none waits for the one before: 64 operations a line.
CHAINS, LINES, TURNS = 8, 16, 64
ARITHMETIC = f"""
struct Params {{ count: u32, factor: f32, }}
@group(0) @binding(0) var<uniform> params: Params;
@group(0) @binding(1) var<storage, read_write> to: array<vec4f>;
@compute @workgroup_size(64, 1, 1)
fn main(@builtin(global_invocation_id) id: vec3u) {{
    let f = vec4f(params.factor);
    {"".join(f"var x{i} = vec4f(f32(id.x + {i}u));" for i in range(CHAINS))}
    for (var turn = 0u; turn < {TURNS}u; turn++) {{
        {LINES * "".join(f"x{i} = x{i} * f + f;" for i in range(CHAINS))}
    }}
    if (id.x < params.count) {{ to[id.x] = {" + ".join(f"x{i}" for i in range(CHAINS))}; }}
}}
"""
PER_INVOCATION = CHAINS * 4 * 2 * LINES * TURNS


def arithmetic(device: Device, flops: int) -> Run:
    """Return a run of so many operations, half of them products and half sums, and hardly a store.

    At least: of whole workgroups.
    """
    kernel = Kernel.from_text("arithmetic", ARITHMETIC)
    groups = -(-flops // (64 * PER_INVOCATION))
    target = device.empty("arithmetic", 4 * 64 * groups, np.float32)
    rec = Recording(device)
    params = {"count": 64 * groups, "factor": 0.5}
    kernel.record(rec, (groups, 1, 1), params, to=target)
    return rec.run


def copy(device: Device, nbytes: int) -> Run:
    """Return a run that copies half as many bytes: it reads and writes `nbytes` together."""
    source = device.resident("copy source", np.zeros(COPY_BYTES // 4, np.float32))
    target = device.empty("copy target", COPY_BYTES // 4, np.float32)
    kernel = Kernel.from_text("copy", COPY)
    rec = Recording(device)
    for start in range(0, nbytes // 2, COPY_BYTES):
        count = min(nbytes // 2 - start, COPY_BYTES) // 16
        groups = (min(-(-count // 64), 1024), -(-count // 65536), 1)
        kernel.record(rec, groups, {"count": count}, from_=source, to=target)
    return rec.run


def timed(what: str, run: Run) -> tuple[list[float], object]:
    """Return the seconds of warm runs, and what the best of them returned."""
    print(f"timing {what} ...", end=" ", file=sys.stderr, flush=True)
    run()
    times: list[float] = []
    best = None
    while sum(times) < QUICK_SECONDS or (len(times) < REPEATS and sum(times) < SECONDS):
        started = time.perf_counter()
        returned = run()
        times.append(time.perf_counter() - started)
        if times[-1] == min(times):
            best = returned
    print(f"{min(times):.4g} s, best of {len(times)}", file=sys.stderr)
    return times, best


def measure(name: str, frame: tuple[int, int] = FRAME) -> dict[str, object]:
    """Run one job and its peers; return the figures."""
    device = default_device()
    print(f"preparing {name} ...", file=sys.stderr)
    job = JOBS[name][1](device, frame)
    times, best = timed(name, job.run)
    peers = dict(job.peers)
    if job.nbytes:
        peers["copy"] = (copy(device, job.nbytes), 1.0)
    peer_s = {peer: min(timed(peer, run)[0]) * share for peer, (run, share) in peers.items()}
    best_s = min(times)
    rates = {}
    if job.nbytes:
        rates = {
            "bytes": job.nbytes,
            "bytes_per_s": job.nbytes / best_s,
            "copy_bytes_per_s": job.nbytes / peer_s["copy"],
            "samples_per_s": job.samples / best_s,
        }
    if job.flops:
        alone_s = min(timed("arithmetic", arithmetic(device, job.flops))[0])
        rates |= {
            "flops": job.flops,
            "flops_per_s": job.flops / best_s,
            "arithmetic_flops_per_s": job.flops / alone_s,
        }
    report = device.report()
    return {
        "name": name,
        "best_s": best_s,
        "median_s": statistics.median(times),
        "pixels": job.pixels,
        "peers": peer_s,
        "ratio": best_s / min(peer_s.values()) if peer_s else None,
        "error": job.error,
        **rates,
        **job.facts(best),
        "adapter": report["adapter"],
        "driver": report["driver"],
        "commit": commit(),
    }


def commit() -> str | None:
    """Return this checkout's commit, marked where files differ from it; None outside git."""

    def git(*arguments: str) -> str | None:
        command = ["git", "-C", str(Path(__file__).parent), *arguments]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError:
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    head = git("rev-parse", "--short", "HEAD")
    return head + "+dirty" if head and git("status", "--porcelain") else head


def rows_of(facts: dict[str, object]) -> list[tuple[str, str]]:
    """Return the figures as rows of a table, what is nested under dotted names."""
    found = []
    for name, value in facts.items():
        if isinstance(value, dict):
            found += [(f"{name}.{inner}", text) for inner, text in rows_of(value)]
        else:
            found.append((name, f"{value:.5g}" if isinstance(value, float) else str(value)))
    return found


def main() -> int:
    """Run the command line; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="?", help="of the job; --list names them")
    parser.add_argument("--list", action="store_true", help="name the jobs and end")
    parser.add_argument("--json", action="store_true", help="print one line of JSON")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="append the line of JSON to a file"
    )
    parser.add_argument(
        "--megapixels", type=float, metavar="N", help="frame size of the jobs, 0.02 to 12.3"
    )
    options = parser.parse_args()
    if options.list:
        for name, (what, _) in JOBS.items():
            print(f"{name:15} {what}")
        return 0
    if options.name not in JOBS:
        wrong = "No job is named" if options.name is None else f"There is no job {options.name!r}"
        print(f"{wrong}; there are: {', '.join(JOBS)}", file=sys.stderr)
        return 2
    frame = FRAME
    if options.megapixels is not None:
        if not 0.02 <= options.megapixels <= 12.4:
            parser.error(f"--megapixels {options.megapixels}: 0.02 to 12.3 are possible")
        share = min(1.0, math.sqrt(options.megapixels * 1e6 / math.prod(FRAME)))
        frame = tuple(int(side * share) // 8 * 8 for side in FRAME)
    try:
        facts = measure(options.name, frame)
    except UserError as wrong:
        print(wrong.screen(), file=sys.stderr)
        return 2
    line = json.dumps(facts, allow_nan=False)
    print(line if options.json else "\n".join(f"{k:24} {v}" for k, v in rows_of(facts)))
    if options.out is not None:
        with options.out.open("a", encoding="utf-8") as file:
            file.write(line + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
