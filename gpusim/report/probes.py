"""The map of probes: where on the sensor the render was checked, and how large the error was."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gpusim.report.words import error

# Viridis (van der Walt and Smith 2015) at 0, 1/4 ... 1: even in lightness, safe for the
# colour-blind.
_VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))
# Relative errors of the darkest and the brightest colour, as powers of ten.
_LOW, _HIGH = -6, -2
_STEPS_A_DECADE = 4


def probe_map(probes: Sequence[Mapping[str, Any]], capture: Mapping[str, Any]) -> str:
    """Return an SVG of the sensor with its probes.

    Parameters
    ----------
    probes : sequence of mapping
        ``row``, ``col`` and ``relative`` of each, the worst first.
    capture : mapping
        ``rows`` and ``cols`` of the sensor or of the rectangle of it that was rendered, which
        begins at ``first_row`` and ``first_col``.
    """
    cols, rows = capture["cols"], capture["rows"]
    top, left = capture["first_row"], capture["first_col"]
    unit = max(cols, rows) / 100
    dots = "".join(
        f'<circle cx="{probe["col"] - left + 0.5}" cy="{probe["row"] - top + 0.5}" r="{unit:.2f}" '
        f'fill="{_colour(probe["relative"])}">'
        f"<title>row {probe['row']}, column {probe['col']}: {error(probe['relative'])}</title>"
        "</circle>"
        for probe in reversed(probes)
    )
    worst = probes[0]
    return f"""<svg class="map" viewBox="0 0 {cols} {rows + 8 * unit:.2f}" role="img"
aria-label="Map of probes"><rect width="{cols}" height="{rows}" fill="var(--map)"/>
<g stroke="var(--page)" stroke-width="{unit / 6:.2f}">{dots}</g>
<circle cx="{worst["col"] - left + 0.5}" cy="{worst["row"] - top + 0.5}" r="{2 * unit:.2f}"
fill="none" stroke="var(--bad)" stroke-width="{unit / 2:.2f}"/>
{_scale(cols, rows + 2 * unit, unit)}</svg>"""


def _scale(width: float, top: float, unit: float) -> str:
    """Return the colour scale, `width` wide, from `top` down."""
    steps = _STEPS_A_DECADE * (_HIGH - _LOW)
    scale = "".join(
        f'<rect x="{k * width / (steps + 1):.2f}" y="{top:.2f}" width="{width / (steps + 1):.2f}" '
        f'height="{1.5 * unit:.2f}" fill="{_colour(10 ** (_LOW + k / _STEPS_A_DECADE))}"/>'
        for k in range(steps + 1)
    )
    for decade in range(_LOW, _HIGH + 1):
        anchor = {_LOW: "start", _HIGH: "end"}.get(decade, "middle")
        scale += (
            f'<text x="{(decade - _LOW) / (_HIGH - _LOW) * width:.2f}" y="{top + 5 * unit:.2f}" '
            f'font-size="{3.3 * unit:.2f}" text-anchor="{anchor}" fill="currentColor">'
            f"1e{decade}</text>"
        )
    return scale


def _colour(relative: float | None) -> str:
    """Return the colour of a relative error on a logarithmic scale."""
    decade = math.log10(max(relative or 0.0, 10.0**_LOW))
    place = min(1.0, (decade - _LOW) / (_HIGH - _LOW)) * (len(_VIRIDIS) - 1)
    step = min(int(place), len(_VIRIDIS) - 2)
    mixed = zip(_VIRIDIS[step], _VIRIDIS[step + 1], strict=True)
    return "#" + "".join(f"{round(a + (b - a) * (place - step)):02x}" for a, b in mixed)
