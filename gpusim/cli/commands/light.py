"""What reaches a sensor, kept: irradiance, labels, bursts, pages for browsers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.options import (
    Adapter,
    BestEffort,
    Certify,
    Luminance,
    choose_adapter,
)


def irradiance(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A chart name or a picture.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The file to write: .npz or .exr.")],
    bands: Annotated[
        str, typer.Option(metavar="NM", help="Bands: FIRST:LAST:STEP, or 450,550,650.")
    ] = "400:700:10",
    channels: Annotated[
        bool,
        typer.Option(
            "--channels",
            help="In place of bands an image of every pixel for each of the sensor's channels, as "
            "without a filter array: electrons/s.",
        ),
    ] = False,
    luminance: Luminance = None,
    illuminant: Annotated[
        str | None, typer.Option(metavar="NAME", help="Light on a chart: D50, A, ..., 5100K.")
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="E", help="Relative error of the mean signal.")
    ] = "1e-3",
    tile: Annotated[
        str | None, typer.Option(metavar="X,Y,W,H", help="Only this rectangle of lit pixels.")
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show nothing but mistakes.")
    ] = False,
    adapter: Adapter = None,
) -> None:
    """Write the spectral irradiance on the sensor, W m^-2 nm^-1, with a picture beside it."""
    from gpusim.cli.irradiance import run

    choose_adapter(adapter)
    run(
        camera,
        scene,
        out,
        bands=bands,
        channels=channels,
        luminance_cd_m2=luminance,
        illuminant=illuminant,
        tolerance=tolerance,
        tile=tile,
        quiet=quiet,
    )


def labels(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    path: Annotated[
        Path, typer.Argument(metavar="MAP", help="Depth, albedo, classes: a .npy or a .png.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The file to write: .npy or .png.")],
    beyond: Annotated[
        float, typer.Option(metavar="VALUE", help="Label of what the map does not reach.")
    ] = 0.0,
    projection: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="That of the scene: rectilinear, angular, or equirectangular.",
        ),
    ] = "rectilinear",
) -> None:
    """Bring a scene's labels onto the sensor through the lens's distortion, without blur."""
    from gpusim.cli.labels import run

    run(camera, path, out, beyond, projection)


def burst(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A chart name or an EXR file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    frames: Annotated[int, typer.Option(metavar="N", help="How many frames are read.")] = 8,
    exposure: Annotated[
        str | None,
        typer.Option(
            metavar="SECONDS",
            help="Exposure times, in turns: 1/240,1/60; by default white at 71 % of saturation.",
        ),
    ] = None,
    iso: Annotated[
        str | None, typer.Option(metavar="SPEEDS", help="ISO speeds, in turns: 100,400.")
    ] = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="Keep the mean signal too, in DN, without noise.")
    ] = False,
    form: Annotated[
        str, typer.Option("--format", metavar="KIND", help="npz (all in one), dng or exr.")
    ] = "npz",
    seed: Annotated[
        int, typer.Option(metavar="N", help="Of the noise; frames of one seed are independent.")
    ] = 0,
    temperature: Annotated[
        float | None,
        typer.Option(metavar="C", help="Of the sensor, in Celsius; that of its data if not given."),
    ] = None,
    luminance: Luminance = None,
    illuminant: Annotated[
        str | None, typer.Option(metavar="NAME", help="Light on a chart: D50, A, ..., 5100K.")
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="E", help="Relative error of the mean signal, or 0.1sigma.")
    ] = "1e-3",
    certify: Certify = None,
    tile: Annotated[
        str | None, typer.Option(metavar="X,Y,W,H", help="Only this rectangle of lit pixels.")
    ] = None,
    best_effort: BestEffort = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show nothing but mistakes.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print burst.json.")] = False,
    adapter: Adapter = None,
) -> None:
    """Read one light many times: bursts and brackets, with what each frame's truth is.

    The optics run once; each frame costs the sensor alone. Exit code 1 where the certificate does
    not meet the tolerance.
    """
    from gpusim.cli.burst import run

    choose_adapter(adapter)
    if code := run(
        camera,
        scene,
        out,
        frames=frames,
        exposure=exposure,
        iso=iso,
        truth=truth,
        form=form,
        seed=seed,
        temperature_c=temperature,
        luminance_cd_m2=luminance,
        illuminant=illuminant,
        tolerance=tolerance,
        probes=certify,
        tile=tile,
        best_effort=best_effort,
        show="json" if as_json else "nothing" if quiet else "table",
    ):
        raise typer.Exit(code)


def export_web(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A chart name or an EXR file.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the page.")],
    tile: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="This rectangle; else the middle, 960 x 720."),
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="E", help="Relative error of the mean signal, or 0.1sigma.")
    ] = "1e-3",
    certify: Certify = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the noise.")] = 0,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show nothing but mistakes.")
    ] = False,
    adapter: Adapter = None,
) -> None:
    """Write a page for browsers: exposure, gain, noise, pan and zoom by the same shaders.

    The light is made here; the page reads it out and develops it with WebGPU, without Python.
    """
    from gpusim.cli.web import run

    choose_adapter(adapter)
    run(
        camera,
        scene,
        out,
        tile=tile,
        tolerance=tolerance,
        probes=certify,
        seed=seed,
        show=not quiet,
    )
