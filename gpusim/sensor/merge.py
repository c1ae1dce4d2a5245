"""Merge: one linear code of the reads at two gains. Stage ``shaders/sensor/merge.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.sensor import Sensor


def record_merge(
    rec: Recording, high: Array, low: Array, sensor: Sensor, *, label: str = "dn"
) -> Array:
    """Record the merging of two reads of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    high, low : Array (rows, cols), u32
        DN at high and at low conversion gain.
    sensor : Sensor
        Gives gains, black levels and the switch.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), u32
        DN, see `gpusim.sensor.adc_model.DualGain`.
    """
    dn = rec.buffer(label, high.shape, "u4")
    kernel = Kernel("sensor/merge")
    rows, cols = high.shape
    dual = sensor.dual_gain
    params = {
        "rows": rows,
        "cols": cols,
        "switch_dn": dual.switch_dn,
        "black_high_dn": sensor.black_level_dn,
        "black_low_dn": dual.black_level_dn,
        "ratio": sensor.system_gain_dn_per_e / dual.system_gain_dn_per_e,
        "max_dn": sensor.raw_max_dn,
    }
    kernel.record(rec, kernel.cover(cols, rows), params, high=high, low=low, dn=dn)
    return dn
