"""``gpusim measure shading``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gpusim.cli.measured import deliver, print_table, say
from gpusim.cli.sfr import channels_of
from gpusim.metrics.picture import read_picture
from gpusim.metrics.shading import measure_shading
from gpusim.report.shading_page import draw_shading, shading_facts, shading_html, shading_rows


def shading(
    path: Path, channels: str | None, out: Path | None, *, linear: bool, as_json: bool
) -> None:
    """Measure the shading of a picture of an even field."""
    planes = read_picture(path, linear=linear)
    names = list(planes) if channels is None else channels_of(planes, channels, path)
    found = [measure_shading(planes[name], name) for name in names]
    rows, cols = planes[names[0]].values.shape
    deliver(
        "shading",
        path,
        out,
        shading_facts(found),
        shading_rows(found),
        draw=lambda: draw_shading(found, (cols, rows), path.name),
        html=shading_html,
        show=show,
        as_json=as_json,
    )


def show(facts: dict[str, Any]) -> None:
    """Print a line for each channel."""
    corners = facts["channels"][0]["corners_percent"]
    print_table(
        ("channel", *corners, "unevenness", "u"),
        [
            (
                one["channel"],
                *(f"{value:.2f}" for value in one["corners_percent"].values()),
                f"{one['unevenness_percent']:.2f}",
                f"{one['u_percent']:.2f}",
            )
            for one in facts["channels"]
        ],
    )
    for one in facts["colour_shading"]:
        say(f"{one['ratio']}: {one['lowest_percent']:+.2f} to {one['highest_percent']:+.2f} %")
    for one in facts["channels"]:
        if one["clipped"]:
            say(f"{one['channel']}: some pixels are clipped")
    say(f"per cent of the middle: {facts['units']}")
