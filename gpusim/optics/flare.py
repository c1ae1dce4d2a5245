"""Veiling glare: light scattered evenly over the frame, as a fraction of the mean signal."""

from __future__ import annotations

import numpy as np

from gpusim.optics.angular import PlaceWeights
from gpusim.optics.highlight_squares import squares_on_sensor
from gpusim.psf.field_bank import FieldBank
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.sensor import Sensor

SIDE = 256  # cells along each side, with a point in each: the mean of a chart is good to 1e-3
LINE = (np.arange(SIDE) + 0.5) / SIDE - 0.5  # their middles, of the sensor's side
# Points lie anywhere in their cells: in the middles they would beat with patterns that repeat, and
# squares of 32 pixels in 64 came out 3.3e-3 off.
SEED = 9358
SHARED = 8  # points each way that share one quantum efficiency, where it goes with the place


def veiling_glare(
    bank: FieldBank,
    sensor: Sensor,
    source: Chart | PlacedRaster,
    weights: np.ndarray,
    coefficients: np.ndarray,
    *,
    elsewhere: PlaceWeights | None = None,
) -> np.ndarray:
    """Return the veiling glare of every CFA site.

    The scene's mean over the sensor is taken at a point in each cell of a grid, before the PSFs
    (which conserve energy) and with the relative illumination, so that it does not depend on tiles.
    A photograph's highlights are too small for the grid: each counts by its area.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    source : Chart or PlacedRaster
    weights : ndarray (J, C, L)
        Electrons/s of each plane in each channel, by bank wavelength.
    coefficients : ndarray (M, J)
        Coefficients of the scene's spectra.
    elsewhere : PlaceWeights, optional
        In place of the weights, where they go with the place.

    Returns
    -------
    ndarray (S,)
        Electrons/s, by site of the filter pattern, row by row.
    """
    if sensor.veiling_glare == 0:
        return np.zeros(len(sensor.site_channels()))
    pitch = sensor.pixel_pitch_um
    x, y = np.meshgrid(LINE * sensor.cols * pitch, LINE * sensor.rows * pitch)
    away = (np.random.default_rng(SEED).random((2, SIDE, SIDE)) - 0.5) * pitch / SIDE
    x, y = x + away[0] * sensor.cols, y + away[1] * sensor.rows
    u, v, lit = bank.ideal_points(x, y)
    if isinstance(source, Chart):
        planes = np.moveaxis(coefficients[source.material_at(u, v)], -1, 0)
    else:
        cols = np.clip((u - source.x0_um) / source.pitch_um, 0, source.planes.shape[2] - 1)
        rows = np.clip((v - source.y0_um) / source.pitch_um, 0, source.planes.shape[1] - 1)
        sampled = source.planes[:, rows.astype(int), cols.astype(int)]
        planes = np.tensordot(coefficients.T, sampled, axes=1)
    if elsewhere is not None:
        mean = _mean_by_place(
            bank, sensor, source, elsewhere, coefficients=coefficients, planes=planes * lit
        )
    else:
        illumination = bank.illumination_at(x, y) * lit
        moments = np.einsum("jyx,lyx->jl", planes, illumination) / SIDE**2
        if isinstance(source, PlacedRaster) and len(source.highlights):
            squares = squares_on_sensor(bank, sensor, source.highlights, 0.0)
            area_um2 = sensor.rows * sensor.cols * pitch**2
            light = bank.illumination_at(*squares.real_um.T)
            moments += np.einsum("nm,mj,ln->jl", squares.light, coefficients, light) / area_um2
        mean = np.einsum("jl,jcl->c", moments, weights)
    channels = list(sensor.channels)
    return sensor.veiling_glare * mean[[channels.index(name) for name in sensor.site_channels()]]


def _mean_by_place(
    bank: FieldBank,
    sensor: Sensor,
    source: Chart | PlacedRaster,
    elsewhere: PlaceWeights,
    *,
    coefficients: np.ndarray,
    planes: np.ndarray,
) -> np.ndarray:
    """Return the mean electrons/s (C,) where the weights go with the place.

    They change slowly: `SHARED` x `SHARED` of the points, at which the planes are given, share
    them.
    """
    pitch = sensor.pixel_pitch_um
    light = planes.reshape(-1, *(SIDE // SHARED, SHARED) * 2).sum(axis=(2, 4)) / SIDE**2
    middles = LINE.reshape(-1, SHARED).mean(axis=1)
    y, x = middles * sensor.rows * pitch, middles * sensor.cols * pitch
    parts = [
        light[:, row, col] @ elsewhere.at(x[col], y[row]).sum(axis=2)
        for row, col in np.ndindex(light.shape[1:])
    ]
    if isinstance(source, PlacedRaster) and len(source.highlights):
        squares = squares_on_sensor(bank, sensor, source.highlights, 0.0)
        shares = squares.light @ coefficients / (sensor.rows * sensor.cols * pitch**2)
        parts += [
            share @ elsewhere.at(*place).sum(axis=2)
            for share, place in zip(shares, squares.real_um, strict=True)
        ]
    return np.sum(parts, axis=0)
