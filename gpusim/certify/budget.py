"""The error budget: how far a render is from the picture of the lens in the file, part by part.

Four parts add up to what the tolerance is about:

- ``engine``: the render against the exact model on the same bank of PSFs;
- ``bank``: the bank against PSFs traced anew, at fields and wavelengths between its own;
- ``sensor``: from light to the electrons that the noise is drawn from, against float64;
- ``window``: light that lands beyond every PSF of the bank.

The first three are independent errors of either sign, so their squares add; light that is missing
always errs to one side and is added whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from gpusim.plan import Accuracy
from gpusim.sensor.frame import Rect
from gpusim.sensor.sensor import Sensor

WORST_TO_RMS = 10.0  # what no probe may exceed, in tolerances
SURE = 3.0  # standard errors of the mean square error, within which a verdict must not change
CLEAR = 0.5  # of what no probe may exceed: further probes may well be worse than those before
# What a black patch sends of the light around it, at least: what plans are made for (CHARTS of
# `gpusim.plan.contrast`). Pixels beyond the image circle count as such.
BLACK = 0.05


class Placed(NamedTuple):
    """A plane (rows, cols) of pixels, and the rectangle (row, col, rows, cols) of the sensor."""

    plane: np.ndarray
    rect: Rect

    @property
    def origin(self) -> tuple[int, int]:
        """Row and column of the first pixel."""
        return self.rect[:2]

    def at(self, row: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Return what pixels hold, float64."""
        return self.plane[row - self.rect[0], col - self.rect[1]].astype(np.float64)


@dataclass(frozen=True)
class Measure:
    """What an error of the light is measured by.

    Attributes
    ----------
    sensor : Sensor
        Gives the temporal noise and the full well.
    exposure_s : float
        The frame's.
    accuracy : Accuracy
        What was asked for.
    """

    sensor: Sensor
    exposure_s: float
    accuracy: Accuracy

    def errors(
        self, truth: np.ndarray, rate: np.ndarray, beyond: np.ndarray | None = None
    ) -> np.ndarray:
        """Return errors (P,) in the tolerance's unit, of electrons/s truth and rate (P,).

        `beyond`: which pixels lie outside the image circle.
        """
        exposure_s = self.exposure_s
        relative, sigma = _both(self.sensor, truth * exposure_s, rate * exposure_s, beyond)
        return relative if self.accuracy.unit == "relative" else sigma


@dataclass(frozen=True)
class Share:
    """One part of the error, in the tolerance's unit.

    Attributes
    ----------
    rms, worst : float
        Over the probes at which the part was measured.
    probes : int
        How many they are.
    """

    rms: float
    worst: float
    probes: int


EXACT = Share(0.0, 0.0, 0)


@dataclass(frozen=True)
class Judged:
    """What the comparison of a bank with its lens found.

    Attributes
    ----------
    share : Share
    window : float
        Light beyond the last level, in the tolerance's unit.
    notes : tuple of str
    """

    share: Share
    window: float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Probe:
    """One probe pixel: electrons of exact model and render, and the error in two units."""

    row: int
    col: int
    truth: float
    render: float
    relative: float
    sigma: float


@dataclass(frozen=True)
class Certificate:
    """How far the mean signal of a render is from the picture of the lens in the file.

    Attributes
    ----------
    probes : int
    rms_relative, worst_relative : float
        The engine's error over the true signal at the probe.
    rms_sigma, worst_sigma : float
        The same over the temporal noise of the probe's pixel, both as far as the full well reaches.
    worst_position : (int, int)
        Row and column of the probe with the largest error, in the tolerance's unit.
    unit : str
        Unit of the tolerance, and of what follows: "relative" or "sigma".
    engine_rms, engine_worst, bank_rms, bank_worst, sensor_rms, sensor_worst, window : float
        The parts of the error: see the module. 0 where a part cannot err.
    total_rms, total_worst : float
        All parts together.
    notes : tuple of str
        How the parts were measured, and what they leave open.
    met : bool
        Whether the total RMS is within the tolerance and no probe beyond ten times it.
    confidence : str
        What the number of probes supports.
    seconds : float
        What the exact model took: apart from the render's time.
    points : tuple of Probe
    """

    probes: int
    rms_relative: float
    worst_relative: float
    rms_sigma: float
    worst_sigma: float
    worst_position: tuple[int, int]
    unit: str
    engine_rms: float
    engine_worst: float
    bank_rms: float
    bank_worst: float
    sensor_rms: float
    sensor_worst: float
    window: float
    total_rms: float
    total_worst: float
    notes: tuple[str, ...] = field(repr=False)
    met: bool
    confidence: str = field(repr=False)
    seconds: float
    points: tuple[Probe, ...] = field(repr=False)


def settled(found: np.ndarray, bank: Judged, tolerance: float) -> bool:
    """Return whether further probes would hardly change the verdict on a render.

    Parameters
    ----------
    found : ndarray (P,)
        Errors of the engine at the probes so far, in the tolerance's unit: drawn at random.
    bank : Judged
        What the bank and the window add to them.
    tolerance : float
    """
    squares = found**2
    unsure = SURE * squares.std(ddof=1) / math.sqrt(len(squares))
    low, high = (
        math.hypot(math.sqrt(max(squares.mean() + way * unsure, 0.0)), bank.share.rms) + bank.window
        for way in (-1, 1)
    )
    worst = math.hypot(found.max(), bank.share.worst) + bank.window
    if low > tolerance or worst > WORST_TO_RMS * tolerance:
        return True
    return high <= tolerance and worst <= CLEAR * WORST_TO_RMS * tolerance


def _both(
    sensor: Sensor, true_e: np.ndarray, render_e: np.ndarray, beyond: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (P,) relative to the signal, and in sigmas of its temporal noise.

    `beyond`: which pixels lie outside the image circle. They have no signal to speak of; theirs is
    taken as ``BLACK`` of the mean of the others, as of a black patch, where it is less.
    """
    error = np.abs(render_e - true_e)
    against = true_e
    if beyond is not None and beyond.any() and not beyond.all():
        floor = BLACK * max(float(true_e[~beyond].mean()), 0.0)
        against = np.where(beyond, np.maximum(true_e, floor), true_e)
    lit = against > 0
    relative = np.where(lit, error / np.where(lit, against, 1.0), error > 0)
    # What the full well cuts off is in no frame.
    seen_e, shown_e = (np.minimum(value, sensor.full_well_e) for value in (true_e, render_e))
    noise_e = np.sqrt(np.maximum(seen_e, 0.0) + sensor.temporal_dark_noise_e**2)
    noisy = noise_e > 0
    sigma = np.where(noisy, np.abs(shown_e - seen_e) / np.where(noisy, noise_e, 1.0), 0.0)
    return relative.astype(float), sigma


def compare(
    by: Measure,
    pixels: np.ndarray,
    truth: np.ndarray,
    rate: np.ndarray,
    *,
    seconds: float,
    bank: Share = EXACT,
    readout: Share = EXACT,
    window: float = 0.0,
    notes: tuple[str, ...] = (),
    beyond: np.ndarray | None = None,
) -> Certificate:
    """Judge a render by the exact model at some pixels.

    Parameters
    ----------
    by : Measure
    pixels : ndarray (P, 2) of int
        Row and column.
    truth, rate : ndarray (P,)
        Electrons/s of exact model and render there, both with veiling glare.
    seconds : float
        What the exact model took.
    bank, readout : Share
        The errors of the PSFs and of the sensor's part, in the tolerance's unit.
    window : float
        Light that no PSF of the bank holds, in the tolerance's unit.
    notes : tuple of str
        How these were measured.
    beyond : ndarray (P,) of bool, optional
        Which pixels lie outside the image circle.
    """
    accuracy = by.accuracy
    exact_e, shown_e = (np.asarray(one, float) * by.exposure_s for one in (truth, rate))
    relative, sigma = _both(by.sensor, exact_e, shown_e, beyond)
    points = [
        Probe(*place, float(one), float(other), float(share), float(noise))
        for place, one, other, share, noise in zip(
            pixels.tolist(), exact_e, shown_e, relative, sigma, strict=True
        )
    ]
    judged = relative if accuracy.unit == "relative" else sigma
    worst = points[int(judged.argmax())]
    rms, most = float(np.sqrt(np.mean(judged**2))), float(judged.max())
    count = len(points)
    total_rms = math.hypot(rms, bank.rms, readout.rms) + window
    total_worst = math.hypot(most, bank.worst, readout.worst) + window
    unit = "" if accuracy.unit == "relative" else " sigma of the noise"
    return Certificate(
        probes=count,
        rms_relative=float(np.sqrt(np.mean(relative**2))),
        worst_relative=float(relative.max()),
        rms_sigma=float(np.sqrt(np.mean(sigma**2))),
        worst_sigma=float(sigma.max()),
        worst_position=(worst.row, worst.col),
        unit=accuracy.unit,
        engine_rms=rms,
        engine_worst=most,
        bank_rms=bank.rms,
        bank_worst=bank.worst,
        sensor_rms=readout.rms,
        sensor_worst=readout.worst,
        window=window,
        total_rms=total_rms,
        total_worst=total_worst,
        notes=notes,
        met=total_rms <= accuracy.tolerance and total_worst <= WORST_TO_RMS * accuracy.tolerance,
        # Rule of three (Hanley & Lippman-Hand 1983): none of n above t, so fewer than 3/n at 95 %.
        confidence=f"At 95 % confidence fewer than {min(1.0, 3 / count):.1%} of such pixels err "
        f"by more than {most:.1e}{unit}.",
        seconds=seconds,
        points=tuple(points),
    )
