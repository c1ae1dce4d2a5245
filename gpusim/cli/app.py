"""The command line: which commands there are, and what becomes of errors."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from typing import Annotated

import typer

from gpusim.cli.commands.light import burst, export_web, irradiance, labels
from gpusim.cli.commands.look import cameras, chart, charts, devices, lens, preview, sensor
from gpusim.cli.commands.many import batch, pareto, stress, tolerance
from gpusim.cli.commands.measure import measure
from gpusim.cli.commands.pictures import develop
from gpusim.cli.commands.render import render
from gpusim.cli.commands.validate import validate
from gpusim.cli.files import DISK
from gpusim.cli.names import Commands
from gpusim.cli.stop import stopping
from gpusim.errors import UserError

app = typer.Typer(
    cls=Commands,
    name="gpusim",
    help="Simulate a camera: spectral radiance, a real lens, a real sensor, raw digital numbers.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the command line; a user's mistake is one screen on stderr and exit code 2."""
    warnings.showwarning = _show_warning
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the shell closed it: else a file of ours takes its number
            setattr(sys, name, open(os.devnull, "w"))
    for stream in (sys.stdout, sys.stderr):  # a terminal without the letters of a lens's name
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        with stopping():
            try:
                app()
            finally:
                sys.stdout.flush()  # a full disk is told here, not after the end
    except UserError as error:
        _refuse(error)
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            allowed = "as many letters as a file's name may have"
            _refuse(UserError("no such file: its name is too long", allowed=allowed))
        if error.errno not in DISK:
            raise
        # What is left in the buffer cannot be written either: Python would say so again.
        sys.stdout = open(os.devnull, "w")
        _refuse(UserError(f"the output cannot be written: {error.strerror}", field="stdout"))
    except MemoryError:
        _refuse(UserError("there is not enough memory", allowed="fewer pixels, or more memory"))


def _refuse(error: UserError) -> None:
    from gpusim.cli.screen import show_error

    if error.file is None and error.field is not None:
        error.field = _as_typed(error.field)
    show_error(error)
    sys.exit(2)


def _as_typed(field: str) -> str:
    """Return a field as the option that was typed for it; as it is where none was.

    An option may lack the unit at the field's end: ``temperature_c`` is ``--temperature``.
    """
    typed = {word.partition("=")[0] for word in sys.argv[1:] if word.startswith("--")}
    option = "--" + field.replace("_", "-")
    return next((one for one in (option, option.rpartition("-")[0]) if one in typed), field)


def _version(asked: bool) -> None:
    if asked:
        from gpusim import __version__

        print(f"gpusim {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Simulate a camera: spectral radiance, a real lens, a real sensor, raw digital numbers."""


def _show_warning(message: Warning | str, category: type[Warning], *_: object) -> None:
    """Print a warning as the error screen is printed: without the line of code that gave it.

    What libraries tell their programmers, that a name of theirs will go, is not for the user.
    """
    from gpusim.cli.screen import show_warning

    if not issubclass(category, DeprecationWarning | PendingDeprecationWarning):
        show_warning(str(message))


# In the order of --help.
for _command in (
    render,
    irradiance,
    labels,
    burst,
    export_web,
    batch,
    preview,
    tolerance,
    chart,
    charts,
    cameras,
    lens,
    sensor,
    develop,
    pareto,
    stress,
    devices,
):
    app.command(name=_command.__name__.replace("_", "-"))(_command)
app.add_typer(measure, name="measure")
app.add_typer(validate, name="validate")
