"""Defects: dead, hot and stuck pixels. Stage ``shaders/sensor/defects.wgsl``."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from gpusim.gpu import Array, Kernel, Recording
from gpusim.sensor.noise_model import DefectPixel
from gpusim.sensor.sensor import Sensor

F32_MAX = float(np.finfo(np.float32).max)

Place = tuple[int, int]


def record_defects(
    rec: Recording,
    mean: Array,
    sensor: Sensor,
    exposure_s: float,
    *,
    temperature_c: float | None = None,
    origin: tuple[int, int] = (0, 0),
    limit_e: float = F32_MAX,
) -> None:
    """Record the dead and hot pixels of a rectangle, in place, before the noise.

    Parameters
    ----------
    rec : Recording
    mean : Array (rows, cols), f32
        Mean electrons.
    sensor : Sensor
    exposure_s : float
    temperature_c : float, optional
        Temperature of the sensor. Further dark current doubles as the others' does.
    origin : (int, int)
        Row and column of the first pixel.
    limit_e : float
        Where a hot pixel is clipped, electrons: the full well where no noise is drawn after it.
    """
    dark_e = exposure_s * sensor.dark_current_at(temperature_c)
    scale = exposure_s * sensor.dark_current_factor(temperature_c)
    changes = {
        place: (0.0, dark_e) if kind == "dead" else (1.0, scale * value)
        for place, (kind, value) in defects_of(sensor).items()
        if kind != "stuck"
    }
    _record(rec, mean, sensor, changes, origin=origin, label="unlit", limit_e=limit_e)


def record_stuck(
    rec: Recording, electrons: Array, sensor: Sensor, *, origin: tuple[int, int] = (0, 0)
) -> None:
    """Record the stuck pixels of a rectangle, in place, after the read-out.

    Parameters
    ----------
    rec : Recording
    electrons : Array (rows, cols), f32
        As read.
    sensor : Sensor
    origin : (int, int)
        Row and column of the first pixel.
    """
    changes = {
        place: (0.0, value)
        for place, (kind, value) in defects_of(sensor).items()
        if kind == "stuck"
    }
    _record(rec, electrons, sensor, changes, origin=origin, label="stuck")


def _record(
    rec: Recording,
    plane: Array,
    sensor: Sensor,
    changes: dict[Place, tuple[float, float]],
    *,
    origin: tuple[int, int],
    label: str,
    limit_e: float = F32_MAX,
) -> None:
    """Record the changes (what is kept, what is added) of the pixels inside the plane, if any."""
    rows, cols = plane.shape
    row0, col0 = sensor.lit_place(origin)
    inside = {
        (row - row0) * cols + col - col0: change
        for (row, col), change in changes.items()
        if row0 <= row < row0 + rows and col0 <= col < col0 + cols
    }
    if not inside:
        return
    keep, add = np.array(list(inside.values()), np.float32).T
    lists = {"at": np.array(list(inside), np.uint32), "keep": keep, "add": add}
    buffers = {}
    for name, values in lists.items():
        buffers[name] = rec.buffer(f"{label} {name} of {plane.label}", len(inside), values.dtype)
        rec.upload(buffers[name], np.ascontiguousarray(values))
    kernel = Kernel("sensor/defects")
    params = {"count": len(inside), "limit_e": limit_e}
    kernel.record(rec, kernel.cover(len(inside)), params, plane=plane, **buffers)


def defects_of(sensor: Sensor) -> dict[Place, tuple[str, float]]:
    """Return kind and value of the defect pixels of a sensor or a region, by row and col.

    Those of the list, and those by chance: each pixel has a number of its own, of which the first
    so many are dead, hot or stuck. It is the same for every region of the chip.
    """
    defects = sensor.defects
    found = _by_chance(
        sensor.serial_number,
        (sensor.first_row, sensor.first_col, sensor.rows, sensor.cols),
        (defects.dead_fraction, defects.hot_fraction, defects.stuck_fraction),
    )
    scales = {"dead": 0.0, "hot": defects.hot_e_per_s, "stuck": sensor.full_well_e}
    by_chance = {place: (kind, scales[kind] * deviate) for place, kind, deviate in found}
    return by_chance | {(pixel.row, pixel.col): _known(pixel) for pixel in defects.pixels}


def _known(pixel: DefectPixel) -> tuple[str, float]:
    return pixel.kind, pixel.value or 0.0


@lru_cache(maxsize=4)
def _by_chance(
    serial_number: int, area: tuple[int, int, int, int], fractions: tuple[float, float, float]
) -> tuple[tuple[Place, str, float], ...]:
    """Return (place, kind, deviate): exponential of mean 1 for hot, even in 0..1 for stuck ones.

    The numbers are the words of NumPy's Philox, counted from the first column of each row of the
    chip; NumPy promises the words of its bit generators for good.
    """
    if not any(fractions):
        return ()
    row0, col0, rows, cols = area
    bounds = np.cumsum((0.0, *fractions))
    found = []
    for row in range(row0, row0 + rows):
        generator = np.random.Philox(key=serial_number, counter=[0, row, 0, 0])
        number = generator.random_raw(col0 + cols)[col0:] * 2.0**-64
        for at in np.flatnonzero(number < bounds[-1]):
            which = int(np.searchsorted(bounds, number[at], side="right")) - 1
            share = (number[at] - bounds[which]) / fractions[which]  # even in 0..1
            kind = ("dead", "hot", "stuck")[which]
            deviate = -math.log1p(-share) if kind == "hot" else float(share)
            found.append(((row, col0 + int(at)), kind, deviate))
    return tuple(found)
