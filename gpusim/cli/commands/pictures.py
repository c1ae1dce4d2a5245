"""Raws developed into pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def develop(
    raw: Annotated[Path, typer.Argument(metavar="RAW", help="A raw file that LibRaw knows.")],
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="The picture to write: a .png or a .tif.")
    ],
    ev: Annotated[
        float | None,
        typer.Option(metavar="STOPS", help="Show the picture brighter by so many stops."),
    ] = None,
    binned: Annotated[
        bool, typer.Option("--binned", help="Of quad Bayer, one pixel for each cell of 2 x 2.")
    ] = False,
    bits: Annotated[
        int | None,
        typer.Option(metavar="N", help="Of each colour: 8 or 16; 8 of a .png and 16 of a .tif."),
    ] = None,
    engine: Annotated[
        str,
        typer.Option(metavar="NAME", help="gpusim, or to compare: libraw, by --ev and --binned."),
    ] = "gpusim",
    demosaic: Annotated[
        str | None, typer.Option(metavar="NAME", help="bilinear, malvar, directional or guided.")
    ] = None,
    white_balance: Annotated[
        str | None,
        typer.Option(
            metavar="WHITE",
            help="as-shot, grey-world, patch:ROW,COLUMN,ROWS,COLUMNS, D65 (any illuminant), 5100K.",
        ),
    ] = None,
    space: Annotated[
        str | None, typer.Option(metavar="NAME", help="srgb, p3, rec2020 or linear.")
    ] = None,
    matrix_fit: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Colours by a matrix fitted in xyz (ColorMatrix), or lab (Forward).",
        ),
    ] = None,
    roll_off: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Bend highlights into this share of the range."),
    ] = None,
    defects: Annotated[
        bool | None, typer.Option("--defects/--no-defects", help="Mend pixels that stand out.")
    ] = None,
    shading: Annotated[
        bool | None,
        typer.Option("--shading/--no-shading", help="Undo the lens's shading, where known."),
    ] = None,
    rectify: Annotated[
        bool | None,
        typer.Option(
            "--rectify/--no-rectify", help="Undo its distortion and lateral colour, where known."
        ),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="RAW",
            help="Take pedestal, white balance and colour matrices from another camera's file.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A .yaml as it is saved beside each picture."),
    ] = None,
) -> None:
    """Develop a raw file into a picture: by our own stages on the GPU, or through LibRaw."""
    from gpusim.cli.develop import run

    options = {
        "demosaic": demosaic,
        "white_balance": white_balance,
        "space": space,
        "matrix_fit": matrix_fit,
        "roll_off": roll_off,
        "defects": defects,
        "shading": shading,
        "rectify": rectify,
        "like": None if like is None else str(like),
    }
    run(
        raw,
        out,
        engine=engine,
        binned=binned,
        bits=bits,
        ev=ev,
        settings_file=settings,
        options=options,
    )
