"""The certificate: probe pixels of a render against the float64 truth model."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain

import numpy as np
from threadpoolctl import threadpool_limits

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
WORST_TO_RMS = 10.0  # what no probe may exceed, in tolerances


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
        Error over the temporal noise of the probe's pixel, both as far as the full well reaches.
    worst_position : (int, int)
        Row and column of the probe with the largest error, in the tolerance's unit.
    met : bool
        Whether, in the tolerance's unit, the RMS is within it and no probe beyond ten times it.
    confidence : str
        What the number of probes supports.
    seconds : float
        What the truth took: apart from the render's time.
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


def true_rates(
    bank: Bank,
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    pixels: np.ndarray,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """Return the electrons/s (P,) of pixels (P, 2) by the truth model, without veiling glare.

    Parameters
    ----------
    bank, sensor, scene
    placed : Chart or PlacedRaster
        The scene's source on the sensor, um.
    pixels : ndarray (P, 2) of int
        Row and column.
    progress : callable, optional
        Called with (done, total) pixels.
    """
    truth = Truth(bank, sensor, scene.spectra, WAVELENGTHS_NM)
    evaluate = truth.chart if isinstance(placed, Chart) else truth.raster
    # Nearby pixels share kernels: in order of radius.
    centre = np.array([sensor.rows, sensor.cols]) / 2
    order = np.argsort(np.hypot(*(pixels - centre).T))
    rates = np.empty(len(pixels))

    def rate_at(number: int) -> float:
        return evaluate(placed, pixels[number : number + 1])[0]

    # NumPy and SciPy let go of the interpreter in their loops; BLAS's own threads wait by spinning.
    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        # The first one alone: it makes what all share, highlights' squares and the first kernels,
        # which every thread would else make for itself.
        first = [rate_at(number) for number in order[:1]]
        found = chain(first, pool.map(rate_at, order[1:]))
        for done, (number, rate) in enumerate(zip(order, found, strict=True), start=1):
            rates[number] = rate
            if progress is not None:
                progress(done, len(pixels))
    return rates


def compare(
    sensor: Sensor,
    pixels: np.ndarray,
    truth: np.ndarray,
    rate: np.ndarray,
    exposure_s: float,
    accuracy: Accuracy,
    seconds: float,
) -> Certificate:
    """Judge a render by the truth at some pixels.

    Parameters
    ----------
    sensor : Sensor
    pixels : ndarray (P, 2) of int
        Row and column.
    truth, rate : ndarray (P,)
        Electrons/s of truth and render there, both with veiling glare.
    exposure_s : float
    accuracy : Accuracy
        What was asked for.
    seconds : float
        What the truth took.
    """
    points = []
    for (row, col), true_rate, found in zip(pixels.tolist(), truth, rate, strict=True):
        true_e, render_e = float(true_rate * exposure_s), float(found) * exposure_s
        # What the full well cuts off is in no frame.
        seen_e, shown_e = (min(value, sensor.full_well_e) for value in (true_e, render_e))
        noise_e = np.sqrt(max(seen_e, 0.0) + sensor.temporal_dark_noise_e**2)
        error = abs(render_e - true_e)
        points.append(
            Probe(
                row,
                col,
                true_e,
                render_e,
                error / true_e if true_e > 0 else float(error > 0),
                float(abs(shown_e - seen_e) / noise_e) if noise_e > 0 else 0.0,
            )
        )
    judged = np.array([getattr(point, accuracy.unit) for point in points])
    relative = np.array([point.relative for point in points])
    sigma = np.array([point.sigma for point in points])
    worst = points[int(judged.argmax())]
    rms, most = float(np.sqrt(np.mean(judged**2))), float(judged.max())
    count = len(points)
    unit = "" if accuracy.unit == "relative" else " sigma of the noise"
    return Certificate(
        probes=count,
        rms_relative=float(np.sqrt(np.mean(relative**2))),
        worst_relative=float(relative.max()),
        rms_sigma=float(np.sqrt(np.mean(sigma**2))),
        worst_sigma=float(sigma.max()),
        worst_position=(worst.row, worst.col),
        met=rms <= accuracy.tolerance and most <= WORST_TO_RMS * accuracy.tolerance,
        # Rule of three (Hanley & Lippman-Hand 1983): none of n above t, so fewer than 3/n at 95 %.
        confidence=f"At 95 % confidence fewer than {min(1.0, 3 / count):.1%} of such pixels err "
        f"by more than {most:.1e}{unit}.",
        seconds=seconds,
        points=tuple(points),
    )


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
    there = choose_probes(rate, math.lcm(*sensor.period), accuracy.probes)
    pixels = there + origin
    truth = true_rates(bank, sensor, scene, placed, pixels, progress)
    truth += glare_at(sensor, glare, pixels)
    seconds = time.perf_counter() - started
    return compare(sensor, pixels, truth, rate[tuple(there.T)], exposure_s, accuracy, seconds)


def glare_at(sensor: Sensor, glare: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the veiling glare (P,) at pixels (P, 2), from that of each CFA site."""
    down, across = sensor.period
    return np.asarray(glare, np.float64)[pixels[:, 0] % down * across + pixels[:, 1] % across]
