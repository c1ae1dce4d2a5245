"""``gpusim batch``."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from gpusim.batch.run import Outcome, run, status
from gpusim.batch.sweep import Sweep
from gpusim.cli import screen
from gpusim.cli.stop import RESUMES, advised
from gpusim.errors import UserError

if TYPE_CHECKING:
    from gpusim.batch.cost import Cost

# Bytes a pixel of each output, upper bounds: PNG of noise hardly compresses.
BYTES = {"raw": 2, "npz": 11, "exr": 4, "developed": 3, "truth": 4}
MOST_OF_A_LABEL = 8  # bytes


def run_batch(
    path: Path,
    out: Path,
    *,
    resume: bool,
    workers: int,
    scheduler: str | None,
    fail_fast: bool,
    dry_run: bool,
    only_status: bool,
    show: str,
) -> int:
    """Render a sweep; return the exit code: 1 where frames failed or a certificate is not met."""
    if workers < 1:
        raise UserError("no worker", field="--workers", value=workers, allowed="1 or more")
    sweep = Sweep.load(path)
    if dry_run:
        from gpusim.batch.cost import cost_of

        with screen.progress_bar(show != "nothing") as progress:
            cost = cost_of(sweep, progress)
        _say(_plan(sweep, out, cost), show)
        return 0
    if only_status:
        found = status(sweep, out)
        _say({"frames": len(sweep), "done": len(found.done), "missing": found.missing}, show)
        return 0 if not found.missing else 1
    with screen.progress_bar(show != "nothing") as progress:
        with advised(RESUMES):
            outcome = run(
                sweep,
                out,
                resume=resume,
                workers=workers,
                scheduler=scheduler,
                fail_fast=fail_fast,
                progress=progress,
            )
        # Once the frames are there: workers need not wait for what tables and pages need.
        from gpusim.batch.page import batch_page
        from gpusim.batch.table import write_table

        progress("table, page", 0, 1)
        write_table(outcome, out / "frames.parquet")
        (out / "batch.html").write_text(batch_page(outcome), encoding="utf-8")
        progress("table, page", 1, 1)
    facts = _facts(outcome)
    _say(facts, show)
    for one in outcome.failed[:5]:
        Console(stderr=True).print(
            f"frame {one['number']}: {one['error']}", markup=False, highlight=False
        )
    return 0 if not outcome.failed and not outcome.missing and not facts["unmet"] else 1


def _plan(sweep: Sweep, out: Path, cost: Cost) -> dict[str, Any]:
    """Return what a sweep would do."""
    frames = sweep.frames
    read = frames[0].sensor().frame.read
    pixels = sweep.tile[2] * sweep.tile[3] if sweep.tile else math.prod(read[2:])
    need = len(frames) * sum(_most_bytes(sweep, name, pixels) for name in sweep.outputs)
    folder = next(one for one in (out, *out.absolute().parents) if one.exists())
    return {
        "frames": len(frames),
        "lights": len({frame.light_key for frame in frames}),
        "pixels_a_frame": pixels,
        "planned_s_a_light": round(cost.light_s, 3),
        "planned_s_a_frame": round(cost.frame_s, 4),
        "planned_s": round(cost.all_s, 3),
        "disk_at_most_MB": round(need / 1e6, 3),
        "disk_free_MB": round(shutil.disk_usage(folder).free / 1e6),
        "first": {"scene": frames[0].scene, **frames[0].settings},
        "last": {"scene": frames[-1].scene, **frames[-1].settings},
    }


def _most_bytes(sweep: Sweep, output: str, pixels: int) -> int:
    """Return how many bytes an output of a frame has at most."""
    of_labels = MOST_OF_A_LABEL * len(sweep.labels)
    if output == "labels":
        return of_labels * pixels
    if output == "crops" and sweep.crops is not None:
        pixels = sweep.crops.a_frame * sweep.crops.rows * sweep.crops.cols
        return pixels * (BYTES["raw"] + BYTES["truth"] + of_labels)
    return BYTES[output] * pixels


def _facts(outcome: Outcome) -> dict[str, Any]:
    return {
        "frames": len(outcome.sweep),
        "done": len(outcome.done),
        "new": outcome.new,
        "failed": len(outcome.failed),
        "missing": outcome.missing,
        "unmet": sum(one["certificate_met"] is False for one in outcome.done),
        "seconds": round(outcome.seconds, 2),
        "frames_per_s": round(outcome.new / outcome.seconds, 3) if outcome.new else 0.0,
        "files": [str(outcome.out / name) for name in ("frames.parquet", "batch.html")],
    }


def _say(facts: dict[str, Any], show: str) -> None:
    if show == "json":
        print(json.dumps(facts, indent=1))
    elif show == "table":
        console = Console()
        for name, value in facts.items():
            said = ", ".join(map(str, value)) if isinstance(value, list) else value
            console.print(f"{name:18}{said}", markup=False, highlight=False, soft_wrap=True)
