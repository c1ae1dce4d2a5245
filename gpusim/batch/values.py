"""Which values the settings of a sweep can have: told before the first frame is rendered."""

from __future__ import annotations

import math
from numbers import Real

from gpusim.errors import UserError
from gpusim.scene.spectra import WAVELENGTHS_NM, illuminant
from gpusim.sensor.datasheet import ABSOLUTE_ZERO_C

WHOLE = {"iso": 1, "seed": 0, "frame": 0}  # and the least of each
ABOVE_ZERO = {"exposure_s": "seconds", "gain": "a factor", "luminance_cd_m2": "cd/m^2"}


def check_value(name: str, value: object) -> None:
    """Refuse a listed value that its setting cannot have.

    Whatever a lens or a sensor decides (a stop, a step of gain, a figure) is theirs to refuse.

    Parameters
    ----------
    name : str
        The setting: an axis.
    value : object

    Raises
    ------
    UserError
        A text where a number stands, a fraction of a seed, an exposure of no length ...
    """
    number = value if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    if name in WHOLE:
        least = WHOLE[name]
        valid = number >= least and number == int(number)
        allowed = f"whole numbers from {least} on"
    elif name in ABOVE_ZERO:
        # YAML reads 1/60 as a text.
        valid, allowed = 0 < number < math.inf, f"numbers above 0 ({ABOVE_ZERO[name]}): 0.0167"
    elif name == "temperature_c":
        valid = ABSOLUTE_ZERO_C < number < math.inf
        allowed = "numbers above -273.15 (degrees Celsius)"
    elif name == "noise":
        valid, allowed = isinstance(value, bool), "true, false"
    elif name == "illuminant" and value is not None:
        try:
            illuminant(str(value), WAVELENGTHS_NM[:1])
        except UserError as error:
            raise UserError(
                error.problem, field=f"axes.{name}", value=value, allowed=error.allowed
            ) from error
        return
    else:
        return
    by_itself = value is None and name not in WHOLE  # the sensor's own, or the light's
    if not valid and not by_itself:
        raise UserError(
            "the setting cannot have this value", field=f"axes.{name}", value=value, allowed=allowed
        )
