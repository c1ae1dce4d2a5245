"""Veiling glare: light scattered evenly over the frame, as a fraction of the mean signal."""

from __future__ import annotations

import numpy as np

from gpusim.lens.field_bank import FieldBank
from gpusim.optics.splat import squares_on_sensor
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.sensor import Sensor

SIDE = 256  # points along each side: the mean of a chart is then good to a few parts in a thousand


def veiling_glare(
    bank: FieldBank,
    sensor: Sensor,
    source: Chart | PlacedRaster,
    weights: np.ndarray,
    coefficients: np.ndarray,
) -> np.ndarray:
    """Return the veiling glare of every CFA site.

    The scene's mean over the sensor is taken on a grid of points, before the PSFs (which conserve
    energy) and with the relative illumination, so that it does not depend on tiles. A photograph's
    highlights are too small for the grid: each counts by its area.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    source : Chart or PlacedRaster
    weights : ndarray (J, C, L)
        Electrons/s of each plane in each channel, by bank wavelength.
    coefficients : ndarray (M, J)
        Of the scene's spectra.

    Returns
    -------
    ndarray (S,)
        Electrons/s, by site of the filter pattern, row by row.
    """
    pitch = sensor.pixel_pitch_um
    line = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    x, y = np.meshgrid(line * sensor.cols * pitch, line * sensor.rows * pitch)
    u, v, lit = bank.ideal_points(x, y)
    if isinstance(source, Chart):
        planes = np.moveaxis(coefficients[source.material_at(u, v)], -1, 0)
    else:
        cols = np.clip((u - source.x0_um) / source.pitch_um, 0, source.planes.shape[2] - 1)
        rows = np.clip((v - source.y0_um) / source.pitch_um, 0, source.planes.shape[1] - 1)
        sampled = source.planes[:, rows.astype(int), cols.astype(int)]
        planes = np.tensordot(coefficients.T, sampled, axes=1)
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
