"""``gpusim measure texture``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, numbers, print_table, say
from gpusim.cli.sfr import channels_of, region_of
from gpusim.errors import UserError
from gpusim.metrics.picture import Plane, read_picture
from gpusim.metrics.texture import Box, measure_texture
from gpusim.report.texture_page import draw_texture, texture_facts, texture_html, texture_rows

# Radii of the leaves of the chart `dead-leaves`, over half of the picture's height.
CHART = (0.008, 0.4)
MIDDLE = 0.8  # of the picture's width and height: the region where none is given


def texture(
    path: Path,
    *,
    roi: str | None,
    leaves: str | None,
    second: Path | None,
    even: str | None,
    channels: str | None,
    out: Path | None,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure the texture MTF of a picture of dead leaves."""
    if second is not None and even is not None:
        raise UserError(
            "Noise is taken off in one way.",
            field="--noise",
            value=even,
            allowed="--second or --noise",
        )
    planes = read_picture(path, linear=linear)
    names = channels_of(planes, channels, path)
    rows, cols = planes[names[0]].values.shape
    box = region_of(roi) if roi is not None else _middle(rows, cols)
    radii = CHART[0] * rows / 2, CHART[1] * rows / 2
    if leaves is not None:
        what = "two radii in pixels, the smaller one first"
        radii = numbers(leaves, 2, "--leaves", what)
    others = {} if second is None else _same(read_picture(second, linear=linear), planes, second)
    patch = None if even is None else region_of(even)
    found = [
        measure_texture(planes[name], name, box, radii, second=others.get(name), even=patch)
        for name in names
    ]
    deliver(
        "texture",
        path,
        out,
        texture_facts(found, radii),
        texture_rows(found),
        draw=lambda: draw_texture(found, planes[names[0]].values, path.name),
        html=texture_html,
        show=show,
        as_json=as_json,
    )


def _middle(rows: int, cols: int) -> Box:
    width, height = round(MIDDLE * cols), round(MIDDLE * rows)
    return (cols - width) // 2, (rows - height) // 2, width, height


def _same(others: dict[str, Plane], planes: dict[str, Plane], path: Path) -> dict[str, Plane]:
    """Return the second picture's channels, which must be those of the first."""
    shapes = [next(iter(one.values())).values.shape for one in (planes, others)]
    if list(others) != list(planes) or shapes[0] != shapes[1]:
        raise UserError(
            "The second picture is not of the first one's kind.",
            file=path,
            field="--second",
            value=f"{shapes[1][1]} x {shapes[1][0]}, {', '.join(others)}",
            allowed=f"{shapes[0][1]} x {shapes[0][0]}, {', '.join(planes)}",
        )
    return others


def show(facts: dict[str, Any]) -> None:
    """Print a line for each channel."""
    print_table(
        ("channel", "MTF50, c/px"),
        [
            (one["channel"], "-" if one["mtf50"] is None else f"{one['mtf50']:.3f}")
            for one in facts["channels"]
        ],
    )
    for one in facts["channels"]:
        if one["clipped"]:
            say(f"{one['channel']}: some pixels are clipped")
    say(f"noise {facts['noise']}; {facts['units']}")
