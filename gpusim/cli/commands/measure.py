"""What pictures and frames say: ``gpusim measure``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.names import Commands
from gpusim.cli.options import (
    Adapter,
    AsJson,
    Channels,
    Linear,
    OutFolder,
    Picture,
    choose_adapter,
)

measure = typer.Typer(
    cls=Commands,
    name="measure",
    help="Measure what a camera does, from its images.",
    no_args_is_help=True,
)


@measure.command(name="all")
def everything(
    path: Picture,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for all files.")],
    wave: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,W,H", help="A region with one sinusoid, pixels; may be given again."
        ),
    ] = None,
    texture: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="A region of dead leaves, pixels, their radii as those of the chart dead-leaves.",
        ),
    ] = None,
    linear: Linear = False,
) -> None:
    """Measure all that a picture shows (edges, lattice, colours, greys, glare), on one page.

    Sinusoids and dead leaves are not sought: name their regions.
    """
    from gpusim.cli.everything import everything as run

    if code := run(path, out, waves=wave or [], leaves=texture, linear=linear):
        raise typer.Exit(code)


@measure.command()
def noise(
    path: Annotated[
        Path | None,
        typer.Argument(
            metavar="[PATH]",
            help="A folder of frames with their list, frames.csv: file, exposure_s, photons (per "
            "pixel, 0 in the dark) and wavelength_nm of each. camera.json may give the pattern. "
            "Or a data set in the layout of EMVA 1288's working group, with EMVA1288_Data.txt.",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(metavar="SENSOR", help="In place of frames: simulate this preset or file."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for noise.json, noise.html and noise.png."),
    ] = None,
    keep: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for the simulated frames and their list."),
    ] = None,
    sensor_out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Sensor file, a .yaml, to write of what was measured."),
    ] = None,
    side: Annotated[
        int, typer.Option(metavar="PX", min=32, help="Side of the part that is simulated.")
    ] = 512,
    seed: Annotated[
        int, typer.Option(min=0, max=2**64 - 1, help="Seed of the simulated noise.")
    ] = 7,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, no table.")] = False,
    adapter: Adapter = None,
) -> None:
    """Measure gain, noise and non-uniformity by EMVA 1288: the data sheet, with its plots.

    With --sensor, the loop is closed: exit code 1 where a figure of the sensor file is not
    recovered within its uncertainty.
    """
    from gpusim.cli.measure import noise as run

    choose_adapter(adapter)
    if code := run(
        path,
        sensor,
        out=out,
        keep=keep,
        side_px=side,
        seed=seed,
        as_json=as_json,
        sensor_out=sensor_out,
    ):
        raise typer.Exit(code)


@measure.command()
def sfr(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PICTURE",
            help="A raw frame (DNG and what LibRaw reads), .exr, .npy, .png, .jpg or .tif.",
        ),
    ],
    roi: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="A region with one slanted edge, pixels; may be given again. Without it edges are "
            "sought.",
        ),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(metavar="R,G,...", help="Channels, by comma; by default all of the picture."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for sfr.json, sfr.csv, sfr.html and sfr.png."),
    ] = None,
    linear: Annotated[
        bool,
        typer.Option("--linear", help="Codes of a PNG, JPEG or TIFF are linear, not sRGB."),
    ] = False,
    pitch_um: Annotated[
        float | None, typer.Option(min=1e-3, metavar="UM", help="Pixel pitch: for lp/mm and Q.")
    ] = None,
    f_number: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            metavar="N",
            help="With --pitch-um: Q, the area over that of a diffraction-limited lens.",
        ),
    ] = None,
    wavelength_nm: Annotated[
        float, typer.Option(min=100, max=20000, metavar="NM", help="Of the diffraction limit.")
    ] = 550.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, no table.")] = False,
) -> None:
    """Measure sharpness from slanted edges: SFR of ISO 12233, MTF50, angle, with uncertainties."""
    from gpusim.cli.sfr import sfr as run

    run(
        path,
        roi or [],
        channel,
        out,
        linear=linear,
        pitch_um=pitch_um,
        f_number=f_number,
        wavelength_nm=wavelength_nm,
        as_json=as_json,
    )


@measure.command()
def distortion(
    path: Picture,
    channel: Channels = None,
    centre: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y",
            help="Where the lens's axis meets the picture, px; by default its middle.",
        ),
    ] = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure distortion (LGD of ISO 17850) and lateral colour from a checkerboard or dots."""
    from gpusim.cli.distortion import distortion as run

    run(path, channel, centre, out, linear=linear, as_json=as_json)


@measure.command()
def colour(
    path: Picture,
    illuminant: Annotated[
        str, typer.Option(metavar="NAME", help="Light of the chart's colours: D65, A, 5100K ...")
    ] = "D65",
    corners: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,...",
            help="Middles of the corner patches, px: dark skin, bluish green, black, white. "
            "Without them the chart is sought.",
        ),
    ] = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure colours from a ColorChecker: xy, Delta E, white point, matrix, patch by patch."""
    from gpusim.cli.colour import colour as run

    run(path, illuminant, corners, out, linear=linear, as_json=as_json)


@measure.command()
def spectra(
    path: Picture,
    roi: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="A region with one sinusoid, pixels; may be given again. Without it the whole.",
        ),
    ] = None,
    distortion: Annotated[
        str | None,
        typer.Option(
            metavar="PERCENT|FILE",
            help="Local geometric distortion: a number, or the distortion.json of `gpusim measure "
            "distortion`. Shows each wave's frequency without it, and the ratio.",
        ),
    ] = None,
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure sinusoidal patterns: frequency, amplitude, modulation, with uncertainties."""
    from gpusim.cli.spectra import spectra as run

    run(path, roi or [], channel, out, distortion=distortion, linear=linear, as_json=as_json)


@measure.command()
def snr(
    path: Picture,
    roi: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="An even patch, pixels; may be given again. Without it a ColorChecker's greys are "
            "sought.",
        ),
    ] = None,
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure signal-to-noise ratio over a grey scale, and the dynamic range."""
    from gpusim.cli.snr import snr as run

    run(path, roi or [], channel, out, linear=linear, as_json=as_json)


@measure.command()
def shading(
    path: Picture,
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure shading, and that of colours, from a picture of an even field."""
    from gpusim.cli.shading import shading as run

    run(path, channel, out, linear=linear, as_json=as_json)


@measure.command()
def texture(
    path: Picture,
    roi: Annotated[
        str | None,
        typer.Option(metavar="X,Y,W,H", help="Region of leaves, pixels; by default the middle."),
    ] = None,
    leaves: Annotated[
        str | None,
        typer.Option(
            metavar="MIN,MAX",
            help="Radii of the leaves in the picture, pixels; by default those of the chart "
            "dead-leaves as high as the picture.",
        ),
    ] = None,
    second: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE", help="The scene once more: takes the noise off."),
    ] = None,
    even: Annotated[
        str | None,
        typer.Option("--noise", metavar="X,Y,W,H", help="An even patch: takes the noise off."),
    ] = None,
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure texture: the MTF of dead leaves, what is left of fine detail after denoising."""
    from gpusim.cli.texture import texture as run

    run(
        path,
        roi=roi,
        leaves=leaves,
        second=second,
        even=even,
        channels=channel,
        out=out,
        linear=linear,
        as_json=as_json,
    )


@measure.command()
def glare(
    path: Picture,
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure veiling glare (ISO 9358) from black spots in a bright field."""
    from gpusim.cli.glare import glare as run

    run(path, channel, out, linear=linear, as_json=as_json)
