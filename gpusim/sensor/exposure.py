"""Exposure: from electrons/s to mean electrons. Stage ``shaders/sensor/exposure.wgsl``."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.effects import switches
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.philox import quads, words
from gpusim.sensor.sensor import Sensor


def record_exposure(
    rec: Recording,
    rate: Array,
    sensor: Sensor,
    exposure_s: float,
    *,
    temperature_c: float | None = None,
    origin: tuple[int, int] = (0, 0),
    label: str = "mean",
    runs: Callable[[str], bool] | None = None,
    limit_e: float = float(np.finfo(np.float32).max),
) -> Array:
    """Record the exposure of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    rate : Array (rows, cols) or (1, rows, cols), f32
        Electrons/s.
    sensor : Sensor
        Gives responses and dark current.
    exposure_s : float
    temperature_c : float, optional
        Temperature of the sensor; by default that at which its dark current was measured.
    origin : (int, int)
        Row and column of the first pixel.
    label : str
        Label of the buffer that is returned.
    runs : callable, optional
        Whether an effect is drawn, by its name in the plan: "prnu", "prnu lines", "dcnu", "gain
        mask"; by default those that the sensor has.
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
    runs = runs or sensor.effects.__contains__
    rows, cols = rate.shape[-2:]
    mean = rec.buffer(label, (rows, cols), "f4")
    row0, col0 = origin[0] + sensor.first_row, origin[1] + sensor.first_col
    drawn = {constant: runs(name) for constant, name in switches("exposure").items()}
    kernel = Kernel("sensor/exposure", **drawn)
    mask = rate  # any buffer, where it is not read
    if drawn["MASK"]:
        mask = rec.buffer("gain mask", (rows, cols), "f4")
        rec.upload(mask, sensor.masks.part("gain", sensor.lit_place(origin), (rows, cols)))
    lines = sensor.lines or LineNoise()
    params = {
        "serial": words(sensor.serial_number),
        "row0": row0,
        "col0": col0,
        "rows": rows,
        "cols": cols,
        "exposure_s": exposure_s,
        "prnu": sensor.prnu_percent / 100,
        "prnu_row": lines.prnu_row_percent / 100,
        "prnu_column": lines.prnu_column_percent / 100,
        "dark_e": exposure_s * sensor.dark_current_at(temperature_c),
        "log_dcnu": math.sqrt(math.log1p((sensor.dcnu_percent / 100) ** 2)),
        "limit_e": limit_e,
    }
    groups = kernel.cover(quads(col0, cols), rows)
    kernel.record(rec, groups, params, rate=rate, mask=mask, mean=mean)
    return mean
