"""The commands and their options. Each imports what it needs: ``--help`` answers at once."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from gpusim.cli.files import DISK
from gpusim.cli.stop import stopping
from gpusim.errors import UserError

app = typer.Typer(
    name="gpusim",
    help="Simulate a camera: spectral radiance, a real lens, a real sensor, raw digital numbers.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

Adapter = Annotated[
    str | None,
    typer.Option("--adapter", metavar="NAME", help="Graphics adapter, by a part of its name."),
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


def main() -> None:
    """Run the command line; a user's mistake is one screen on stderr and exit code 2."""
    warnings.showwarning = _show_warning
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

    show_error(error)
    sys.exit(2)


def _version(asked: bool) -> None:
    if asked:
        from gpusim import __version__

        print(f"gpusim {__version__}")
        raise typer.Exit


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


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Simulate a camera: spectral radiance, a real lens, a real sensor, raw digital numbers."""


def _show_warning(message: Warning | str, *_: object) -> None:
    """Print a warning as the error screen is printed: without the line of code that gave it."""
    from gpusim.cli.screen import show_warning

    show_warning(str(message))


@app.command()
def render(
    context: typer.Context,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the files.")],
    camera: Annotated[
        str | None, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")
    ] = None,
    scene: Annotated[
        str | None,
        typer.Argument(
            metavar="SCENE",
            help="A chart name, a chart's .yaml, or a picture; or the .npz of an irradiance, in "
            "place of scene and lens.",
        ),
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
    luminance: Annotated[
        float | None,
        typer.Option(metavar="CD_M2", help="Luminance of the scene's white, in cd/m^2."),
    ] = None,
    illuminant: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Light on a chart or on reflectances: D50, A, FL2, ...; a blackbody: 5100K; or a "
            "spectrum: .csv, .json, .spdx of IES TM-27.",
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
    tolerance: Annotated[
        str,
        typer.Option(
            metavar="E",
            help="Error allowed: 1e-3 of the local signal, 0.1sigma of a pixel's noise, or "
            "'as good as 0.4 s allows'.",
        ),
    ] = "1e-3",
    certify: Annotated[
        int, typer.Option(metavar="N", min=0, help="Probes of the certificate; 0 for none.")
    ] = 256,
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
    from gpusim.cli.render import run

    choose_adapter(adapter)
    show = "json" if as_json else "nothing" if quiet else "table"
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
    if scene.lower().endswith(".npz"):
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
    if code := run(
        camera,
        scene,
        out,
        exposure=exposure,
        temperature_c=temperature,
        luminance_cd_m2=luminance,
        illuminant=illuminant,
        illumination=illumination,
        transfer=transfer,
        upsampling=upsampling,
        chart_height=chart_height,
        projection=projection,
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
        dry_run=dry_run,
        lens={
            "focal_length_mm": focal_length,
            "f_number": f_number,
            "object_distance_m": object_distance,
            "focus_distance_m": focus_distance,
            "focus_shift_um": focus_shift,
        },
        sensor=sensor,
        show=show,
    ):
        raise typer.Exit(code)


@app.command()
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
    luminance: Annotated[
        float | None,
        typer.Option(metavar="CD_M2", help="Luminance of the scene's white, in cd/m^2."),
    ] = None,
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


@app.command()
def labels(
    camera: Annotated[str, typer.Argument(metavar="CAMERA", help="A preset name or a YAML file.")],
    path: Annotated[
        Path, typer.Argument(metavar="MAP", help="Depth, albedo, classes: a .npy or a .png.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The file to write: .npy or .png.")],
    beyond: Annotated[
        float, typer.Option(metavar="VALUE", help="Label of what the map does not reach.")
    ] = 0.0,
) -> None:
    """Bring a scene's labels onto the sensor through the lens's distortion, without blur."""
    from gpusim.cli.labels import run

    run(camera, path, out, beyond)


@app.command()
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
    luminance: Annotated[
        float | None,
        typer.Option(metavar="CD_M2", help="Luminance of the scene's white, in cd/m^2."),
    ] = None,
    illuminant: Annotated[
        str | None, typer.Option(metavar="NAME", help="Light on a chart: D50, A, ..., 5100K.")
    ] = None,
    tolerance: Annotated[
        str, typer.Option(metavar="E", help="Relative error of the mean signal, or 0.1sigma.")
    ] = "1e-3",
    certify: Annotated[
        int, typer.Option(metavar="N", help="Probe pixels of the certificate; 0: none.")
    ] = 64,
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


@app.command(name="export-web")
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
    certify: Annotated[
        int, typer.Option(metavar="N", min=0, help="Probe pixels of the certificate; 0: none.")
    ] = 64,
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


@app.command()
def batch(
    sweep: Annotated[Path, typer.Argument(metavar="SWEEP", help="A YAML file: see docs/batch.md.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for frames, table and page.")],
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
        bool, typer.Option("--dry-run", help="Count frames, lights and disk; render nothing.")
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
    from gpusim.cli.batch import run_batch

    choose_adapter(adapter)
    if code := run_batch(
        sweep,
        out,
        resume=resume,
        workers=workers,
        scheduler=scheduler,
        fail_fast=fail_fast,
        dry_run=dry_run,
        only_status=status,
        show="json" if as_json else "nothing" if quiet else "table",
    ):
        raise typer.Exit(code)


@app.command()
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
    run(camera, scene, given, out, screenshot, script)


@app.command()
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


@app.command()
def chart(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A chart name, or a chart's .yaml.")],
    out: Annotated[Path, typer.Option(metavar="FILE", help="A .png (look) or .exr (radiance).")],
) -> None:
    """Draw a test chart."""
    from gpusim.cli.chart import run

    run(name, out)


@app.command()
def charts() -> None:
    """List the charts."""
    from rich.console import Console

    from gpusim.cli.chart import library

    Console().print(library())


@app.command()
def cameras() -> None:
    """List the cameras that come with the package."""
    from rich.console import Console

    from gpusim.cli.cameras import library

    Console().print(library())


@app.command()
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


@app.command()
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


@app.command()
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
        str | None, typer.Option(metavar="NAME", help="bilinear, malvar or directional.")
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


@app.command()
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


measure = typer.Typer(
    name="measure", help="Measure what a camera does, from its images.", no_args_is_help=True
)
app.add_typer(measure)


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
    if code := run(path, sensor, out, keep, side, seed, as_json, sensor_out):
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
    channel: Channels = None,
    out: OutFolder = None,
    linear: Linear = False,
    as_json: AsJson = False,
) -> None:
    """Measure sinusoidal patterns: frequency, amplitude, modulation, with uncertainties."""
    from gpusim.cli.spectra import spectra as run

    run(path, roi or [], channel, out, linear=linear, as_json=as_json)


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


validate = typer.Typer(
    name="validate",
    help="Reproduce published validations of camera simulators with this engine.",
    no_args_is_help=True,
)
app.add_typer(validate)


@validate.callback()
def _validations() -> None:
    """Reproduce published validations of camera simulators with this engine."""


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


@validate.command()
def kodak(out: ReportFolder, own_tracer: OwnTracer = False, adapter: Adapter = None) -> None:
    """Short, Williams & Jones 1999: edge positions, lateral colour and MTF against predictions.

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
    """Shin et al. (Samsung, Ansys): edges, QE, colour and noise against predictions.

    Writes samsung.html, samsung.json, the figures, and validation-samsung.md. Predictions are
    optiland's (extra judges) and equations'. Exit code 1 where a bar is not held.
    """
    from gpusim.cli.validate import samsung as run

    choose_adapter(adapter)
    if code := run(out, own_tracer=own_tracer):
        raise typer.Exit(code)


@app.command()
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


@app.command()
def devices(
    calibrate: Annotated[
        bool,
        typer.Option("--calibrate", help="Measure the planner's rates again: a few seconds."),
    ] = False,
) -> None:
    """List the graphics adapters, their limits, and the measured rates that plans are made from."""
    from gpusim.cli.devices import run

    run(calibrate)


def choose_adapter(name: str | None) -> None:
    """Make the named adapter the one that this process opens."""
    if name is not None:
        os.environ["GPUSIM_ADAPTER"] = name
