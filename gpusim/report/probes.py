"""The map of probes: where on the sensor the render was checked, and how large the error was."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from gpusim.report.template import filled
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
    top, left = capture["first_row"], capture["first_col"]
    steps = _STEPS_A_DECADE * (_HIGH - _LOW)
    return filled(
        "report/templates/probes.html",
        cols=capture["cols"],
        rows=capture["rows"],
        unit=max(capture["cols"], capture["rows"]) / 100,
        dots=[
            {
                "x": probe["col"] - left + 0.5,
                "y": probe["row"] - top + 0.5,
                "colour": _colour(probe["relative"]),
                "said": f"row {probe['row']}, column {probe['col']}: {error(probe['relative'])}",
            }
            for probe in probes
        ],
        scale=[_colour(10 ** (_LOW + k / _STEPS_A_DECADE)) for k in range(steps + 1)],
        decades=range(_LOW, _HIGH + 1),
    )


def _colour(relative: float | None) -> str:
    """Return the colour of a relative error on a logarithmic scale."""
    decade = math.log10(max(relative or 0.0, 10.0**_LOW))
    place = min(1.0, (decade - _LOW) / (_HIGH - _LOW)) * (len(_VIRIDIS) - 1)
    step = min(int(place), len(_VIRIDIS) - 2)
    mixed = zip(_VIRIDIS[step], _VIRIDIS[step + 1], strict=True)
    return "#" + "".join(f"{round(a + (b - a) * (place - step)):02x}" for a, b in mixed)
