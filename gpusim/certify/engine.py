"""The engine's part of the certificate: probe pixels of a render against the exact model."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import cached_property
from itertools import count

import numpy as np

from gpusim.certify.budget import (
    BLACK,
    EXACT,
    SURE,
    Certificate,
    Judged,
    Measure,
    Placed,
    Share,
    compare,
    settled,
)
from gpusim.certify.probes import FEWEST, MOST, beyond_circle, choose_probes, rounds
from gpusim.parallel import each
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.reference.exact_model import ExactCore
from gpusim.reference.fields import Grid, Heights
from gpusim.reference.landing import Landings
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
        self.bank, self.sensor, self.scene, self.placed = bank, sensor, scene, placed
        self.centre = np.array([sensor.rows, sensor.cols]) / 2
        self._begun = False

    @cached_property
    def _parts(self) -> list[Callable[[Chart | PlacedRaster, np.ndarray], np.ndarray]]:
        """What the core and each level of the halo bring."""
        core, *halo = self.bank.levels
        given = self.sensor, self.scene.spectra, self.scene.wavelengths_nm
        exact = ExactCore(core, *given, landings=self.landings)
        first = exact.chart if isinstance(self.placed, Chart) else exact.raster
        return [first, *(Wide(level, *given, landings=self.landings).at for level in halo)]

    @cached_property
    def landings(self) -> Landings:
        """Where the scene's highlights land: all levels have one map."""
        return Landings((Grid if isinstance(self.bank, PlaneBank) else Heights)(self.bank))

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
        core, *halo = (part(self.placed, pixel[None])[0] for part in self._parts)
        return core + sum(halo)


def certify(
    exact: ExactModel,
    rate: Placed,
    glare: np.ndarray,
    by: Measure,
    *,
    progress: Callable[[int, int], None] | None = None,
    readout: Callable[[np.ndarray], tuple[Share, str]] | None = None,
    judged: Callable[[], Judged] | None = None,
) -> Certificate:
    """Compare a render with the exact model at probe pixels.

    Parameters
    ----------
    exact : ExactModel
    rate : Placed
        Electrons/s of the render, or of a rectangle of it.
    glare : ndarray (S,)
        Veiling glare of each CFA site, electrons/s: an input of both.
    by : Measure
    progress : callable, optional
        Called with (done, total) probes of a round.
    readout : callable, optional
        Returns the sensor's part at pixels (P, 2), and a note on it; without it there is none.
    judged : callable, optional
        Returns the bank's part and the window's; without it there is none.
    """
    started = time.perf_counter()
    sensor, accuracy = exact.sensor, by.accuracy
    of_bank = Judged(EXACT, 0.0, ()) if judged is None else judged()
    first, most = (FEWEST, MOST) if accuracy.probes is None else (accuracy.probes,) * 2
    chosen = choose_probes(rate.plane, math.lcm(*sensor.period), most)
    taken, truth = np.zeros(0, int), np.zeros(most)
    for one in rounds(most, first):
        truth[one] = exact.rates(chosen[one] + rate.origin, progress)
        taken = np.sort(np.append(taken, one))
        pixels = chosen[taken] + rate.origin
        whole = truth[taken] + glare_at(sensor, glare, pixels)
        found = rate.at(*pixels.T)
        beyond = beyond_circle(exact.bank, sensor, pixels)
        erring = by.errors(whole, found, beyond)
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
    return compare(
        by,
        pixels,
        whole,
        found,
        seconds=seconds,
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
