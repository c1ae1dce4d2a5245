"""Mosaic: from planes of the filters to a value a pixel. Stage ``shaders/sensor/mosaic.wgsl``."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

ROWS = 16  # of an invocation, as in the shader


def record_mosaic(
    rec: Recording,
    planes: Array,
    glare: Array,
    sensor: Sensor,
    shape: tuple[int, int],
    *,
    origin: tuple[int, int] = (0, 0),
    cell_origin: tuple[int, int] = (0, 0),
    label: str = "rate",
) -> Array:
    """Record the mosaic of a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    planes : Array (S, plane_rows, plane_cols), f32
        Electrons/s: see `gpusim.sensor.planes`.
    glare : Array (sites,), f32
        Veiling glare of each site of the filter pattern, row by row, electrons/s.
    sensor : Sensor
        Gives the filter pattern.
    shape : (int, int)
        Rows and columns of the rectangle.
    origin : (int, int)
        Row and column of its first pixel.
    cell_origin : (int, int)
        Row and column, in samples of the planes, of the first of them.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Electrons/s.

    Raises
    ------
    ValueError
        The planes do not cover the rectangle, or are not those of the sensor's pattern.
    """
    made = planes_of(sensor)
    count, *plane_shape = planes.shape
    axes = zip(cell_origin, origin, shape, plane_shape, strict=True)
    covered = all(
        cell <= first // made.period and (first + number - 1) // made.period < cell + size
        for cell, first, number, size in axes
    )
    sites = len(sensor.site_channels())
    if not covered or count != len(made.channels) or glare.shape != (sites,):
        raise ValueError(f"{planes} from cell {cell_origin} does not give {shape} from {origin}")
    table = rec.buffer(f"{label} sites", made.sites.shape, np.uint32)
    rec.upload(table, made.sites.astype(np.uint32))
    rate = rec.buffer(label, shape, "f4")
    py, px, _ = made.sites.shape
    kernel = Kernel("sensor/mosaic", P=made.period, PY=py, PX=px)
    params = {
        "row0": origin[0],
        "col0": origin[1],
        "rows": shape[0],
        "cols": shape[1],
        "cell_row0": cell_origin[0],
        "cell_col0": cell_origin[1],
        "plane_rows": plane_shape[0],
        "plane_cols": plane_shape[1],
    }
    groups = kernel.cover(shape[1], py * -(-shape[0] // (py * ROWS)))
    kernel.record(rec, groups, params, planes=planes, glare=glare, sites=table, rate=rate)
    return rate
