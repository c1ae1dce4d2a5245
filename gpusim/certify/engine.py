"""The engine's part of the certificate: probe pixels of a render against the exact model."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain

import numpy as np
from threadpoolctl import threadpool_limits

from gpusim.certify.budget import BLACK, EXACT, Certificate, Judged, Share, compare
from gpusim.certify.probes import beyond_circle, choose_probes
from gpusim.plan import Accuracy
from gpusim.psf.field_bank import FieldBank
from gpusim.reference.truth import Truth
from gpusim.reference.wide import Wide
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


def true_rates(
    bank: FieldBank,
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
        All levels of the bank.
    placed : Chart or PlacedRaster
        The scene's source on the sensor, um.
    pixels : ndarray (P, 2) of int
        Row and column.
    progress : callable, optional
        Called with (done, total) pixels.
    """
    core, *halo = bank.levels
    truth = Truth(core, sensor, scene.spectra, scene.wavelengths_nm)
    evaluate = truth.chart if isinstance(placed, Chart) else truth.raster
    wide = [Wide(level, sensor, scene.spectra, scene.wavelengths_nm) for level in halo]
    # Nearby pixels share kernels: in order of radius.
    centre = np.array([sensor.rows, sensor.cols]) / 2
    order = np.argsort(np.hypot(*(pixels - centre).T))
    rates = np.empty(len(pixels))

    def rate_at(number: int) -> float:
        pixel = pixels[number : number + 1]
        return evaluate(placed, pixel)[0] + sum(one.at(placed, pixel)[0] for one in wide)

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


def certify(
    bank: FieldBank,
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    rate: np.ndarray,
    glare: np.ndarray,
    exposure_s: float,
    accuracy: Accuracy,
    progress: Callable[[int, int], None] | None = None,
    origin: tuple[int, int] = (0, 0),
    readout: Callable[[np.ndarray], tuple[Share, str]] | None = None,
    judged: Callable[[], Judged] | None = None,
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
    readout : callable, optional
        Returns the sensor's part at pixels (P, 2), and a note on it; without it there is none.
    judged : callable, optional
        Returns the bank's part and the window's; without it there is none.
    """
    started = time.perf_counter()
    there = choose_probes(rate, math.lcm(*sensor.period), accuracy.probes)
    pixels = there + origin
    truth = true_rates(bank, sensor, scene, placed, pixels, progress)
    truth += glare_at(sensor, glare, pixels)
    share, *notes = (EXACT,) if readout is None else readout(pixels)
    of_bank = Judged(EXACT, 0.0, ()) if judged is None else judged()
    seconds = time.perf_counter() - started
    found = rate[tuple(there.T)]
    beyond = beyond_circle(bank, sensor, pixels)
    if beyond.any():
        words = f"{beyond.sum()} probes lie beyond the image circle, where the signal counts as "
        notes.append(f"{words}{BLACK:.0%} of the mean of the others")
    given = sensor, pixels, truth, found, exposure_s, accuracy, seconds
    return compare(
        *given,
        bank=of_bank.share,
        readout=share,
        window=of_bank.window,
        notes=(*of_bank.notes, *notes),
        beyond=beyond,
    )


def glare_at(sensor: Sensor, glare: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the veiling glare (P,) at pixels (P, 2), from that of each CFA site."""
    down, across = sensor.period
    return np.asarray(glare, np.float64)[pixels[:, 0] % down * across + pixels[:, 1] % across]
