"""``gpusim irradiance``: what the optics bring onto the sensor; and frames of such a file."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from rich.console import Console

from gpusim.camera import load_camera
from gpusim.cli import screen
from gpusim.cli.files import staging, whole_file
from gpusim.cli.render import exposure_seconds, rectangle_of
from gpusim.errors import UserError
from gpusim.isp.develop import develop
from gpusim.isp.dng import has_dng
from gpusim.isp.files import write_picture
from gpusim.isp.settings import Settings, check_ev
from gpusim.library.irradiance import Irradiance, band_images
from gpusim.library.recipe import recipe_of_frame
from gpusim.scene import make_scene
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, encode_srgb, rgb_to_xyz
from gpusim.scene.exr import write_exr
from gpusim.scene.spectra import WAVELENGTHS_NM, xyz

FORMATS = (".npz", ".exr")
MOST_BANDS = 200


def bands_of(text: str) -> np.ndarray:
    """Return the wavelengths that ``400:700:10`` or ``450,550,650`` names, nm."""
    try:
        if ":" in text:
            first, last, step = (float(one) for one in text.split(":"))
            if not (0 < step and first < last and (last - first) / step < MOST_BANDS):
                raise ValueError
            return np.arange(first, last + step / 2, step)
        return np.array([float(one) for one in text.split(",")])
    except ValueError:
        raise UserError(
            "no bands",
            field="--bands",
            value=text,
            allowed=f"FIRST:LAST:STEP in nm, up to {MOST_BANDS} bands; or 450,550,650",
        ) from None


def run(
    camera_name: str,
    scene_name: str,
    out: Path,
    *,
    bands: str,
    channels: bool,
    luminance_cd_m2: float | None,
    illuminant: str | None,
    tolerance: str,
    tile: str | None,
    quiet: bool,
) -> None:
    """Write the irradiance of a scene on a camera's sensor, and a picture of it beside.

    `channels`: in place of it what each channel collects at every pixel, electrons/s.
    """
    lines = bands_of(bands)
    camera = load_camera(camera_name)
    rectangle = None if tile is None else rectangle_of(tile)
    scene = make_scene(scene_name, luminance_cd_m2, illuminant, frame=camera.frame)
    with (
        whole_file(out, FORMATS) as file,
        screen.progress_bar(not quiet) as progress,
    ):
        given = {"tile": rectangle, "progress": progress}
        if channels:
            names = camera.sensor.channels
            own = camera.sensor.quantum_efficiency
            curves = np.stack([own.channels[name] for name in names])
            values = band_images(
                camera, scene, np.array(own.wavelengths_nm), curves, tolerance, **given
            )
            if file.suffix.lower() == ".exr":
                planes = {name: values[..., n] for n, name in enumerate(names)}
                write_exr(file, planes, units="e-/s")
            else:
                np.savez(file, electrons_per_s=values, channels=np.array(names))
            shown = _relative(values[..., [0, len(names) // 2, -1]])
        else:
            found = Irradiance.of(camera, scene, lines, tolerance, **given)
            found.save(file)
            values, shown = found.values, _colours(found)
        write_picture(file.with_suffix(".png"), shown)
    if not quiet:
        rows, cols, count = values.shape
        unit = "electrons/s" if channels else "W m^-2 nm^-1"
        text = f"{out}: {count} images of {cols} x {rows} pixels, up to {values.max():.4g} {unit}"
        Console().print(text, markup=False, highlight=False, soft_wrap=True)


def _colours(found: Irradiance) -> np.ndarray:
    """Return the picture that an eye would see of an irradiance, its brightest part white."""
    steps = np.stack(
        [
            np.interp(WAVELENGTHS_NM, found.wavelengths_nm, one, left=0, right=0)
            for one in np.eye(len(found.wavelengths_nm))
        ]
    )
    seen = found.values @ xyz(steps)
    return _relative(seen @ np.linalg.inv(rgb_to_xyz(REC709_CHROMATICITIES)).T)


def _relative(light: np.ndarray) -> np.ndarray:
    white = np.quantile(light, 0.995) or 1.0
    return np.round(255 * encode_srgb(light / white)).astype(np.uint8)


def capture(
    camera_name: str,
    file: Path,
    out: Path,
    *,
    exposure: str,
    temperature_c: float | None,
    gain: float | None,
    iso: int | None,
    ev: float,
    seed: int,
    frame: int,
    noise: bool,
    sensor: str | None,
    show: str,
) -> None:
    """Read an irradiance with a camera's sensor into the folder `out`: raw, picture, facts."""
    check_ev(ev)
    exposure_s = exposure_seconds(exposure)
    camera = load_camera(camera_name, None, sensor)
    light = Irradiance.load(file).light(camera.sensor, file.name)
    taken = light.capture(
        exposure_s,
        iso=iso,
        gain=gain,
        seed=seed,
        frame=frame,
        temperature_c=temperature_c,
        noise=noise,
    )
    with staging(out) as folder:
        raw = folder / ("raw.dng" if has_dng(taken.light.sensor) else "raw.tif")
        now = datetime.now(UTC)
        taken.write_raw(raw, ev, now)
        write_picture(folder / "developed.png", develop(raw, Settings()).picture)
        facts = {
            "irradiance": str(file),
            "camera": camera.title,
            "exposure_s": exposure_s,
            "seed": seed,
            "frame": frame,
            "saturated": float(taken.saturated.mean()),
            "mean_dn": float(taken.raw.mean()),
            "files": [raw.name, "developed.png", "capture.json"],
            "recipe": recipe_of_frame(taken, raw, now, ev=ev),
        }
        (folder / "capture.json").write_text(json.dumps(facts, indent=1) + "\n")
    if show == "json":
        print(json.dumps(facts, indent=1))
    elif show == "table":
        text = f"{taken!r}\nfiles in {out}: {', '.join(facts['files'])}"
        Console().print(text, markup=False, highlight=False, soft_wrap=True)
