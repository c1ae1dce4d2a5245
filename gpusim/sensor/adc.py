"""Analogue-to-digital conversion: from electrons to DN. Stage ``shaders/sensor/adc.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.column_offset import record_column_offset
from gpusim.sensor.sensor import Sensor


def record_adc(
    rec: Recording,
    electrons: Array,
    sensor: Sensor,
    *,
    origin: tuple[int, int] = (0, 0),
    label: str = "dn",
    column_offset: bool = True,
) -> Array:
    """Record the conversion of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    electrons : Array (rows, cols), f32
    sensor : Sensor
        Gives system gain, non-linearity, black level, column offsets and bit depth.
    origin : (int, int)
        Row and column of the first pixel.
    label : str
        Label of the buffer that is returned.
    column_offset : bool
        Whether the columns' converters have their offsets, if the sensor has any.

    Returns
    -------
    Array (rows, cols), u32
        DN.
    """
    dn = rec.buffer(label, electrons.shape, "u4")
    rows, cols = electrons.shape
    # What the shader does not read still wants an array: the electrons stand for it.
    tables = dict.fromkeys(("curve", "black", "columns"), electrons)
    overrides = {}

    def table(name: str, values: np.ndarray) -> None:
        values = np.asarray(values, np.float32)
        tables[name] = rec.buffer(f"{label} {name}", values.shape, "f4")
        rec.upload(tables[name], values)

    if sensor.linearity is not None:
        pieces = sensor.linearity.pieces()
        search = 1 << (len(pieces) - 1).bit_length() >> 1
        overrides |= {"PIECES": len(pieces), "SEARCH": search}
        table("curve", pieces)
    if sensor.channel_black_level_dn is not None:
        overrides |= {"SITES": True, "PY": sensor.period[0], "PX": sensor.period[1]}
        table("black", sensor.site_black_dn)
    row0, col0 = origin[0] + sensor.first_row, origin[1] + sensor.first_col
    if column_offset and (offset := sensor.column_offset):
        overrides["COLUMNS"] = True
        if offset.offsets_dn is not None:
            table("columns", offset.offsets_dn[col0 : col0 + cols])
        else:
            drawn = record_column_offset(rec, sensor, col0, cols, label=f"{label} columns")
            tables["columns"] = drawn
    kernel = Kernel("sensor/adc", **overrides)
    params = {
        "row0": row0,
        "col0": col0,
        "rows": rows,
        "cols": cols,
        "system_gain_dn_per_e": sensor.system_gain_dn_per_e,
        "black_level_dn": sensor.black_level_dn,
        "max_dn": sensor.max_dn,
    }
    kernel.record(rec, kernel.cover(cols, rows), params, electrons=electrons, dn=dn, **tables)
    return dn
