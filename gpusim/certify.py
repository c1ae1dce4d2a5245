"""The certificate: probe pixels of a render against the float64 truth model."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from gpusim.lens.bank import Bank
from gpusim.plan import Accuracy
from gpusim.reference.truth import Truth
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

SEED = 1288  # of the probes' positions: fixed, so that two renders are probed alike
EDGE_SHARE = 0.5  # of the probes lie on the steepest edges


@dataclass(frozen=True)
class Probe:
    """One probe pixel: electrons of truth and render, and the error in two units."""

    row: int
    col: int
    truth: float
    render: float
    relative: float
    sigma: float


@dataclass(frozen=True)
class Certificate:
    """How far the mean signal of a render is from the truth.

    Attributes
    ----------
    probes : int
    rms_relative, worst_relative : float
        Error over the true signal at the probe.
    rms_sigma, worst_sigma : float
        Error over the temporal noise of the probe's pixel.
    worst_position : (int, int)
        Row and column of the probe with the largest relative error.
    met : bool
        Whether the RMS is within the tolerance and no probe is beyond ten times it.
    confidence : str
        What the number of probes supports.
    seconds : float
    points : tuple of Probe
    """

    probes: int
    rms_relative: float
    worst_relative: float
    rms_sigma: float
    worst_sigma: float
    worst_position: tuple[int, int]
    met: bool
    confidence: str
    seconds: float
    points: tuple[Probe, ...]


def choose_probes(rate: np.ndarray, period: int, count: int) -> np.ndarray:
    """Choose probe pixels: half spread over the field, half on the steepest edges.

    Parameters
    ----------
    rate : ndarray (rows, cols)
        Mean signal.
    period : int
        Of the filter pattern: edges are sought between pixels of one colour.
    count : int

    Returns
    -------
    ndarray (count, 2) of int
        Row and column.
    """
    rng = np.random.default_rng(SEED)
    rows, cols = rate.shape
    edges = int(count * EDGE_SHARE)
    chosen = []
    for number in (count - edges, edges):
        across = max(1, int(np.ceil(np.sqrt(number * cols / rows))))
        down = max(1, -(-number // across))
        for k in range(number):
            row0, row1 = (rows * (k // across) // down, rows * (k // across + 1) // down)
            col0, col1 = (cols * (k % across) // across, cols * (k % across + 1) // across)
            row1, col1 = max(row1, row0 + 1), max(col1, col0 + 1)
            if number == edges and chosen and len(chosen) >= count - edges:
                part = rate[row0:row1, col0:col1].astype(np.float64)
                slope = np.zeros(part.shape)
                slope[:, period:] = np.abs(part[:, period:] - part[:, :-period])
                slope[period:] = np.maximum(slope[period:], np.abs(part[period:] - part[:-period]))
                row, col = np.unravel_index(np.argmax(slope), slope.shape)
                chosen.append((row0 + int(row), col0 + int(col)))
            else:
                chosen.append((int(rng.integers(row0, row1)), int(rng.integers(col0, col1))))
    return np.array(chosen, int).reshape(-1, 2)


def certify(
    bank: Bank,
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    rate: np.ndarray,
    glare: np.ndarray,
    exposure_s: float,
    accuracy: Accuracy,
    progress: Callable[[int, int], None] | None = None,
    origin: tuple[int, int] = (0, 0),
) -> Certificate:
    """Compare a render with the truth model at probe pixels.

    Parameters
    ----------
    bank, sensor, scene
    placed : Chart or PlacedRaster
        The scene's source on the sensor, um.
    rate : ndarray (rows, cols)
        Electrons/s of the render, or of a rectangle of it.
    glare : ndarray (S,)
        Veiling glare of each CFA site, electrons/s: an input of both.
    exposure_s : float
    accuracy : Accuracy
    progress : callable, optional
        Called with (done, total) probes.
    origin : (int, int)
        Row and column of the rectangle's first pixel.
    """
    started = time.perf_counter()
    period = sensor.period
    pixels = choose_probes(rate, period[0], accuracy.probes) + origin
    truth = Truth(bank, sensor, scene.spectra, WAVELENGTHS_NM)
    evaluate = truth.chart if isinstance(placed, Chart) else truth.raster

    def probe(pixel: np.ndarray) -> Probe:
        row, col = map(int, pixel)
        value = (
            evaluate(placed, pixel[None])[0] + glare[row % period[0] * period[1] + col % period[1]]
        )
        true_e, render_e = (
            float(value * exposure_s),
            float(rate[row - origin[0], col - origin[1]]) * exposure_s,
        )
        noise_e = np.sqrt(max(true_e, 0.0) + sensor.temporal_dark_noise_e**2)
        error = abs(render_e - true_e)
        return Probe(
            row,
            col,
            true_e,
            render_e,
            error / true_e if true_e > 0 else float(error > 0),
            float(error / noise_e) if noise_e > 0 else 0.0,
        )

    points = []
    # NumPy and SciPy let go of the interpreter in their loops. Nearby probes share kernels: in
    # order of radius.
    centre = np.array([sensor.rows, sensor.cols]) / 2
    order = np.argsort(np.hypot(*(pixels - centre).T))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for number, point in enumerate(pool.map(probe, pixels[order]), start=1):
            points.append(point)
            if progress is not None:
                progress(number, len(pixels))
    relative = np.array([point.relative for point in points])
    sigma = np.array([point.sigma for point in points])
    worst = points[int(relative.argmax())]
    rms = float(np.sqrt(np.mean(relative**2)))
    count = len(points)
    return Certificate(
        probes=count,
        rms_relative=rms,
        worst_relative=worst.relative,
        rms_sigma=float(np.sqrt(np.mean(sigma**2))),
        worst_sigma=float(sigma.max()),
        worst_position=(worst.row, worst.col),
        met=rms <= accuracy.tolerance and worst.relative <= 10 * accuracy.tolerance,
        # Rule of three (Hanley & Lippman-Hand 1983): none of n above t, so fewer than 3/n at 95 %.
        confidence=f"At 95 % confidence fewer than {min(1.0, 3 / count):.1%} of such pixels err "
        f"by more than {worst.relative:.1e}.",
        seconds=time.perf_counter() - started,
        points=tuple(points),
    )
