"""Exposure: from electrons/s to mean electrons. Stage ``shaders/sensor/exposure.wgsl``."""

from __future__ import annotations

import math

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.words import quads, words


def record_exposure(
    rec: Recording,
    rate: Array,
    sensor: Sensor,
    exposure_s: float,
    *,
    temperature_c: float | None = None,
    origin: tuple[int, int] = (0, 0),
    label: str = "mean",
    prnu: bool = True,
    limit_e: float = float(np.finfo(np.float32).max),
) -> Array:
    """Record the exposure of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    rate : Array (rows, cols) or (1, rows, cols), f32
        Electrons/s.
    sensor : Sensor
        Gives PRNU and dark current.
    exposure_s : float
    temperature_c : float, optional
        Of the sensor; by default that at which its dark current was measured.
    origin : (int, int)
        Row and column of the first pixel.
    label : str
        Of the buffer that is returned.
    prnu : bool
        Whether to draw the pixels' responses: a sensor without PRNU does not need it.
    limit_e : float
        Where the mean is clipped, electrons: the full well where no noise is drawn after it.

    Returns
    -------
    Array (rows, cols), f32
        Mean electrons, before shot noise.

    Raises
    ------
    UserError
        The exposure time is negative or not finite, or the temperature is none.
    """
    if not 0 <= exposure_s < math.inf:
        raise UserError(
            "not an exposure time",
            field="exposure_s",
            value=exposure_s,
            allowed="seconds, from 0 up",
        )
    if temperature_c is None:
        temperature_c = sensor.reference_temperature_c
    rows, cols = rate.shape[-2:]
    mean = rec.buffer(label, (rows, cols), "f4")
    kernel = Kernel("sensor/exposure", PRNU=prnu)
    row0, col0 = origin[0] + sensor.first_row, origin[1] + sensor.first_col
    params = {
        "serial": words(sensor.serial_number),
        "row0": row0,
        "col0": col0,
        "rows": rows,
        "cols": cols,
        "exposure_s": exposure_s,
        "prnu": sensor.prnu_percent / 100,
        "dark_e": exposure_s * sensor.dark_current_at(temperature_c),
        "limit_e": limit_e,
    }
    kernel.record(rec, kernel.cover(quads(col0, cols), rows), params, rate=rate, mean=mean)
    return mean
