"""Noise of an edge's SFR: many frames of the Ansys validation against a closed form.

The response is F(f) / F(0), F the transform of the windowed derivative of the edge
spread function. With n pixels a px along the edge, each with variance v at the distance d, and E
the step, it has, to first order, the variance

    s^2(f) = 1 / (n E^2) integral of v(d) (sqrt(P) Re{exp(-i phi - 2 pi i f d) (2 pi i f w - w')}
                                           + SFR(f) w')^2 dd,

w the window, phi the phase of F, and P the share of a wave that least-squares cubic splines on
knots h apart keep of noise, sinc^8(f h) / sum over k of sinc^8(f h + k) (de Boor 1978, XIV, by
Poisson's sum); beside the edge knots lie far apart. v is the mean in electrons plus the read
noise's square: each realisation has the same pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import binom, chi2

from gpusim.metrics.sfr import (
    CORE_PX,
    CORE_RISES,
    FLAT_SHARE,
    FREQUENCIES_CY_PX,
    GROWTH,
    KNOT_PX,
    WIDEST_PX,
)
from gpusim.validate.bars import Bar

CONFIDENCE = 0.95  # of the interval about the closed form
CHANCE = 0.99  # that no more frequencies than the bar's lie outside where the closed form is right
LEAST_RESPONSE = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Noise:
    """An edge in many realisations.

    Attributes
    ----------
    number : int
        The region's, in the paper.
    curves : ndarray (N, F)
        SFR of each realisation.
    clean : ndarray (F,)
        SFR without noise.
    expected : ndarray (F,)
        Standard deviation by the closed form.
    reach_px : float
        Half width of the window.
    """

    number: int
    curves: np.ndarray
    clean: np.ndarray
    expected: np.ndarray
    reach_px: float

    @cached_property
    def sigma(self) -> np.ndarray:
        """Standard deviation (F,) of the realisations."""
        return self.curves.std(axis=0, ddof=1)

    @property
    def interval(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (F,) of the interval that holds `sigma` where the closed form is right."""
        free = len(self.curves) - 1
        ends = chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], free)
        low, high = np.sqrt(ends / free)
        return low * self.expected, high * self.expected

    @property
    def judged(self) -> np.ndarray:
        """Indices (J,) of frequencies at which the interval is held against `sigma`.

        One reciprocal of the window's half width apart they are independent. At 0 there is no
        noise, and where the response falls below some standard deviations its modulus is no longer
        linear in them.
        """
        step = math.ceil(1 / self.reach_px / FREQUENCIES_CY_PX[1])
        at = np.arange(step, FREQUENCIES_CY_PX.size, step)
        return at[self.clean[at] > LEAST_RESPONSE * self.expected[at]]

    @property
    def outside(self) -> int:
        """At how many of them `sigma` lies outside its interval."""
        low, high = (end[self.judged] for end in self.interval)
        sigma = self.sigma[self.judged]
        return int(np.sum((sigma < low) | (sigma > high)))


def bar_of(name: str, edges: list[Noise]) -> Bar:
    """Return the bar of how many frequencies of some edges lie outside their intervals."""
    outside, judged = sum(one.outside for one in edges), sum(one.judged.size for one in edges)
    allowed = float(binom.ppf(CHANCE, judged, 1 - CONFIDENCE))
    return Bar(name, outside, allowed, "frequencies", judged)


def kept(frequency: np.ndarray, knots_px: np.ndarray) -> np.ndarray:
    """Return the share (F, D) of white noise that cubic splines keep by frequency and spacing."""
    at = np.multiply.outer(frequency, knots_px)
    around = np.sum([np.sinc(at + k) ** 8 for k in range(-4, 5)], axis=0)  # the next: 1e-5
    return np.sinc(at) ** 8 / around


def sfr_deviation(
    distance_px: np.ndarray,
    lsf: np.ndarray,
    *,
    dark_e: float,
    bright_e: float,
    read_noise_e: float,
    pixels_per_px: float,
    rise_px: float,
) -> np.ndarray:
    """Return the standard deviation (F,) of an SFR by the closed form of the head.

    Parameters
    ----------
    distance_px, lsf : ndarray (D,)
        Predicted line spread over the window, evenly spaced.
    dark_e, bright_e : float
        Mean electrons on both sides.
    read_noise_e : float
    pixels_per_px : float
        Pixels for each px of distance.
    rise_px : float
        From 10 to 90 %: knots are close that far about the edge.
    """
    d, f = distance_px, FREQUENCIES_CY_PX[:, None]
    step = d[1] - d[0]
    over = np.clip((np.abs(d) / d[-1] - FLAT_SHARE) / (1 - FLAT_SHARE), 0, 1)
    window = 0.5 + 0.5 * np.cos(np.pi * over)
    falling = np.gradient(window, d)
    rising = np.cumsum(lsf) * step
    variance = dark_e + (bright_e - dark_e) * rising / rising[-1] + read_noise_e**2
    response = (lsf * window * np.exp(-2j * np.pi * f * d)).sum(axis=1) * step
    sfr = np.abs(response) / np.abs(response[0])
    knots = np.clip(GROWTH * (np.abs(d) - CORE_RISES * rise_px - CORE_PX), KNOT_PX, WIDEST_PX)
    turned = np.exp(-1j * np.angle(response))[:, None] * np.exp(-2j * np.pi * f * d)
    own = ((2j * np.pi * f * window - falling) * turned).real
    weight = np.sqrt(kept(FREQUENCIES_CY_PX, knots)) * own + sfr[:, None] * falling
    summed = (variance * weight**2).sum(axis=1) * step
    return np.sqrt(summed / pixels_per_px) / (bright_e - dark_e)
