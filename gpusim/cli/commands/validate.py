"""The papers, reproduced: ``gpusim validate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.names import Commands
from gpusim.cli.options import (
    Adapter,
    choose_adapter,
)

validate = typer.Typer(
    cls=Commands,
    name="validate",
    help="Reproduce published validations of camera simulators with this engine.",
    no_args_is_help=True,
)

ReportFolder = Annotated[
    Path, typer.Option(metavar="DIR", help="Folder for the report and figures.")
]
OwnTracer = Annotated[
    bool,
    typer.Option(
        "--own-tracer",
        help="Predict by gpusim's float64 tracer, which is not independent, not by optiland.",
    ),
]


@validate.callback()
def _validations() -> None:
    """Reproduce published validations of camera simulators with this engine."""


@validate.command()
def kodak(out: ReportFolder, own_tracer: OwnTracer = False, adapter: Adapter = None) -> None:
    """Short, Williams & Jones 1999: edges, PSFs, effects of the camera, noise against predictions.

    Writes kodak.html, kodak.json, the figures, and validation-kodak.md. Predictions are optiland's
    (extra judges). Exit code 1 where a bar is not held.
    """
    from gpusim.cli.validate import kodak as run

    choose_adapter(adapter)
    if code := run(out, own_tracer=own_tracer):
        raise typer.Exit(code)


@validate.command()
def ansys(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the report and figures.")],
    adapter: Adapter = None,
) -> None:
    """Ansys and Meta: distortion and spatial frequencies of an AR/VR camera against rays.

    Writes ansys.html, ansys.json, the figures, and validation-ansys.md. Exit code 1 where a bar is
    not held.
    """
    from gpusim.cli.validate import ansys as run

    choose_adapter(adapter)
    if code := run(out):
        raise typer.Exit(code)


@validate.command()
def samsung(out: ReportFolder, own_tracer: OwnTracer = False, adapter: Adapter = None) -> None:
    """Shin et al. (Samsung, Ansys): edges, corners, QE, colour and noise against predictions.

    Writes samsung.html, samsung.json, the figures, and validation-samsung.md. Predictions are
    optiland's (extra judges) and equations'. Exit code 1 where a bar is not held.
    """
    from gpusim.cli.validate import samsung as run

    choose_adapter(adapter)
    if code := run(out, own_tracer=own_tracer):
        raise typer.Exit(code)
