"""The planner's regret: the time of the plan that it chooses over that of the fastest one known."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.pareto import sweep, variants
from gpusim.plan import Accuracy
from gpusim.scene import make_scene
from gpusim.sensor.load import load_sensor

TOLERANCE, EXPOSURE_S, PROBES = 1e-3, 1 / 60, 64
LARGEST = (288, 384)  # of the frames: 15 sweeps
BUDGET_S = 20.0  # of the rounds of each, but three rounds
# Slower than what they are turned from, always: they cannot be the fastest.
SLOWER = ("4 samples a pixel", "not cut", "1.4 x the nodes", "2 x the nodes")
KINDS = ("regret", "first_regret")
SHOWN = ("frame_s", "first_s", "regret", "fastest", "first_regret", "first_fastest", "plan", "met")


def regret_job(
    device: Device,
    frame: tuple[int, int],
    *,
    job: Callable[..., Any],
    lenses: Mapping[str, Callable],
    scenes: Sequence[str],
    probes: int = PROBES,
) -> Any:
    """Sweep plans for each scene and lens, and find the planner's regret in each.

    The times are those of prepared and of first frames, by medians of rounds through all plans: see
    `gpusim.pareto`. Where the adapter is the processor, its own time counts, which other work of
    the machine hardly moves. Plans for other tolerances are left out, and so is what is never
    faster. The first call, which warms up, does nothing. The second does it all, and fills the
    table and the error.
    """
    rows, cols = (min(side, most) for side, most in zip(frame, LARGEST, strict=True))
    sensor = load_sensor("imx477").roi(rows, cols)
    asked = Accuracy(TOLERANCE, probes)
    others = [variant.name for variant in variants(asked, 1) if variant.accuracy != asked]
    of_processor = device.report()["type"] == "CPU"
    clock = time.process_time if of_processor else time.perf_counter
    table: list[dict[str, Any]] = []
    error: dict[str, Any] = {"measure": f"largest regret at a tolerance of {TOLERANCE:g}"}
    error["clock"] = "processor time" if of_processor else "wall clock"
    calls: list[bool] = []

    def run() -> None:
        calls.append(True)
        if len(calls) == 1:
            return
        table.clear()
        for lens, load in lenses.items():
            camera = Camera(load(), sensor, lens)
            for name in scenes:
                found: dict[str, Any] = {"lens": lens, "scene": name}
                table.append(found)
                left_out = (*others, *SLOWER)
                try:
                    swept = sweep(
                        camera,
                        make_scene(name),
                        asked,
                        EXPOSURE_S,
                        device=device,
                        budget_s=BUDGET_S,
                        leave_out=left_out,
                        clock=clock,
                    )
                except UserError as refused:
                    found["refused"] = refused.problem
                    continue
                points = [asdict(point) for point in swept.points if not point.obstacle]
                found |= {key: points[0][key] for key in SHOWN}
                print(found, file=sys.stderr, flush=True)
                keys = ("name", "plan", "met", "frame_s", "first_s", "total_rms")
                found["points"] = [{key: point[key] for key in keys} for point in points]
        known = [found for found in table if found.get("regret") is not None]
        for kind in KINDS:
            each = [found[kind] for found in known]
            error[kind] = max(each, default=None)
            error[f"median {kind}"] = statistics.median(each) if each else None
        error["without"] = len(table) - len(known)

    return job(run, rows * cols, error, facts=lambda best: {"cells": table})
