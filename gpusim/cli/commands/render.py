"""gpusim render."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.options import (
    Adapter,
    BestEffort,
    Certify,
    FNumber,
    FocalLength,
    FocusDistance,
    FocusShift,
    Luminance,
    ObjectDistance,
    choose_adapter,
    folder_of,
    only,
)
from gpusim.errors import UserError


def render(
    context: typer.Context,
    camera: Annotated[
        str | None, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")
    ] = None,
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            help="A chart name, a chart's .yaml, or a picture; or the .npz or .exr of an "
            "irradiance, in place of scene and lens.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the files; --dry-run needs none."),
    ] = None,
    recipe: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="JSON",
            help="Make the raw again that this file lies beside: no other options, but for --out, "
            "--quiet, --json and --adapter.",
        ),
    ] = None,
    exposure: Annotated[
        str, typer.Option(metavar="SECONDS", help="Exposure time: 0.01 or 1/60.")
    ] = "1/60",
    temperature: Annotated[
        float | None,
        typer.Option(metavar="C", help="Of the sensor, in Celsius; that of its data if not given."),
    ] = None,
    luminance: Luminance = None,
    illuminant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Light on a chart or on reflectances: D50, A, FL2, ...; daylight: D57; a "
            "blackbody: 5100K; or a spectrum: .csv, .json, .spdx of IES TM-27.",
        ),
    ] = None,
    illumination: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Map of uneven light on a photograph: a grey EXR, relative."
        ),
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="What light a TIFF's or PNG's values stand for: srgb, linear, rec709, gamma2.2, "
            "or the table of a film or screen: FILE.cube.",
        ),
    ] = None,
    upsampling: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Spectra of an RGB picture: mallett-2019 if not given, jakob-2019, smits-1999.",
        ),
    ] = None,
    chart_height: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="How large a chart stands in the scene, of what fills the sensor's height "
            "otherwise: 850mm at the object's distance, or an angle, 40deg.",
        ),
    ] = None,
    projection: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How the scene lies: rectilinear, to 85 degrees off the axis; angular, to 180; "
            "equirectangular, for a photograph that is a panorama.",
        ),
    ] = "rectilinear",
    labels: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="MAP",
            help="Depth, albedo, classes of the scene, a .npy or .png laid as a photograph: on the "
            "raw's pixels as labels-MAP beside it, 0 where it does not reach. May be repeated.",
        ),
    ] = None,
    tolerance: Annotated[
        str,
        typer.Option(
            metavar="E",
            help="Error allowed: 1e-3 of the local signal, 0.1sigma of a pixel's noise, or "
            "'as good as 0.4 s allows'.",
        ),
    ] = "1e-3",
    certify: Certify = None,
    gain: Annotated[
        float | None,
        typer.Option(metavar="G", help="Analogue gain: a step that the sensor file lists."),
    ] = None,
    iso: Annotated[
        int | None,
        typer.Option(metavar="S", help="The same by the ISO speed that the sensor file lists."),
    ] = None,
    ev: Annotated[
        float, typer.Option(metavar="STOPS", help="Show the picture brighter by so many stops.")
    ] = 0.0,
    seed: Annotated[
        int, typer.Option(min=0, max=2**64 - 1, help="Seed of the noise, of all frames.")
    ] = 7,
    frame: Annotated[
        int,
        typer.Option(
            min=0,
            max=2**32 - 1,
            help="Frame number: new noise, same sensor. Count it on in a burst; shots of a "
            "bracket, by exposure or gain, have noise of their own without.",
        ),
    ] = 0,
    tile: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="Render this rectangle of the frame alone."),
    ] = None,
    tile_size: Annotated[
        int | None, typer.Option(metavar="PX", min=1, help="Side of a tile; planned if not given.")
    ] = None,
    memory: Annotated[
        str | None,
        typer.Option(metavar="SIZE", help="Budget of GPU memory: 512MiB; 1GiB if not given."),
    ] = None,
    keep: Annotated[
        str, typer.Option(metavar="PLANES", help="Planes to keep as EXR: electrons,rate.")
    ] = "",
    method: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="fft, direct or modes; planned if not given."),
    ] = None,
    plan: Annotated[
        Path | None,
        typer.Option(
            metavar="REPORT", help="Plan as in this report.json: the same raw, byte for byte."
        ),
    ] = None,
    noise: Annotated[
        bool, typer.Option(help="Draw noise and fixed patterns; else the mean signal.")
    ] = True,
    best_effort: BestEffort = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Show the plan; render and write nothing.")
    ] = False,
    focal_length: FocalLength = None,
    f_number: FNumber = None,
    object_distance: ObjectDistance = None,
    focus_distance: FocusDistance = None,
    focus_shift: FocusShift = None,
    sensor: Annotated[
        str | None,
        typer.Option("--sensor", metavar="SENSOR", help="Another sensor: a preset or a file."),
    ] = None,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Show nothing but mistakes.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the report as JSON, no table.")
    ] = False,
    adapter: Adapter = None,
) -> None:
    """Render a capture: raw.dng (.tif where DNG has no such filters), developed.png, report.

    The picture is as bright as its exposure makes it: white is where the first channel saturates.

    Exit code 1 where the certificate does not meet the tolerance (the files are written), 2 for
    mistakes: a tolerance that cannot be met is one, and is refused before the work.
    """
    from gpusim.cli.render import RenderOptions, run

    choose_adapter(adapter)
    show = "json" if as_json else "nothing" if quiet else "table"
    out = folder_of(out, needed=not dry_run)
    if recipe is not None:
        from gpusim.cli import again

        only(context, "--from", "recipe", "out", "as_json", "quiet", "adapter")
        if code := again.run(recipe, out, show):
            raise typer.Exit(code)
        return
    if camera is None or scene is None:
        raise UserError(
            "there is nothing to render",
            field="CAMERA" if camera is None else "SCENE",
            allowed="a camera and a scene; or --from a raw's JSON file",
        )
    from gpusim.library.irradiance import is_irradiance

    if is_irradiance(Path(scene)):
        from gpusim.cli.irradiance import capture

        read = "exposure", "temperature", "gain", "iso", "ev", "seed", "frame", "noise", "sensor"
        shown = "out", "as_json", "quiet", "adapter"
        only(context, "an irradiance", "camera", "scene", *read, *shown)
        capture(
            camera,
            Path(scene),
            out,
            exposure=exposure,
            temperature_c=temperature,
            gain=gain,
            iso=iso,
            ev=ev,
            seed=seed,
            frame=frame,
            noise=noise,
            sensor=sensor,
            show=show,
        )
        return
    asked = RenderOptions(
        exposure=exposure,
        temperature_c=temperature,
        luminance_cd_m2=luminance,
        illuminant=illuminant,
        illumination=illumination,
        transfer=transfer,
        upsampling=upsampling,
        chart_height=chart_height,
        projection=projection,
        labels=tuple(labels or ()),
        tolerance=tolerance,
        probes=certify,
        gain=gain,
        iso=iso,
        ev=ev,
        seed=seed,
        frame=frame,
        tile=tile,
        tile_px=tile_size,
        memory=memory,
        keep=keep,
        noise=noise,
        method=method,
        plan=plan,
        best_effort=best_effort,
        lens={
            "focal_length_mm": focal_length,
            "f_number": f_number,
            "object_distance_m": object_distance,
            "focus_distance_m": focus_distance,
            "focus_shift_um": focus_shift,
        },
        sensor=sensor,
    )
    if code := run(camera, scene, out, asked, dry_run=dry_run, show=show):
        raise typer.Exit(code)
