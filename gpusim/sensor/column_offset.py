"""Offsets of the columns' converters, drawn. Stage ``shaders/sensor/column_offset.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.philox import quads, words
from gpusim.sensor.sensor import Sensor


def record_column_offset(
    rec: Recording, sensor: Sensor, col0: int, cols: int, *, label: str = "offset"
) -> Array:
    """Record the offsets of some columns.

    Parameters
    ----------
    rec : Recording
    sensor : Sensor
        Gives their standard deviation, and its serial number.
    col0, cols : int
        First column, on the chip, and how many.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (cols,), f32
        DN.
    """
    offset = rec.buffer(label, cols, "f4")
    kernel = Kernel("sensor/column_offset")
    params = {
        "serial": words(sensor.serial_number),
        "col0": col0,
        "cols": cols,
        "sigma_dn": sensor.column_offset.sigma_dn,
    }
    kernel.record(rec, kernel.cover(quads(col0, cols)), params, offset=offset)
    return offset
