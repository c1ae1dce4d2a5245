"""Many renders: batches, tolerance studies, error against run time, extreme cases."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.options import (
    Adapter,
    BestEffort,
    choose_adapter,
    folder_of,
)


def batch(
    sweep: Annotated[Path, typer.Argument(metavar="SWEEP", help="A YAML file: see docs/batch.md.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Folder for frames, table and page; --dry-run needs none."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the frames that are in the folder.")
    ] = False,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Processes on this machine; one an adapter is best.")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Dask scheduler to work on: tcp://host:8786."),
    ] = None,
    fail_fast: Annotated[
        bool, typer.Option("--fail-fast", help="End with the first frame that fails.")
    ] = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Count frames, lights, disk and the planner's time; render nothing."
        ),
    ] = False,
    status: Annotated[
        bool, typer.Option("--status", help="Say how many frames are there; render nothing.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show nothing but mistakes.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the account as JSON.")] = False,
    adapter: Adapter = None,
) -> None:
    """Render a sweep: every frame with a sidecar, one table, one page.

    What a run leaves when it is interrupted or killed, --resume goes on with. Exit code 1 where
    frames failed or a certificate does not meet the tolerance.
    """
    choose_adapter(adapter)
    if scheduler is None and not dry_run and not status:
        from gpusim.batch.cluster import prepare_workers

        prepare_workers()  # while the rest is imported here
    from gpusim.cli.batch import run_batch

    if code := run_batch(
        sweep,
        folder_of(out, needed=not dry_run),
        resume=resume,
        workers=workers,
        scheduler=scheduler,
        fail_fast=fail_fast,
        dry_run=dry_run,
        only_status=status,
        show="json" if as_json else "nothing" if quiet else "table",
    ):
        raise typer.Exit(code)


def tolerance(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A camera's name or file.")],
    budget: Annotated[
        Path, typer.Option(metavar="FILE", help="What varies, a YAML file: docs/tolerance.md.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for page, figure and tables.")],
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the study that is in the folder.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the account as JSON.")] = False,
) -> None:
    """Perturb a camera's lens: MTF50 of edges at nine places, yield and worst offenders."""
    from gpusim.cli.tolerance import run_tolerance

    run_tolerance(camera, budget, out, resume=resume, as_json=as_json)


def pareto(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="A chart name, a chart's .yaml, or a picture.")
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    exposure: Annotated[
        str, typer.Option(metavar="SECONDS", help="Exposure time: 0.01 or 1/60.")
    ] = "1/60",
    tolerance: Annotated[
        str, typer.Option(metavar="E", help="What the chosen plan is made for: 1e-3, 0.1sigma.")
    ] = "1e-3",
    certify: Annotated[
        int, typer.Option(metavar="N", min=0, help="Probes that certify every plan.")
    ] = 128,
    whole: Annotated[
        bool, typer.Option("--whole", help="The whole sensor, not 512 pixels about its centre.")
    ] = False,
    best_effort: BestEffort = False,
    adapter: Adapter = None,
) -> None:
    """Sweep tolerances and knobs: certified error against run time, as table and figure.

    The planner's regret is the time of the plan that it chooses over that of the fastest one found
    that meets the same tolerance. Exit code 1 where the chosen plan's certificate does not meet the
    tolerance (the files are written), 2 for mistakes: a tolerance that cannot be met is one.
    """
    from gpusim.cli.pareto import run

    choose_adapter(adapter)
    if code := run(
        camera,
        scene,
        out,
        exposure=exposure,
        tolerance=tolerance,
        probes=certify,
        whole=whole,
        best_effort=best_effort,
    ):
        raise typer.Exit(code)


def stress(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, no table.")] = False,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for stress.json.")] = None,
    adapter: Adapter = None,
) -> None:
    """Run the stiff and extreme cases: expected, got, verdict. Exit code 1 where one fails."""
    from gpusim.cli.stress import run

    choose_adapter(adapter)
    if code := run(as_json, out):
        raise typer.Exit(code)
