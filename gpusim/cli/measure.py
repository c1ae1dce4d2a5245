"""``gpusim measure noise``."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

import gpusim
from gpusim.cli import screen
from gpusim.cli.files import staging, whole_file
from gpusim.cli.sensor import YAML
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.metrics import descriptor, flat_field, frames, loop
from gpusim.metrics.as_sensor import as_sensor
from gpusim.metrics.emva import Characterisation, characterise
from gpusim.metrics.figure import Figure
from gpusim.plan.stages import sensor_runs
from gpusim.report.drawing import png
from gpusim.report.noise_facts import (
    IN_THE_DARK,
    OF_A_CHANNEL,
    noise_facts,
    noise_rows,
    number,
    two_digits,
)
from gpusim.report.noise_figure import draw_noise
from gpusim.report.noise_html import noise_html
from gpusim.sensor.conversion import sensor_text
from gpusim.sensor.load import load_sensor

FILES = ("noise.json", "noise.csv", "noise.html", "noise.png")


@dataclass(frozen=True)
class _Measured:
    """What was measured, of which camera and from what; of a simulated sensor with verdicts."""

    found: Characterisation
    title: str
    how: str
    rows: Sequence[loop.Row] | None = None


def noise(
    path: Path | None,
    sensor_name: str | None,
    *,
    out: Path | None,
    keep: Path | None,
    side_px: int,
    seed: int,
    as_json: bool,
    sensor_out: Path | None,
) -> int:
    """Measure frames on disk, or a simulated sensor; return the exit code.

    It is 1 where a parameter of a simulated sensor is not recovered within its uncertainty.
    """
    _check(path, sensor_name, keep, sensor_out)
    with ExitStack() as stack:
        folder = stack.enter_context(staging(out)) if out is not None else None
        kept = frames.Kept(stack.enter_context(staging(keep))) if keep is not None else None
        progress = stack.enter_context(screen.progress_bar())
        if path is not None:
            measured = _of_frames(path, sensor_out, stack, progress)
        else:
            measured = _of_sensor(sensor_name, side_px, seed, kept, progress)
        found, title, how, rows = measured.found, measured.title, measured.how, measured.rows
        facts = {
            "gpusim": gpusim.__version__,
            "command": ["gpusim", *sys.argv[1:]],
            "camera": title,
            "frames": how,
            **noise_facts(found, rows),
        }
        text = json.dumps(facts, indent=1, allow_nan=False)
        if folder is not None:
            (folder / "noise.json").write_text(text + "\n")
            with (folder / "noise.csv").open("w", newline="") as opened:
                csv.writer(opened).writerows(noise_rows(found))
            (folder / "noise.html").write_text(noise_html(found, rows, title, how))
            (folder / "noise.png").write_bytes(png(draw_noise(found, title, how)))
    if as_json:
        print(text)
    else:
        show(found, rows, f"{title}, {how}")
        paths = [out / name for name in FILES] if out is not None else []
        for written in [*paths, *([sensor_out] if sensor_out is not None else [])]:
            Console().print(str(written), markup=False, highlight=False, soft_wrap=True)
    return 1 if rows is not None and loop.failed(rows) else 0


def _check(
    path: Path | None, sensor_name: str | None, keep: Path | None, sensor_out: Path | None
) -> None:
    """Refuse options that do not go together."""
    if (path is None) == (sensor_name is None):
        raise UserError(
            "nothing to measure" if path is None else "two things to measure",
            field="PATH, --sensor",
            allowed="a folder with frames.csv or EMVA1288_Data.txt, or --sensor with a preset or a "
            ".yaml file",
        )
    if path is None and sensor_out is not None:
        raise UserError(
            "the sensor has a file", field="--sensor-out", allowed="only with frames on disk"
        )
    if path is not None and keep is not None:
        raise UserError("the frames are on disk", field="--keep", allowed="only with --sensor")


def _of_frames(
    path: Path, sensor_out: Path | None, stack: ExitStack, progress: Callable[..., None]
) -> _Measured:
    """Measure frames on disk, and write the sensor file if one is asked for."""
    described = descriptor.find_descriptor(path)
    listed = (
        frames.find_frames(path) if described is None else descriptor.read_descriptor(described)
    )
    found = characterise(list(frames.measure(listed, progress)), listed.sites)
    how = f"frames of {path}"
    if sensor_out is not None:
        size = frames.read_frame(next(iter(listed.groups.values()))[0]).shape
        written = stack.enter_context(whole_file(sensor_out, YAML, "--sensor-out"))
        made = as_sensor(found, listed, size)
        written.write_text(sensor_text(made, f"Measured from {how}."), "utf-8")
    return _Measured(found, listed.name, how)


def _of_sensor(
    name: str, side_px: int, seed: int, kept: frames.Kept | None, progress: Callable[..., None]
) -> _Measured:
    """Simulate frames of a sensor and measure them."""
    whole = load_sensor(name)
    sensor = flat_field.region(whole, side_px)
    runs = sensor_runs(sensor)
    levels = flat_field.measure(
        sensor,
        flat_field.lights(sensor),
        default_device(),
        runs,
        seed=seed,
        keep=None if kept is None else kept.frame,
        progress=progress,
    )
    found = characterise(list(levels), sensor.site_channels())
    rows = loop.rows(found, sensor)
    how = f"simulated: {sensor.rows} x {sensor.cols} pixels about the centre, seed {seed}"
    how += flat_field.left_out(whole, runs)
    if kept is not None:
        kept.close(sensor.name, sensor.cfa.pattern, sensor.pixel_pitch_um)
    return _Measured(found, sensor.name, how, rows)


def show(found: Characterisation, rows: Sequence[loop.Row] | None, title: str) -> None:
    """Print the data sheet and, of a simulated sensor, the verdicts."""
    console = Console()
    console.print(title, markup=False, highlight=False, soft_wrap=True)
    for channel in found.channels:
        light = "" if channel.wavelength_nm is None else f", light of {channel.wavelength_nm:g} nm"
        console.print(
            Text(f"\nchannel {channel.name}{light}, {channel.pixels} pixels", style="bold")
        )
        console.print(sheet(channel.figures, OF_A_CHANNEL))
    console.print(Text("\nall pixels, in the dark", style="bold"))
    console.print(sheet(found.figures, IN_THE_DARK))
    for note in found.notes:
        console.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    if rows is not None:
        console.print()
        console.print(verdicts(rows))
        inside = len(rows) - loop.failed(rows)
        console.print(
            f"{inside} of {len(rows)} recovered within their uncertainty, k = {loop.COVERAGE}"
        )
        for reason in dict.fromkeys(row.reason for row in rows if row.reason):
            named = ", ".join(row.parameter for row in rows if row.reason == reason)
            console.print(f"{named}: {reason}", markup=False, soft_wrap=True)


def sheet(figures: dict[str, Figure], names: dict[str, tuple[str, str, str]]) -> Table:
    """Return figures with their standard uncertainties as a table."""
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column()
    table.add_column()
    table.add_column(justify="right")
    for key, (name, symbol, unit) in names.items():
        if key in figures:
            one = figures[key]
            shown = f"{number(one.value, one.u)} \N{PLUS-MINUS SIGN} {two_digits(one.u)}"
            table.add_row(Text(name), Text(symbol), Text(shown), Text(unit.replace("1", "", 1)))
    return table


def verdicts(rows: Sequence[loop.Row]) -> Table:
    """Return the verdicts as a table."""
    table = Table(
        "parameter",
        "data sheet",
        "expected",
        "recovered",
        f"U (k = {loop.COVERAGE})",
        "unit",
        "verdict",
        box=None,
        header_style="bold",
        pad_edge=False,
    )
    for column in table.columns[1:5]:
        column.justify = "right"
    for row in rows:
        good = row.within
        table.add_row(
            Text(row.parameter),
            f"{row.data_sheet:.6g}",
            number(row.expected, row.uncertainty) if row.reason else "as given",
            number(row.recovered, row.uncertainty),
            two_digits(row.uncertainty),
            "" if row.unit == "1" else row.unit,
            Text("within" if good else "OUTSIDE", style="green" if good else "bold red"),
        )
    return table
