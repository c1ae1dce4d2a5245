"""The raw's histogram by channel: its facts, and its figure as SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from gpusim.isp.histogram import channel_values
from gpusim.isp.levels import noise_profile, saturation_dn, span_dn

if TYPE_CHECKING:
    from gpusim.render import Capture

BINS = 128
WIDTH, HEIGHT, LEFT = 640, 150, 6  # of the figure, px
TALL = HEIGHT - 8  # of the highest bin
COLOURS = {"R": "#d0443a", "G": "#2f9a55", "B": "#3b74d6"}


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
    lines = ""
    for letter, one in channels.items():
        points = " ".join(
            f"{LEFT + (n + 0.5) * WIDTH / BINS:.1f},{HEIGHT - TALL * math.sqrt(k) / most:.1f}"
            for n, k in enumerate(one["counts"])
        )
        lines += (
            f'<polyline fill="none" stroke="{_colour(letter)}" stroke-width="1.6" '
            f'points="{points}"/>'
        )
    at = LEFT + WIDTH * facts["saturation_dn"] / last
    rows = "".join(
        f'<tr><td><i class="dot" style="background:{_colour(letter)}"></i>{escape(letter)}</td>'
        f'<td class="number">{one["median_dn"]:.0f}</td>'
        f'<td class="number">{_decibels(one["median_snr_db"])}</td>'
        f'<td class="number">{one["saturated_share"]:.2%}</td></tr>'
        for letter, one in channels.items()
    )
    return f"""<h2>The raw</h2>
<figure><svg class="map narrow" viewBox="0 0 {WIDTH + 2 * LEFT} {HEIGHT + 24}" role="img"
aria-label="Histogram of the raw by channel">{lines}
<line x1="{at:.1f}" x2="{at:.1f}" y1="0" y2="{HEIGHT}" stroke="var(--bad)" stroke-dasharray="4 3"/>
<line x1="{LEFT}" x2="{WIDTH + LEFT}" y1="{HEIGHT}" y2="{HEIGHT}" stroke="var(--line)"/>
<g fill="var(--soft)" font-size="18"><text x="{LEFT}" y="{HEIGHT + 20}">0 DN</text>
<text x="{WIDTH + LEFT}" y="{HEIGHT + 20}" text-anchor="end">{last - 1:.0f} DN</text></g></svg>
<figcaption>Pixels by digital number, square-root counts; the dashed line is saturation. SNR
is that of the median.
</figcaption></figure><div class="scroll"><table><thead><tr>
<th>Channel</th><th class="number">Median [DN]</th>
<th class="number">SNR [dB]</th><th class="number">Saturated</th></tr></thead>
<tbody>{rows}</tbody></table></div>"""


def _colour(letter: str) -> str:
    return COLOURS.get(letter, "#8a8f98")


def _decibels(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
