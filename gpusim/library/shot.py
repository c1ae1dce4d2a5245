"""Whether a shot can be taken: its exposure, seed, frame and temperature."""

from __future__ import annotations

from dataclasses import replace
from numbers import Integral, Real
from typing import TYPE_CHECKING

from gpusim.errors import UserError
from gpusim.render.checks import check_shot
from gpusim.sensor.readout import Shot, noise_seed

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor


def checked(shot: Shot, sensor: Sensor) -> Shot:
    """Return a shot with its seed made that of exposure and gain, or say what is out of range."""
    if not isinstance(shot.exposure_s, Real):
        raise UserError(
            "the exposure is no number", field="exposure", value=shot.exposure_s, allowed="seconds"
        )
    for name in ("seed", "frame"):
        if not isinstance(getattr(shot, name), Integral):
            raise UserError(
                f"the {name} is no whole number",
                field=name,
                value=getattr(shot, name),
                allowed="a whole number, 0 or more",
            )
    check_shot(shot.exposure_s, shot.seed, shot.frame)
    temperature_c = shot.temperature_c
    if temperature_c is None:
        temperature_c = sensor.reference_temperature_c
    sensor.dark_current_at(temperature_c)  # refuses what is no temperature
    seed = noise_seed(shot.seed, shot.exposure_s, sensor.analogue_gain)
    return replace(shot, seed=seed, temperature_c=temperature_c)
