"""The row of one effect of the sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gpusim.sensor.noise_model import LineNoise, Masks

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

# Which rate of `gpusim.plan.costs.UNITS` an effect costs, and how often.
Work = tuple[str, float]


@dataclass(frozen=True)
class Effect:
    """One effect of the sensor.

    Attributes
    ----------
    name : str
        As the plan and the report call it.
    stage : str
        The shader that does it, in ``shaders/sensor``.
    fields : tuple of str
        Fields of a sensor file that give it.
    what : str
        What it does, for the documentation.
    has : callable
        Whether a sensor has it.
    used, unused : callable, str
        Why it runs, by the sensor, and why it does not.
    random : bool
        Whether it is noise or a fixed pattern, which a render without noise leaves out.
    forced : bool
        Whether it may run where it changes nothing, to show that it does not.
    override : str
        Constant of the shader that switches it on, if it is a part of a stage.
    read_out : bool
        Whether it is added when the charge is read.
    work : callable, optional
        What a frame of it costs; None for what is done in passing.
    """

    name: str
    stage: str
    fields: tuple[str, ...]
    what: str
    has: Callable[[Sensor], bool]
    used: Callable[[Sensor], str]
    unused: str | Callable[[Sensor], str]
    random: bool = False
    forced: bool = False
    override: str = ""
    read_out: bool = False
    work: Callable[[Sensor], Work] | None = None

    def reason(self, sensor: Sensor, runs: bool, noise: bool) -> str:
        """Return why it runs or not."""
        if runs:
            return self.used(sensor)
        if self.random and not noise:
            return "noise is switched off"
        return self.unused(sensor) if callable(self.unused) else self.unused


def each_pixel(rate: str) -> Callable[[Sensor], Work]:
    """Return what a stage costs that takes each pixel that is read once."""
    return lambda sensor: (rate, math.prod(sensor.frame.read[2:]))


def lines_of(sensor: Sensor) -> LineNoise:
    """Return what a sensor has of rows and columns, nothing if its file does not say."""
    return sensor.lines or LineNoise()


def masks_of(sensor: Sensor) -> Masks:
    """Return the masks of a sensor, none if its file does not name any."""
    return sensor.masks or Masks()
