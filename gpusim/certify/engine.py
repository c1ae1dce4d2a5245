"""The engine's part of the certificate: probe pixels of a render against the exact model."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from itertools import count

import numpy as np

from gpusim.certify.budget import (
    BLACK,
    EXACT,
    SURE,
    Certificate,
    Judged,
    Share,
    compare,
    errors,
    settled,
)
from gpusim.certify.probes import FEWEST, MOST, beyond_circle, choose_probes, rounds
from gpusim.parallel import each
from gpusim.plan import Accuracy
from gpusim.psf.field_bank import FieldBank
from gpusim.reference.exact_model import ExactCore
from gpusim.reference.wide import Wide
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.sensor import Sensor


class ExactModel:
    """The exact model of a scene before a camera, without veiling glare.

    Parameters
    ----------
    bank, sensor, scene
        All levels of the bank.
    placed : Chart or PlacedRaster
        The scene's source on the sensor, um.
    """

    def __init__(
        self, bank: FieldBank, sensor: Sensor, scene: Scene, placed: Chart | PlacedRaster
    ) -> None:
        self.placed = placed
        self.centre = np.array([sensor.rows, sensor.cols]) / 2
        core, *halo = bank.levels
        given = sensor, scene.spectra, scene.wavelengths_nm
        exact = ExactCore(core, *given)
        self._core = exact.chart if isinstance(placed, Chart) else exact.raster
        self._halo = [Wide(level, *given) for level in halo]
        self._begun = False

    def rates(
        self, pixels: np.ndarray, progress: Callable[[int, int], None] | None = None
    ) -> np.ndarray:
        """Return the electrons/s (P,) of pixels (P, 2): row and column.

        ``progress``: called with (done, total) pixels.
        """
        # Nearby pixels share kernels: in order of radius.
        order = np.argsort(np.hypot(*(pixels - self.centre).T))
        done = count(1)

        def told(_done: int, _total: int) -> None:
            if progress is not None:
                progress(next(done), len(pixels))

        # The very first one alone: it makes what all share, highlights' squares and the first
        # kernels, which every thread would else make for itself.
        alone = order[: 0 if self._begun else 1]
        self._begun = True
        found = [
            one
            for part in (alone, order[len(alone) :])
            for one in each(self._rate, pixels[part], told)
        ]
        rates = np.empty(len(pixels))
        rates[order] = found
        return rates

    def _rate(self, pixel: np.ndarray) -> float:
        at = self.placed, pixel[None]
        return self._core(*at)[0] + sum(one.at(*at)[0] for one in self._halo)


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
    """Compare a render with the exact model at probe pixels.

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
        Called with (done, total) probes of a round.
    origin : (int, int)
        Row and column of the rectangle's first pixel.
    readout : callable, optional
        Returns the sensor's part at pixels (P, 2), and a note on it; without it there is none.
    judged : callable, optional
        Returns the bank's part and the window's; without it there is none.
    """
    started = time.perf_counter()
    of_bank = Judged(EXACT, 0.0, ()) if judged is None else judged()
    first, most = (FEWEST, MOST) if accuracy.probes is None else (accuracy.probes,) * 2
    chosen = choose_probes(rate, math.lcm(*sensor.period), most)
    exact = ExactModel(bank, sensor, scene, placed)
    taken, truth = np.zeros(0, int), np.zeros(most)
    for one in rounds(most, first):
        truth[one] = exact.rates(chosen[one] + origin, progress)
        taken = np.sort(np.append(taken, one))
        pixels = chosen[taken] + origin
        whole = truth[taken] + glare_at(sensor, glare, pixels)
        found = rate[tuple(chosen[taken].T)].astype(np.float64)
        beyond = beyond_circle(bank, sensor, pixels)
        erring = errors(sensor, whole, found, exposure_s, accuracy, beyond)
        if len(taken) < most and settled(erring, of_bank, accuracy.tolerance):
            break
    share, *notes = (EXACT,) if readout is None else readout(pixels)
    seconds = time.perf_counter() - started
    if len(taken) < most:
        notes.append(
            f"engine: {len(taken)} probes of {most} settle the verdict, within {SURE:g} standard "
            "errors of the mean square"
        )
    if beyond.any():
        words = f"{beyond.sum()} probes lie beyond the image circle, where the signal counts as "
        notes.append(f"{words}{BLACK:.0%} of the mean of the others")
    given = sensor, pixels, whole, found, exposure_s, accuracy, seconds
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
