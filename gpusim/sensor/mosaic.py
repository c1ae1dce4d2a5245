"""Mosaic: from a plane a filter site to a value a pixel. Stage ``shaders/sensor/mosaic.wgsl``."""

from __future__ import annotations

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.sensor import Sensor


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
        Electrons/s of each site of the filter pattern, row by row.
    glare : Array (S,), f32
        Veiling glare of each site, electrons/s.
    sensor : Sensor
        Gives the filter pattern.
    shape : (int, int)
        Rows and columns of the rectangle.
    origin : (int, int)
        Row and column of its first pixel.
    cell_origin : (int, int)
        Row and column, in whole filter patterns, of the first sample of the planes.
    label : str
        Of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Electrons/s.

    Raises
    ------
    ValueError
        The planes do not cover the rectangle, or are not those of the sensor's pattern.
    """
    period = sensor.period
    sites, *plane_shape = planes.shape
    axes = zip(cell_origin, origin, shape, period, plane_shape, strict=True)
    covered = all(
        cell <= first // step and (first + count - 1) // step < cell + size
        for cell, first, count, step, size in axes
    )
    if not covered or sites != period[0] * period[1] or glare.shape != (sites,):
        raise ValueError(f"{planes} from cell {cell_origin} does not give {shape} from {origin}")
    rate = rec.buffer(label, shape, "f4")
    kernel = Kernel("sensor/mosaic", PY=period[0], PX=period[1])
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
    groups = kernel.cover(shape[1], shape[0])
    kernel.record(rec, groups, params, planes=planes, glare=glare, rate=rate)
    return rate
