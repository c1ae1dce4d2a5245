"""Options that several commands have, and what they do."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from gpusim.errors import UserError

Adapter = Annotated[
    str | None,
    typer.Option("--adapter", metavar="NAME", help="Graphics adapter, by a part of its name."),
]

Certify = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=0,
        help="Probe pixels of the certificate, 0: none; by default as many as settle it, 64 to "
        "256.",
    ),
]
Luminance = Annotated[
    float | None,
    typer.Option(
        metavar="CD_M2",
        help="Luminance of the scene's white, in cd/m^2; 300 where nothing says it.",
    ),
]
BestEffort = Annotated[
    bool,
    typer.Option(
        "--best-effort",
        help="Where the tolerance cannot be met, come as near as can be; else it is refused.",
    ),
]

FocalLength = Annotated[
    float | None, typer.Option(metavar="MM", help="Scale the lens to this focal length.")
]
FNumber = Annotated[
    float | None, typer.Option(metavar="N", help="Stop the lens down to this f-number.")
]
ObjectDistance = Annotated[
    float | None,
    typer.Option(metavar="M", help="Where the scene lies: a plane so far from the first surface."),
]
FocusDistance = Annotated[
    float | None,
    typer.Option(metavar="M", help="What the lens is focused on; the scene if not given."),
]
FocusShift = Annotated[
    float | None,
    typer.Option(metavar="UM", help="Move the image plane, > 0 away from the lens."),
]

Picture = Annotated[
    Path,
    typer.Argument(
        metavar="PICTURE",
        help="A raw frame (DNG and what LibRaw reads), .exr, .npy, .png, .jpg or .tif.",
    ),
]
Linear = Annotated[
    bool, typer.Option("--linear", help="Codes of a PNG, JPEG or TIFF are linear, not sRGB.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, no table.")]
Channels = Annotated[
    str | None,
    typer.Option(
        "--channel", metavar="R,G,...", help="Channels, by comma; by default all of the picture."
    ),
]
OutFolder = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Folder for the files: .json, .csv, .html and .png."),
]


def only(context: typer.Context, option: str, *allowed: str) -> None:
    """Refuse all options that were given on the command line, but for some.

    Raises
    ------
    UserError
    """
    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name)
        if source is not None and source.name == "COMMANDLINE" and parameter.name not in allowed:
            raise UserError(
                f"{option} takes all from its file",
                field=parameter.opts[-1] if parameter.opts[-1].startswith("-") else parameter.name,
                value=context.params[parameter.name],
                allowed=f"{option} without it",
            )


def folder_of(out: Path | None, *, needed: bool) -> Path:
    """Return the folder for a command's files, this one where none is needed and none is given.

    Raises
    ------
    UserError
        There is none, and the command writes files.
    """
    if out is None and needed:
        raise UserError(
            "there is no folder for the files",
            field="--out",
            allowed="a folder, which is made if need be; --dry-run needs none",
        )
    return out or Path()


def choose_adapter(name: str | None) -> None:
    """Make the named adapter the one that this process opens."""
    if name is not None:
        os.environ["GPUSIM_ADAPTER"] = name
