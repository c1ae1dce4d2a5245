"""``gpusim tolerance``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console

from gpusim.batch.table import write_rows
from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.stop import RESUMES, advised
from gpusim.disk import whole
from gpusim.report.drawing import png
from gpusim.tolerance.budget import Budget
from gpusim.tolerance.found import run
from gpusim.tolerance.page import facts_of, figure_of, page_of, raws_figure, rows_of
from gpusim.tolerance.rendered import both
from gpusim.tolerance.study import Study

FILES = ("tolerance.html", "tolerance.png", "tolerance.json", "cameras.parquet")
RAWS = "raws.png"
OFFENDERS_SHOWN = 5


def run_tolerance(camera: str, budget: Path, out: Path, *, resume: bool, as_json: bool) -> None:
    """Do a tolerance study: write its files and show what it found."""
    study = Study(load_camera(camera), Budget.load(budget), out)
    study.prepare(resume)
    with screen.progress_bar() as progress, advised(RESUMES):
        study.progress = progress
        found = run(study)
        raws = both(found) if study.budget.raws else None
    facts = facts_of(found, raws)
    with whole(out / "tolerance.png") as part:
        part.write_bytes(png(figure_of(found)))
    if raws is not None:
        with whole(out / RAWS) as part:
            part.write_bytes(png(raws_figure(found, raws)))
    with whole(out / "tolerance.html") as part:
        part.write_text(page_of(found, raws), encoding="utf-8")
    with whole(out / "cameras.parquet") as part:
        write_rows(rows_of(found), part, {"gpusim.tolerance": json.dumps(facts["budget"])})
    with whole(out / "tolerance.json") as part:
        part.write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n")
    if as_json:
        print(json.dumps(facts, indent=1, allow_nan=False))
    else:
        _show(facts, out)


def _show(facts: dict[str, Any], out: Path) -> None:
    console = Console()

    def say(name: str, text: str) -> None:
        console.print(f"{name:22}{text}", markup=False, highlight=False, soft_wrap=True)

    worst = facts["worst_edge_mtf50_cy_px"]
    design = min(min(row) for row in facts["design_mtf50_cy_px"])
    say("camera", facts["camera"])
    say("lenses", f"{facts['budget']['samples']}, {len(facts['offenders'])} tolerances")
    say(
        "MTF50, worst edge",
        f"design {design:.3f}, median {worst['p50']:.3f}, 5th percentile {worst['p5']:.3f} cy/px",
    )
    if "yield" in facts:
        own = facts["yield"]
        say("yield", f"{own['share']:.1%} reach {own['required_cy_px']:g} cy/px")
    say("focus", f"{facts['focus_um']['standard_deviation']:.1f} um standard deviation")
    for one in facts["offenders"][:OFFENDERS_SHOWN]:
        say("offender", f"{one['number']}: {one['worst_edge_loses_cy_px']:.4f} cy/px")
    if facts["agreement"]["traced"]:
        own = facts["agreement"]
        say(
            "traced lenses",
            f"{own['traced']}: MTF50 within {own['mtf50_most_cy_px']:.4f} cy/px, wavefront "
            f"{own['wavefront_rms_waves']:.3f} waves RMS",
        )
    for one in facts.get("raws", ()):
        say(
            f"raw of {one['camera']}",
            f"MTF50 within {one['apart_most_cy_px']:.4f} cy/px of the study, certificate "
            f"{one['certificate_total_rms']:.1e}",
        )
    for name in (*FILES, RAWS) if "raws" in facts else FILES:
        console.print(str(out / name), markup=False, highlight=False, soft_wrap=True)
