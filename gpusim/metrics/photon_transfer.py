"""The photon transfer of a channel: mean and temporal variance against the light.

EMVA Standard 1288, release 3.1, sections 6.5 and 6.6.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.statistics import Level

FIT_SHARE = 0.7  # of saturation, up to which lines are fitted (section 6.6)
LEAST_LEVELS = 50  # of light that the standard asks for (section 6.5)
DRAWS = 2000  # of the photon transfer curve, for the spread of its maximum
DISORDER_SIGMAS = 6.0  # a fall of the mean that is no chance among thousands of levels


@dataclass(frozen=True)
class Transfer:
    """Mean and temporal variance of a channel against the light.

    Attributes
    ----------
    exposure_s, photons, mean, mean_u2, variance, variance_u2 : ndarray (n,)
        s, per pixel, DN, DN^2; in the order of the photons. Equations (28) and (29).
    dark_mean, dark_mean_u2, dark_variance, dark_variance_u2 : ndarray (n,)
        In the dark, at the exposure time of each.
    """

    exposure_s: np.ndarray
    photons: np.ndarray
    mean: np.ndarray
    mean_u2: np.ndarray
    variance: np.ndarray
    variance_u2: np.ndarray
    dark_mean: np.ndarray
    dark_mean_u2: np.ndarray
    dark_variance: np.ndarray
    dark_variance_u2: np.ndarray

    @property
    def signal(self) -> np.ndarray:
        """Mean less that in the dark, DN."""
        return self.mean - self.dark_mean

    @property
    def saturation(self) -> int:
        """Index of the highest temporal variance (section 6.6)."""
        return int(np.argmax(self.variance))

    def between(self, low: float, high: float) -> np.ndarray:
        """Return which levels lie between two shares of the signal at saturation."""
        full = self.signal[self.saturation]
        before = np.arange(self.photons.size) <= self.saturation
        return before & (self.signal >= low * full) & (self.signal <= high * full)

    def slope(
        self, of: np.ndarray, against: np.ndarray, u2: np.ndarray, dark_u2: np.ndarray
    ) -> tuple[float, float]:
        """Return the slope of a line through the origin up to FIT_SHARE, and its uncertainty.

        Parameters
        ----------
        of, against : ndarray (n,)
            Ordinate and abscissa.
        u2, dark_u2 : ndarray (n,)
            Squared uncertainty of the ordinate, and that of the dark value in it, which levels of
            one exposure time have in common.
        """
        fitted = self.between(-np.inf, FIT_SHARE)
        x = against[fitted]
        shared = sum(
            x[self.exposure_s[fitted] == time].sum() ** 2
            * dark_u2[fitted][self.exposure_s[fitted] == time][0]
            for time in np.unique(self.exposure_s[fitted])
        )
        square = x @ x
        spread = math.sqrt(x**2 @ u2[fitted] + shared) / square
        return float(x @ of[fitted] / square), float(spread)

    @property
    def saturation_u(self) -> float:
        """Standard uncertainty of where the variance is highest, photons.

        Two parts: the spread of the maximum over curves with the noise that this one has, and that
        of a place between levels.
        """
        full = self.saturation
        draws = np.random.default_rng(1288).standard_normal((DRAWS, self.photons.size))
        curves = self.variance + np.sqrt(self.variance_u2) * draws
        spread = float(self.photons[curves.argmax(axis=1)].std())
        step = (self.photons[full + 1] - self.photons[full - 1]) / 2
        return math.hypot(spread, step / math.sqrt(12))


def transfer_of(lit: Sequence[Level], dark: Sequence[Level], sites: Sequence[int]) -> Transfer:
    """Return mean and variance of some sites against the light.

    Parameters
    ----------
    lit, dark : sequence of Level
    sites : sequence of int
        Sites of the filter pattern that belong to one channel.

    Raises
    ------
    UserError
        No dark level at the exposure time of a lit one.
    """
    rows = []
    for level in lit:
        black = next(
            (one for one in dark if math.isclose(one.exposure_s, level.exposure_s, rel_tol=1e-6)),
            None,
        )
        if black is None:
            times = ", ".join(f"{one.exposure_s:g}" for one in dark)
            raise UserError(
                "there are lit frames at an exposure time without dark frames",
                field="exposure_s",
                value=level.exposure_s,
                allowed=f"that of dark frames: {times}",
            )
        found = (*level.mean_and_variance(sites), *black.mean_and_variance(sites))
        rows.append([black.exposure_s, level.photons, *found])
    return Transfer(*np.array(rows).T)


def refuse_disorder(transfer: Transfer, where: str) -> None:
    """Refuse levels from which nothing can be measured, with the reason.

    Parameters
    ----------
    transfer : Transfer
    where : str
        What the error calls them: " of channel R", or nothing.

    Raises
    ------
    UserError
        A mean that falls, a variance that only rises or only falls, or too few levels for a line.
    """
    fall = transfer.mean[:-1] - transfer.mean[1:]
    chance = DISORDER_SIGMAS * np.sqrt(transfer.mean_u2[:-1] + transfer.mean_u2[1:])
    worse = np.flatnonzero(fall > chance)
    if worse.size and np.unique(transfer.exposure_s).size == 1:
        at = worse[0]
        raise UserError(
            f"the levels{where} are out of order: {transfer.photons[at + 1]:g} photons give "
            f"{transfer.mean[at + 1]:.2f} DN, less than {transfer.photons[at]:g} photons do",
            field="photons",
            value=f"{transfer.mean[at]:.2f} DN at {transfer.photons[at]:g}",
            allowed="a mean signal that rises with the number of photons",
        )
    full = transfer.saturation
    if full == 0 or transfer.variance[full] <= 0:
        raise UserError(
            f"every lit level{where} is saturated: the temporal variance is highest at the first",
            field="photons",
            value=f"{transfer.photons[0]:g} and more",
            allowed=f"{LEAST_LEVELS} levels from dark to saturation",
        )
    if full == transfer.photons.size - 1:
        raise UserError(
            f"the levels{where} do not reach saturation: the temporal variance still rises at the "
            "last",
            field="photons",
            value=f"{transfer.photons[-1]:g} at most",
            allowed=f"{LEAST_LEVELS} levels from dark to beyond saturation",
        )
    count = int(np.count_nonzero(transfer.between(-np.inf, FIT_SHARE)))
    if count < 2:
        raise UserError(
            f"too few levels{where} below {FIT_SHARE:.0%} of saturation for a line",
            field="photons",
            value=count,
            allowed=f"2 or more; the standard asks for {LEAST_LEVELS} levels",
        )
