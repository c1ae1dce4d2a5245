"""What there is, looked at: cameras, charts, lenses, sensors, adapters; the preview."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.options import (
    Adapter,
    FNumber,
    FocalLength,
    FocusDistance,
    FocusShift,
    Luminance,
    ObjectDistance,
    choose_adapter,
)


def preview(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset or a camera file.")],
    scene: Annotated[str, typer.Argument(metavar="SCENE", help="A chart, or a picture's file.")],
    exposure: Annotated[
        str | None,
        typer.Option(metavar="SECONDS", help="0.01 or 1/100; by default by the scene's white."),
    ] = None,
    iso: Annotated[int | None, typer.Option(metavar="N", help="A step of the sensor's.")] = None,
    f_number: Annotated[float | None, typer.Option(min=0.1, metavar="N")] = None,
    focus_shift: Annotated[
        float | None, typer.Option(metavar="UM", help="Image plane moved away from the lens.")
    ] = None,
    sensor: Annotated[str | None, typer.Option(metavar="SENSOR", help="Another sensor.")] = None,
    lens_name: Annotated[
        str | None, typer.Option("--lens", metavar="LENS", help="Another prescription.")
    ] = None,
    luminance: Annotated[
        float | None, typer.Option(metavar="CD/M2", help="Luminance of the scene's white.")
    ] = None,
    illuminant: Annotated[
        str | None, typer.Option(metavar="NAME", help="Light on a chart.")
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="R", help="Of the picture at rest, as of gpusim render.")
    ] = "1e-2",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where saving writes.")] = Path(
        "out/preview"
    ),
    screenshot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="No window: save the screen, a .png, once it is refined."
        ),
    ] = None,
    script: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="No window: do the steps of a .json, see docs/preview.md."
        ),
    ] = None,
    adapter: Adapter = None,
) -> None:
    """Turn the knobs of a camera and look: a draft at once, the rendered picture at rest.

    Needs the extra: pip install 'gpusim[preview]'.
    """
    from gpusim.cli.preview import run
    from gpusim.cli.render import exposure_seconds

    choose_adapter(adapter)
    given = {
        "exposure_s": None if exposure is None else exposure_seconds(exposure),
        "iso": iso,
        "f_number": f_number,
        "focus_shift_um": focus_shift,
        "sensor": sensor,
        "lens": lens_name,
        "luminance_cd_m2": luminance,
        "illuminant": illuminant,
        "tolerance": tolerance,
    }
    run(camera, scene, given, out=out, screenshot=screenshot, script=script)


def chart(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A chart name, a chart's .yaml; with --bands a picture too."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="A .png (look) or .exr (radiance).")],
    bands: Annotated[
        str | None,
        typer.Option(
            metavar="BANDS",
            help="A spectral .exr of the radiance, W m^-2 sr^-1 nm^-1: FIRST:LAST:STEP in nm, or "
            "450,550,650.",
        ),
    ] = None,
    luminance: Luminance = None,
    illuminant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Light on a chart or on reflectances: as of gpusim render."
        ),
    ] = None,
    transfer: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What a TIFF's or PNG's values are: as of render."),
    ] = None,
    upsampling: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Spectra of an RGB picture: as of gpusim render."),
    ] = None,
) -> None:
    """Draw a test chart, or write the spectral radiance of a chart or picture."""
    from gpusim.cli.chart import run

    light = {"luminance_cd_m2": luminance, "illuminant": illuminant}
    run(name, out, bands, **light, transfer=transfer, upsampling=upsampling)


def charts() -> None:
    """List the charts."""
    from rich.console import Console

    from gpusim.cli.chart import library

    Console().print(library())


def cameras() -> None:
    """List the cameras that come with the package."""
    from rich.console import Console

    from gpusim.cli.cameras import library

    Console().print(library())


def lens(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[LENS]",
            help="A preset name, a .yaml, .zmx, .seq or .dat file; or ready-made PSFs: a .nc or "
            ".npz bank, an ISETCam folder, a .yaml of Zemax exports or of an MTF table. Without "
            "it, the presets.",
        ),
    ] = None,
    focal_length: FocalLength = None,
    f_number: FNumber = None,
    object_distance: ObjectDistance = None,
    focus_distance: FocusDistance = None,
    focus_shift: FocusShift = None,
    nearest_glasses: Annotated[
        bool,
        typer.Option(
            "--nearest-glasses",
            help="Take the nearest catalogue glass where the file knows nd and Vd alone.",
        ),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="PSF bank as .nc, one page as .png, or the page with all figures as .html.",
        ),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Every figure as a .png: layout, ray and OPD fans, spots, wavefront with Zernike "
            "terms, field curvature, colour, distortion, MTF, encircled energy, angles.",
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Every figure's numbers, a .csv each.")
    ] = None,
    json: Annotated[
        Path | None, typer.Option(metavar="FILE", help="All figures' numbers as one .json.")
    ] = None,
    beside: Annotated[
        str | None,
        typer.Option(
            "--with",
            metavar="LENS|SETTING",
            help="Lay a second lens over the first in all figures, or the same one at another "
            "setting: tessar, f-number=4, or tessar,focal-length=50,f-number=4.",
        ),
    ] = None,
    frequency: Annotated[
        float | None,
        typer.Option(
            metavar="CY_MM", help="Spatial frequency of the MTF through focus and over the field."
        ),
    ] = None,
) -> None:
    """Show what a lens does: first-order data, PSFs, aberrations, MTF, distortion, colour.

    Exit code 1 where a figure that the lens's source states is not met.
    """
    from gpusim.cli.lens import run
    from gpusim.cli.lens_plots import Setting, Wanted

    run(
        name,
        Setting(
            focal_length, f_number, object_distance, focus_distance, focus_shift, nearest_glasses
        ),
        out,
        Wanted(
            beside,
            frequency,
            figures,
            csv,
            json,
            page=out is not None and out.suffix.lower() == ".html",
        ),
    )


def sensor(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="[SENSOR]",
            help="A preset name or a sensor file (.yaml); a Speos sensor (.yaml); an ISETCam "
            "sensor (.mat or .json). Without it, the presets.",
        ),
    ] = None,
    fields: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="FIELD=VALUE", help="Set a field by hand; repeatable."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The sensor file to write, a .yaml.")
    ] = None,
) -> None:
    """Show a sensor's data sheet with the source of each figure; convert others' files."""
    from gpusim.cli.sensor import run

    run(name, fields or [], out)


def devices(
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="Measure the planner's rates again: a few seconds."),
    ] = False,
) -> None:
    """List the graphics adapters, their limits, and the measured rates that plans are made from."""
    from gpusim.cli.devices import run

    run(calibrate)
