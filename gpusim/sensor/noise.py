"""Noise: from mean electrons to the charge that is read. Stage ``shaders/sensor/noise.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.sensor import Sensor
from gpusim.sensor.words import quads, words


def record_noise(
    rec: Recording,
    mean: Array,
    sensor: Sensor,
    *,
    seed: int,
    frame: int = 0,
    origin: tuple[int, int] = (0, 0),
    label: str = "electrons",
    shot: bool = True,
    read_out: bool = True,
    dsnu: bool = True,
    read_noise: bool = True,
) -> Array:
    """Record shot noise, full well, fixed offset and temporal dark noise of a rectangle of pixels.

    Both halves take one dispatch. Where something moves the charge after it was collected, each
    half is recorded by itself.

    Parameters
    ----------
    rec : Recording
    mean : Array (rows, cols), f32
        Mean electrons; the charge that arrives where only the read-out is recorded.
    sensor : Sensor
        Gives full well, DSNU and temporal dark noise.
    seed : int
        Of the capture, 0 to 2^64 - 1.
    frame : int
        Number of the frame, 0 to 2^32 - 1: each has noise of its own.
    origin : (int, int)
        Row and column of the first pixel.
    label : str
        Of the buffer that is returned.
    shot, read_out : bool
        The halves: shot noise and full well; what is added when the charge is read.
    dsnu, read_noise : bool
        Whether to draw the pixels' offsets and the temporal dark noise: a sensor without them does
        not need it.

    Returns
    -------
    Array (rows, cols), f32
        Electrons; may be negative.
    """
    electrons = rec.buffer(label, mean.shape, "f4")
    kernel = Kernel(
        "sensor/noise", SHOT=shot, DSNU=read_out and dsnu, READ_NOISE=read_out and read_noise
    )
    rows, cols = mean.shape
    row0, col0 = origin[0] + sensor.first_row, origin[1] + sensor.first_col
    params = {
        "seed": words(seed),
        "serial": words(sensor.serial_number),
        "frame": frame,
        "row0": row0,
        "col0": col0,
        "rows": rows,
        "cols": cols,
        "full_well_e": sensor.full_well_e,
        "temporal_dark_noise_e": sensor.temporal_dark_noise_e,
        "dsnu_e": sensor.dsnu_e,
    }
    groups = kernel.cover(quads(col0, cols), rows)
    kernel.record(rec, groups, params, mean=mean, electrons=electrons)
    return electrons
