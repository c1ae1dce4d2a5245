"""A scene as the eye would see it, in linear Rec.709, and its spectral radiance in bands."""

from __future__ import annotations

from itertools import product

import numpy as np

from gpusim.scene.chart import Chart, Disc, Polygon
from gpusim.scene.charts import HALF_WIDTH
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, rgb_to_xyz
from gpusim.scene.patterns import OVERSCAN
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import xyz

SUBSAMPLES = 4  # per pixel and direction: edges in 17 grey levels


def _material_map(chart: Chart, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the material at each node (y, x) of a grid: `Chart.material_at` by windows."""
    material = np.full((y.size, x.size), chart.background, np.uint16)
    for p in chart.primitives:
        ends = (
            np.array([(p.cx - p.reach, p.cy - p.reach), (p.cx + p.reach, p.cy + p.reach)])
            if isinstance(p, Disc)
            else p.corners()
        )
        low, high = np.searchsorted(x, (ends[:, 0].min(), ends[:, 0].max()))
        top, bottom = np.searchsorted(y, (ends[:, 1].min(), ends[:, 1].max()))
        part = x[None, low:high], y[top:bottom, None]
        inside = p.within(*part) if isinstance(p, Polygon) else p.distance(*part) <= 0
        material[top:bottom, low:high][inside] = p.material
    return material


def chart_rgb(scene: Scene, rows: int) -> np.ndarray:
    """Return a chart over its 4:3 field in linear Rec.709, area-averaged.

    The illuminant is adapted to D65 (Bradford), so that a perfect white is (1, 1, 1). Colours
    outside Rec.709 are clipped to it: of the ColorChecker under D50, cyan only.

    Parameters
    ----------
    scene : Scene
        A scene whose source is a chart. One that is drawn on samples is made without a frame.
    rows : int
        Height of the result.

    Returns
    -------
    ndarray (rows, round(4/3 rows), 3), float32
    """
    return _drawn(scene, rows, np.maximum(_rgb_of_spectra(scene), 0.0))


def seen_rgb(scene: Scene, rows: int) -> np.ndarray:
    """Return any scene in linear Rec.709, as `chart_rgb`: a picture's samples, its whole area.

    Parameters
    ----------
    scene : Scene
    rows : int
        Height of the result; of a picture with fewer, its own.

    Returns
    -------
    ndarray (rows, columns, 3), float32
    """
    if isinstance(scene.source, Chart):
        return chart_rgb(scene, rows)
    planes = scene.source.planes
    size = max(planes.shape[1] // rows, 1)  # samples of a cell, each way
    count, high, wide = planes.shape[0], *(n // size * size for n in planes.shape[1:])
    cells = planes[:, :high, :wide].reshape(count, high // size, size, -1, size)
    means = np.moveaxis(cells.mean(axis=(2, 4)), 0, -1)
    return np.maximum(means @ _rgb_of_spectra(scene), 0.0).astype(np.float32)


def _rgb_of_spectra(scene: Scene) -> np.ndarray:
    """Return the scene's spectra in linear Rec.709 (M, 3), its white at (1, 1, 1)."""
    white = xyz(scene.white, scene.wavelengths_nm)
    space = rgb_to_xyz(REC709_CHROMATICITIES)
    to_rgb = np.linalg.solve(space, adaptation(white / white[1], space.sum(axis=1)))
    return xyz(scene.spectra, scene.wavelengths_nm) / white[1] @ to_rgb.T


def chart_radiance(scene: Scene, rows: int, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return a chart's spectral radiance over its 4:3 field, area-averaged.

    Parameters
    ----------
    scene : Scene
        As of `chart_rgb`.
    rows : int
        Height of the result.
    wavelengths_nm : ndarray (bands,)

    Returns
    -------
    ndarray (rows, round(4/3 rows), bands), float32
        W m^-2 sr^-1 nm^-1.
    """
    return _drawn(scene, rows, scene.on(wavelengths_nm).spectra)


def picture_radiance(scene: Scene, wavelengths_nm: np.ndarray) -> np.ndarray:
    """Return a picture's spectral radiance at its own samples.

    Parameters
    ----------
    scene : Scene
        A scene whose source is a picture.
    wavelengths_nm : ndarray (bands,)

    Returns
    -------
    ndarray (rows, cols, bands), float32
        W m^-2 sr^-1 nm^-1.
    """
    spectra = scene.on(wavelengths_nm).spectra.astype(np.float32)
    return np.tensordot(scene.source.planes, spectra, axes=(0, 0))


def _drawn(scene: Scene, rows: int, values: np.ndarray) -> np.ndarray:
    """Return a chart whose materials have these values (M, n): (rows, columns, n)."""
    materials, columns = values.astype(np.float32), round(HALF_WIDTH * rows)
    if isinstance(scene.source, Raster):
        return _averaged(scene.source, rows, columns) @ materials
    total = np.zeros((rows, columns, materials.shape[1]), np.float32)
    phases = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES
    for right, down in product(phases, phases):
        x = (np.arange(columns) + right - columns / 2) / (rows / 2)
        y = (np.arange(rows) + down - rows / 2) / (rows / 2)
        total += materials[_material_map(scene.source, x, y)]
    return total / SUBSAMPLES**2


def _averaged(raster: Raster, rows: int, columns: int) -> np.ndarray:
    """Return the means (rows, columns, M) of a chart's samples in cells of its field."""
    planes = raster.planes
    for axis, count in ((1, rows), (2, columns)):
        # The samples go on beyond the field: what of each lies in each cell.
        samples = planes.shape[axis]
        ends = (np.arange(count + 1) - count / 2) / count * samples / OVERSCAN + samples / 2
        start = np.zeros_like(np.take(planes, [0], axis), np.float64)
        sums = np.concatenate([start, np.cumsum(planes, axis=axis, dtype=np.float64)], axis=axis)
        low = np.floor(ends).astype(int)
        part = (ends - low).reshape([-1 if one == axis else 1 for one in range(3)])
        at_ends = (1 - part) * np.take(sums, low, axis) + part * np.take(
            sums, np.minimum(low + 1, samples), axis
        )
        planes = np.diff(at_ends, axis=axis) / (ends[1] - ends[0])
    return np.moveaxis(planes, 0, -1).astype(np.float32)
