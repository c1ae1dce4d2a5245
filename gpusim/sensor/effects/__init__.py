"""What a sensor does to light and charge: one row for each effect, and the order they come in.

A row says which stage does the effect, which fields of a sensor file give it, whether a sensor has
it, why it runs or not, and what it costs. `Sensor.effects`, the plan, the report and the table of
`docs/sensors.md` (written by ``tools/effects_table.py``) are made from these rows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpusim.sensor.effects.collecting import (
    BORDER,
    DCNU,
    DEFECTS,
    EXPOSURE,
    FLARE,
    GAIN_MASK,
    MOSAIC,
    NOISE,
    PRNU,
    PRNU_LINES,
    SOFT_SATURATION,
    TWO_NUMBERS,
)
from gpusim.sensor.effects.effect import Effect
from gpusim.sensor.effects.moving import (
    BLOOM,
    CROSSTALK,
    ELECTRICAL_CROSSTALK,
    PARALLEL_CTI,
    SERIAL_CTI,
    SMEAR,
)
from gpusim.sensor.effects.reading import (
    ADC,
    COLUMN_FPN,
    DSNU,
    DSNU_LINES,
    LINE_NOISE,
    LINEARITY,
    MERGE,
    OFFSET_MASK,
    READ_NOISE,
    RESET_NOISE,
)

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

__all__ = ["CCD", "CMOS", "EFFECTS", "EXPOSURE", "NOISE", "Effect", "running", "switches"]

_LIGHT = (MOSAIC, FLARE, BORDER, CROSSTALK)
_RESPONSE = (PRNU, PRNU_LINES, GAIN_MASK, DCNU, EXPOSURE, DEFECTS)
_CHARGE = (TWO_NUMBERS, SOFT_SATURATION, NOISE)
_READ = (DSNU, DSNU_LINES, OFFSET_MASK, RESET_NOISE, READ_NOISE, LINE_NOISE)
_DIGITAL = (LINEARITY, COLUMN_FPN, ADC)
# The order is part of the contract: response before shot noise, so that it does not change the
# slope of the photon transfer; all that moves charge before all that is added when it is read.
# Smear comes before the transfers, so that its trails point the right way in the overscan.
CMOS = (*_LIGHT, *_RESPONSE, *_CHARGE, ELECTRICAL_CROSSTALK, *_READ, *_DIGITAL, MERGE)
CCD = (
    *(*_LIGHT, *_RESPONSE, SMEAR),
    *(*_CHARGE, BLOOM, PARALLEL_CTI, SERIAL_CTI, ELECTRICAL_CROSSTALK),
    *(*_READ, *_DIGITAL),
)
EFFECTS = (*CCD, MERGE)  # those of both, in an order that is right for each


def switches(stage: str, read_out: bool = False) -> dict[str, str]:
    """Return the constants of a shader that switch its effects on, and the effects' names."""
    return {
        effect.override: effect.name
        for effect in EFFECTS
        if effect.stage == stage and effect.override and effect.read_out == read_out
    }


def running(sensor: Sensor, noise: bool = True) -> frozenset[str]:
    """Return the names of the effects that a sensor has, with its noise or without."""
    return frozenset(
        effect.name for effect in EFFECTS if (noise or not effect.random) and effect.has(sensor)
    )
