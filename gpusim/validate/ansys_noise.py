"""Noise of an edge's SFR: many frames of the Ansys validation against a closed form.

The edge spread function is a cubic spline B c by least squares through pixels p at their distances
from the edge, c = G p with G = (A^T A)^-1 A^T and A the basis at these distances. The response is
|F(f)| / |F(0)|, F = T(f) c the transform of the windowed derivative: linear in the pixels. By the
delta method the response's covariance is, to first order,

    C = W diag(v) W^T,   W(f) = (Re{exp(-i phi(f)) T(f)} - SFR(f) T(0)) G / F(0),

phi the phase of F and v a pixel's variance: its mean in electrons plus the read noise's square, for
each realisation has the same pixels. F is that of the predicted line spread. As white noise, that
is spread evenly over the distance, the sum says too little: where knots grow apart, and because
pixels lie at uneven distances, it is 4 % more of an edge of 1.2 px.

Each frame's line is fitted anew. That adds nothing to first order: rows lie evenly about the
middle, so that a turn by b moves as many pixels of a distance outwards as inwards, and a shift
turns the phase alone. To second order the response falls by (pi f b L)^2 / 6: a slope's standard
deviation of 4e-4 over L = 64 px takes 1e-3 of it at 1 cycle/px, with a spread as small.

Of the ratio s^2 / C summed over J frequencies the variance is 2 sum of rho^2 / (N - 1), rho their
correlations by C: as chi-square of (N - 1) J^2 / sum of rho^2 degrees of freedom (Satterthwaite
1946).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline
from scipy.stats import binom, chi2

from gpusim.metrics.sfr import (
    CORE_PX,
    CORE_RISES,
    DEGREE,
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
CORRELATED = 0.3  # of neighbours among the frequencies that are judged, at most


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
    covariance : ndarray (F, F)
        Of the SFR, by the closed form.
    reach_px : float
        Half width of the window.
    """

    number: int
    curves: np.ndarray
    clean: np.ndarray
    covariance: np.ndarray
    reach_px: float

    @cached_property
    def expected(self) -> np.ndarray:
        """Standard deviation (F,) by the closed form."""
        return np.sqrt(np.diag(self.covariance))

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

        So far apart that they are nearly independent. At 0 there is no noise, and where the
        response falls below some standard deviations its modulus is no longer linear in them.
        """
        size = self.expected
        seen = np.flatnonzero(self.clean > LEAST_RESPONSE * size)
        at = [math.ceil(1 / self.reach_px / FREQUENCIES_CY_PX[1])]
        while True:
            near = np.abs(self.covariance[at[-1]]) < CORRELATED * size[at[-1]] * size
            after = seen[(seen > at[-1]) & near[seen]]
            if not after.size:
                return np.array(at)
            at.append(int(after[0]))

    @property
    def ratios(self) -> np.ndarray:
        """Variance (J,) of the realisations at them, over the closed form's."""
        return (self.sigma[self.judged] / self.expected[self.judged]) ** 2

    @property
    def correlated(self) -> float:
        """Sum of the squares of the correlations between them."""
        own, size = self.covariance[np.ix_(self.judged, self.judged)], self.expected[self.judged]
        return float(np.sum((own / np.outer(size, size)) ** 2))

    @property
    def outside(self) -> int:
        """At how many of them `sigma` lies outside its interval."""
        low, high = (end[self.judged] for end in self.interval)
        sigma = self.sigma[self.judged]
        return int(np.sum((sigma < low) | (sigma > high)))


def bars_of(name: str, edges: list[Noise]) -> list[Bar]:
    """Return bars of edges: how many frequencies lie outside, and their variance all together.

    The second is the distance of the mean ratio from 1, over that of the end of its interval.
    """
    outside, judged = sum(one.outside for one in edges), sum(one.judged.size for one in edges)
    allowed = float(binom.ppf(CHANCE, judged, 1 - CONFIDENCE))
    ratio, (low, high) = pooled(edges)
    off = math.log(ratio) / math.log(high if ratio > 1 else low)
    return [
        Bar(
            f"sigma of SFR outside its 95 % interval, {name}",
            outside,
            allowed,
            "frequencies",
            judged,
        ),
        Bar(f"sigma of SFR, all frequencies, {name}", off, 1.0, "of its 95 % interval", judged),
    ]


def pooled(edges: list[Noise]) -> tuple[float, tuple[float, float]]:
    """Return the mean variance of edges over the closed form's, and the interval that holds it.

    The interval is that of 95 %, where the closed form is right.
    """
    ratios = np.concatenate([one.ratios for one in edges])
    free = len(edges[0].curves) - 1
    free = free * ratios.size**2 / sum(one.correlated for one in edges)
    low, high = chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], free) / free
    return float(ratios.mean()), (float(low), float(high))


def knots_of(reach_px: float, rise_px: float) -> np.ndarray:
    """Return where the spline's knots lie: close about the edge, farther apart beside it."""
    at = [0.0]
    while at[-1] < reach_px:
        away = GROWTH * (at[-1] - CORE_RISES * rise_px - CORE_PX)
        at.append(at[-1] + float(np.clip(away, KNOT_PX, WIDEST_PX)))
    side = np.array(at) * reach_px / at[-1]
    return np.concatenate([-side[:0:-1], side])


def sfr_covariance(
    pixels_px: np.ndarray,
    variance: np.ndarray,
    *,
    step_e: float,
    distance_px: np.ndarray,
    lsf: np.ndarray,
    rise_px: float,
) -> np.ndarray:
    """Return the covariance (F, F) of an SFR by the closed form of the head.

    Parameters
    ----------
    pixels_px, variance : ndarray (N,)
        Distance of each pixel from the edge, and variance of its electrons.
    step_e : float
        Electrons of the bright side less those of the dark one.
    distance_px, lsf : ndarray (D,)
        Predicted line spread over the window, evenly spaced.
    rise_px : float
        From 10 to 90 %: knots are close that far about the edge.
    """
    d, f, reach = distance_px, FREQUENCIES_CY_PX, float(distance_px[-1])
    over = np.clip((np.abs(d) / reach - FLAT_SHARE) / (1 - FLAT_SHARE), 0, 1)
    window = 0.5 + 0.5 * np.cos(np.pi * over)
    waves = np.exp(-2j * np.pi * np.outer(f, d)) * window * (d[1] - d[0])
    response = step_e * (waves @ lsf)
    knots = knots_of(reach, rise_px)
    ends = [np.full(DEGREE, way * reach) for way in (-1, 1)]
    knots = np.concatenate([ends[0], knots, ends[1]])
    basis = BSpline(knots, np.eye(knots.size - DEGREE - 1), DEGREE)
    seen = np.abs(pixels_px) <= reach
    own = np.linalg.pinv(basis(pixels_px[seen]))
    moved = waves @ basis.derivative()(d) @ own  # (F, N)
    size = np.abs(response)
    ways = (np.conj(response / size)[:, None] * moved).real / size[0]
    weight = ways - (size / size[0])[:, None] * ways[0]
    return (weight * variance[seen]) @ weight.T
