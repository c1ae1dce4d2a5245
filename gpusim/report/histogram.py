"""The raw's histogram by channel: its facts, and its part of a page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.isp.histogram import channel_values
from gpusim.isp.levels import noise_profile, saturation_dn, span_dn
from gpusim.report.template import filled

if TYPE_CHECKING:
    from gpusim.render import Capture

BINS = 128
WIDTH, HEIGHT, LEFT = 640, 150, 6  # of the figure, px
TALL = HEIGHT - 8  # of the highest bin
COLOURS = {"R": "#d0443a", "G": "#2f9a55", "B": "#3b74d6"}
OF_OTHERS = "#8a8f98"


def histogram_facts(capture: Capture) -> dict[str, Any]:
    """Return counts by channel, and of each its saturated share, median and the median's SNR."""
    sensor, areas = capture.camera.sensor, capture.areas
    row, col, rows, cols = areas.active
    lit = capture.raw[row : row + rows, col : col + cols]
    edges = np.linspace(0, sensor.raw_max_dn + 1, BINS + 1)
    top, span = saturation_dn(sensor), span_dn(sensor)
    slope, floor = noise_profile(sensor, capture.temperature_c)
    found = {}
    for letter, values in channel_values(lit, sensor, areas.lit[:2]).items():
        if not values.size:
            continue
        median = float(np.median(values))
        light = max(median - sensor.black_level_dn, 0.0) / span
        noise = math.sqrt(max(slope * light + floor, 0.0))
        found[letter] = {
            "counts": np.histogram(values, edges)[0].tolist(),
            "saturated_share": float(np.mean(values >= top)),
            "median_dn": median,
            "median_snr_db": 20 * math.log10(light / noise) if light > 0 < noise else None,
        }
    return {"edges_dn": edges.tolist(), "saturation_dn": top, "channels": found}


def histogram_html(facts: Mapping[str, Any]) -> str:
    """Return the figure, and a table of the channels."""
    channels, last = facts["channels"], facts["edges_dn"][-1]
    most = max((math.sqrt(max(one["counts"])) for one in channels.values()), default=1.0) or 1.0
    shown = [
        {
            **one,
            "letter": letter,
            "colour": COLOURS.get(letter, OF_OTHERS),
            "points": " ".join(
                f"{LEFT + (n + 0.5) * WIDTH / BINS:.1f},{HEIGHT - TALL * math.sqrt(k) / most:.1f}"
                for n, k in enumerate(one["counts"])
            ),
        }
        for letter, one in channels.items()
    ]
    return filled(
        "report/templates/histogram.html",
        channels=shown,
        saturation=LEFT + WIDTH * facts["saturation_dn"] / last,
        last_dn=last - 1,
        width=WIDTH,
        height=HEIGHT,
        left=LEFT,
    )
