"""One stage in the description of a plan, and the names that stages have."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from gpusim.sensor.effects import EFFECTS

# What comes before the sensor, whose effects name themselves.
_BEFORE_THE_SENSOR = (
    *("wavelengths", "no data", "bank", "window", "illumination", "paint", "warp", "dark blocks"),
    *("image circle", "distortion", "lateral", "halo", "qe by angle"),
    *("fft rows", "modes", "fft columns", "inverse fft", "direct", "tail", "point sources"),
)
_NAMES = (*_BEFORE_THE_SENSOR, *(effect.name for effect in EFFECTS))
Stage = StrEnum("Stage", {name.upper().replace(" ", "_"): name for name in _NAMES})
"""Every stage that a plan may tell of: ``Stage("fft rows")``; another name is a ValueError."""


def stage_of(path: str) -> str:
    """Return the stage that a shader does: ``optics/fft_rows`` does "fft rows"."""
    return path.rpartition("/")[2].replace("_", " ")


@dataclass(frozen=True)
class PlanStage:
    """One stage of the chain, or a part of its work: whether it runs, and why.

    Raises
    ------
    ValueError
        Where ``name`` is not that of a `Stage`.
    """

    name: str
    runs: bool
    reason: str
    predicted_error: float | None = None
    predicted_cost_s: float | None = None

    def __post_init__(self) -> None:
        """Refuse a name that is misspelt: what asks for the stage would not find it."""
        Stage(self.name)
