"""Analogue-to-digital conversion: from electrons to DN. Stage ``shaders/sensor/adc.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.sensor import Sensor


def record_adc(rec: Recording, electrons: Array, sensor: Sensor, *, label: str = "dn") -> Array:
    """Record the conversion of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    electrons : Array (rows, cols), f32
    sensor : Sensor
        Gives system gain, black level and bit depth.
    label : str
        Of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), u32
        DN.
    """
    dn = rec.buffer(label, electrons.shape, "u4")
    kernel = Kernel("sensor/adc")
    rows, cols = electrons.shape
    params = {
        "rows": rows,
        "cols": cols,
        "system_gain_dn_per_e": sensor.system_gain_dn_per_e,
        "black_level_dn": sensor.black_level_dn,
        "max_dn": sensor.max_dn,
    }
    kernel.record(rec, kernel.cover(cols, rows), params, electrons=electrons, dn=dn)
    return dn
