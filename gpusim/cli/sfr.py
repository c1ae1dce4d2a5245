"""``gpusim measure sfr``."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

import gpusim
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.errors import UserError
from gpusim.metrics.picture import Plane, most_frequent, read_picture
from gpusim.metrics.regions import find_regions
from gpusim.metrics.sfr import Edge, measure_sfr
from gpusim.report.drawing import png
from gpusim.report.sfr_facts import sfr_facts
from gpusim.report.sfr_figure import draw_sfr
from gpusim.report.sfr_html import sfr_html

FILES = ("sfr.json", "sfr.csv", "sfr.html", "sfr.png")
# Columns of the table on screen, within 80 characters; the files have all figures.
COLUMNS = {
    "edge": "right",
    "channel": "left",
    "x, y": "right",
    "MTF50": "right",
    "at Nyquist": "right",
    "10-90 %": "right",
    "angle": "right",
}


def sfr(
    path: Path,
    boxes: Sequence[str],
    channels: str | None,
    out: Path | None,
    *,
    linear: bool,
    pitch_um: float | None,
    f_number: float | None,
    wavelength_nm: float,
    as_json: bool,
) -> int:
    """Measure the edges of a picture, those given or all that are found; return the exit code."""
    planes = read_picture(path, linear=linear)
    names = channels_of(planes, channels, path)
    regions = [region_of(box) for box in boxes] if boxes else _sought(planes, path)
    found = _edges(planes, names, regions, leave_out=not boxes)
    cutoff = None
    if pitch_um is not None and f_number is not None:
        cutoff = pitch_um * 1e3 / (wavelength_nm * f_number)
    facts = {
        "gpusim": gpusim.__version__,
        "command": ["gpusim", *sys.argv[1:]],
        "picture": path.name,
        **sfr_facts(found, pitch_um, cutoff),
    }
    text = json.dumps(facts, indent=1, allow_nan=False)
    if out is not None:
        with staging(out) as folder:
            (folder / "sfr.json").write_text(text + "\n")
            _write_csv(folder / "sfr.csv", found)
            drawn = draw_sfr(found, planes[names[0]].values, path.name, cutoff)
            (folder / "sfr.png").write_bytes(png(drawn))
            (folder / "sfr.html").write_text(sfr_html(facts, drawn))
    if as_json:
        print(text)
        return 0
    show(facts)
    for name in FILES if out is not None else ():
        Console().print(str(out / name), markup=False, highlight=False, soft_wrap=True)
    return 0


def _sought(planes: dict[str, Plane], path: Path) -> list[tuple[int, int, int, int]]:
    """Return the regions of all edges that are found in a picture."""
    with screen.progress_bar() as progress:
        searched = find_regions(
            planes[most_frequent(planes)], lambda done, total: progress("edges", done, total)
        )
    if not searched:
        raise UserError(
            "No slanted edge is found in the picture.",
            file=path,
            field="--roi",
            allowed="x,y,width,height of a region with one edge",
        )
    return [one.box for one in searched]


def _edges(
    planes: dict[str, Plane],
    names: Sequence[str],
    regions: Sequence[tuple[int, int, int, int]],
    *,
    leave_out: bool,
) -> list[Edge]:
    """Measure each region in each channel; leave out, or refuse, what is no edge."""
    found: list[Edge] = []
    for number, box in enumerate(regions, start=1):
        for name in names:
            plane = planes[name]
            try:
                one = measure_sfr(plane.values, box, sites=plane.sites, clip=plane.clip)
            except UserError as refused:
                if not leave_out:
                    raise
                print(f"left out: region {number}, {name}: {refused.problem}", file=sys.stderr)
                continue
            found.append(Edge(number, box, name, one))
    return found


def channels_of(planes: dict[str, Plane], channels: str | None, path: Path) -> list[str]:
    """Return the channels to measure: those asked for, or all."""
    if channels is None:
        return list(planes)
    names = [name.strip() for name in channels.split(",")]
    for name in names:
        if name not in planes:
            raise UserError(
                "The picture has no such channel.",
                file=path,
                field="--channel",
                value=name,
                allowed=", ".join(planes),
            )
    return names


def region_of(text: str, option: str = "--roi") -> tuple[int, int, int, int]:
    """Return x, y, width, height of a text such as ``40,50,64,80``."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise UserError(
            "The region cannot be read.",
            field=option,
            value=text,
            allowed="x,y,width,height in whole pixels, such as 40,50,64,80",
        ) from None
    return x, y, width, height


def _write_csv(file: Path, found: Sequence[Edge]) -> None:
    """Write the curves: a column of frequencies, and two for each edge and channel."""
    with file.open("w", newline="") as opened:
        writer = csv.writer(opened)
        names = [f"{edge.number} {edge.channel}" for edge in found]
        writer.writerow(
            ["cycles_per_px", *(f"{kind} {name}" for name in names for kind in ("sfr", "u"))]
        )
        for row, frequency in enumerate(found[0].sfr.frequency_cy_px):
            pairs = [(edge.sfr.sfr[row], edge.sfr.u_sfr[row]) for edge in found]
            writer.writerow(
                [f"{frequency:.4f}", *(f"{value:.6f}" for pair in pairs for value in pair)]
            )


def show(facts: dict) -> None:
    """Print a line for each edge and channel."""
    table = Table(box=None, pad_edge=False)
    for name, side in COLUMNS.items():
        table.add_column(name, justify=side, no_wrap=True)
    for edge in facts["edges"]:
        x, y = edge["place_px"]
        half, nyquist = edge["figures"]["mtf50"], edge["figures"]["nyquist"]
        table.add_row(
            str(edge["edge"]),
            edge["channel"],
            f"{x:.1f}, {y:.1f}",
            "\N{EN DASH}" if half is None else _pair(half),
            _pair(nyquist),
            f"{edge['rise_px']:.2f} px",
            f"{edge['angle_deg']['value']:.2f}\N{DEGREE SIGN} {edge['nearer_to'][0]}",
        )
    console = Console()
    console.print(table)
    words = f"{facts['units']}; angle from the vertical (v) or the horizontal (h)"
    console.print(words, markup=False, highlight=False, soft_wrap=True)


def _pair(figure: dict[str, float]) -> str:
    return f"{figure['value']:.3f} \N{PLUS-MINUS SIGN} {figure['u']:.3f}"
