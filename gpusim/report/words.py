"""Facts and numbers as people write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

NOTHING = "\N{EN DASH}"


def is_whole(facts: Mapping[str, Any]) -> bool:
    """Return whether a capture is a whole frame of its sensor."""
    capture, sensor = facts["capture"], facts["camera"]["sensor"]
    return (capture["rows"], capture["cols"]) == (sensor["rows"], sensor["cols"])


def exposure(seconds: float) -> str:
    """Return an exposure time as photographers write it: 1/60 s, 2.5 s."""
    if 0 < seconds < 1 and math.isclose(1 / seconds, round(1 / seconds), rel_tol=1e-9):
        return f"1/{round(1 / seconds)} s"
    return f"{seconds:g} s"


def duration(seconds: float | None) -> str:
    """Return a run time with three digits: 12.3 s, 45.6 ms, 7.89 us; a dash where there is none."""
    if seconds is None:
        return NOTHING
    for factor, unit in ((1, "s"), (1e3, "ms")):
        if seconds * factor >= 1:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"


def mebibytes(nbytes: int) -> str:
    """Return a size of memory in whole MiB, rounded up."""
    return f"{-(-nbytes // 2**20)} MiB"


def error(value: float | None) -> str:
    """Return a relative error with two digits: 3.2e-04; a dash where there is none."""
    if value is None:
        return NOTHING
    return f"{value:.1e}" if value else "0"


def saturated(facts: Mapping[str, Any]) -> str:
    """Return what share of the pixels of a capture's facts is saturated."""
    share = facts["capture"]["saturated_share"]
    return f"Saturated: {100 * share:.2g} % of the pixels" if share else "No pixel is saturated"


def tolerance(capture: Mapping[str, Any]) -> str:
    """Return the tolerance of a capture's facts: 0.001, or 0.1 sigma."""
    return f"{capture['tolerance']:g}" + (" sigma" if capture["tolerance_unit"] == "sigma" else "")


def sigmas(value: float | None) -> str:
    """Return an error in noise sigmas with two digits: 0.0032 sigma."""
    return NOTHING if value is None else f"{value:.2g} sigma"
