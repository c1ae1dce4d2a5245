"""Noise: from mean electrons to the charge that is read. Stage ``shaders/sensor/noise.wgsl``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.effects import switches
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.philox import quads, words
from gpusim.sensor.sensor import Sensor

QUANTILES, REACH = 1025, 6.5  # of the table in the stage

# Constants of the stage by effect: of its first half, and of what is added when the charge is read.
COLLECTED, READ_OUT = switches("noise"), switches("noise", read_out=True)


def record_noise(
    rec: Recording,
    mean: Array,
    sensor: Sensor,
    *,
    seed: int,
    frame: int = 0,
    temperature_c: float | None = None,
    origin: tuple[int, int] = (0, 0),
    label: str = "electrons",
    shot: bool = True,
    read_out: bool = True,
    runs: Callable[[str], bool] | None = None,
) -> Array:
    """Record shot noise, full well, fixed offsets and temporal dark noise of a rectangle of pixels.

    Both halves take one dispatch. Where something moves the charge after it was collected, each
    half is recorded by itself.

    Parameters
    ----------
    rec : Recording
    mean : Array (rows, cols), f32
        Mean electrons; the charge that arrives where only the read-out is recorded.
    sensor : Sensor
        Gives full well and all noise.
    seed : int
        Seed of the capture, 0 to 2^64 - 1.
    frame : int
        Number of the frame, 0 to 2^32 - 1: each has noise of its own.
    temperature_c : float, optional
        Temperature of the sensor; by default that at which its dark current was measured.
    origin : (int, int)
        Row and column of the first pixel.
    label : str
        Label of the buffer that is returned.
    shot, read_out : bool
        The halves: shot noise and full well; what is added when the charge is read.
    runs : callable, optional
        Whether an effect is drawn, by its name in the plan; by default those that the sensor has.

    Returns
    -------
    Array (rows, cols), f32
        Electrons; may be negative.
    """
    runs = runs or sensor.effects.__contains__
    rows, cols = mean.shape
    row0, col0 = origin[0] + sensor.first_row, origin[1] + sensor.first_col
    drawn = {override: read_out and runs(name) for override, name in READ_OUT.items()}
    law = drawn["READ_NOISE"] and sensor.read_noise_law is not None
    kernel = Kernel(
        "sensor/noise",
        SHOT=shot,
        **{constant: shot and runs(name) for constant, name in COLLECTED.items()},
        READ_TABLE=law,
        **drawn,
    )
    mask = quantiles = mean  # any buffer, where they are not read
    if drawn["MASK"]:
        mask = rec.buffer("offset mask", (rows, cols), "f4")
        rec.upload(mask, sensor.masks.part("offset_e", sensor.lit_place(origin), (rows, cols)))
    if law:
        quantiles = rec.buffer("read noise law", QUANTILES, "f4")
        deviates = np.linspace(-REACH, REACH, QUANTILES)
        rec.upload(quantiles, sensor.read_noise_law.quantiles(deviates).astype(np.float32))
    electrons = rec.buffer(label, mean.shape, "f4")
    lines = sensor.lines or LineNoise()
    params = {
        "seed": words(seed),
        "serial": words(sensor.serial_number),
        "frame": frame,
        "row0": row0,
        "col0": col0,
        "rows": rows,
        "cols": cols,
        "full_well_e": sensor.full_well_e,
        "knee_e": sensor.full_well_knee * sensor.full_well_e,
        "temporal_dark_noise_e": sensor.temporal_dark_noise_e,
        "variance_per_e": sensor.gaussian_variance_per_e or 0.0,
        "reset_noise_e": sensor.reset_noise_at(temperature_c),
        "row_noise_e": lines.row_noise_e,
        "column_noise_e": lines.column_noise_e,
        "dsnu_e": sensor.dsnu_e,
        "dsnu_row_e": lines.dsnu_row_e,
        "dsnu_column_e": lines.dsnu_column_e,
    }
    groups = kernel.cover(quads(col0, cols), rows)
    kernel.record(
        rec, groups, params, mean=mean, mask=mask, quantiles=quantiles, electrons=electrons
    )
    return electrons
