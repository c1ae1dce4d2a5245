"""``gpusim measure snr``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.cli.measured import deliver, print_table, say
from gpusim.cli.sfr import channels_of, region_of
from gpusim.metrics.colour import GREYS, measure_colour
from gpusim.metrics.picture import Plane, read_picture
from gpusim.metrics.snr import measure_snr
from gpusim.report.snr_page import draw_snr, snr_facts, snr_html, snr_rows


def snr(
    path: Path,
    boxes: Sequence[str],
    channels: str | None,
    out: Path | None,
    *,
    linear: bool,
    as_json: bool,
) -> None:
    """Measure SNR of patches: those given, or the greys of a ColorChecker that is found."""
    planes = read_picture(path, linear=linear)
    names = list(planes) if channels is None else channels_of(planes, channels, path)
    regions = [region_of(box) for box in boxes] or _greys(planes)
    found = [measure_snr(planes[name], name, regions) for name in names]
    facts = snr_facts(found)
    deliver(
        "snr",
        path,
        out,
        facts,
        snr_rows(facts),
        draw=lambda: draw_snr(found, planes[names[0]].values, path.name),
        html=snr_html,
        show=show,
        as_json=as_json,
    )


def _greys(planes: dict[str, Plane]) -> list[tuple[int, int, int, int]]:
    """Return the regions of a ColorChecker's six greys: upright boxes within the patches."""
    corners = measure_colour(planes).patches.corners[GREYS]
    middle, half = corners.mean(axis=1), np.ptp(corners, axis=1).min(axis=1) / 2
    return [
        (round(x - h), round(y - h), round(2 * h), round(2 * h))
        for (x, y), h in zip(middle, half, strict=True)
    ]


def show(facts: dict[str, Any]) -> None:
    """Print a line for each patch and channel, and the dynamic range of each channel."""
    print_table(
        ("channel", "patch", "signal", "noise", "SNR, dB", ""),
        [
            (
                one["channel"],
                str(patch["patch"]),
                f"{patch['signal']:.5g}",
                f"{patch['noise']:.4g}",
                "\N{EN DASH}" if patch["snr_db"] is None else f"{patch['snr_db']:.2f}",
                "clipped" if patch["clipped"] else "",
            )
            for one in facts["channels"]
            for patch in one["patches"]
        ],
    )
    for one in facts["channels"]:
        if one["dynamic_range_db"] is not None:
            least = "" if one["highest_is_the_scales_end"] else "at least "
            say(f"{one['channel']}: dynamic range {least}{one['dynamic_range_db']:.2f} dB")
    say(facts["units"])
