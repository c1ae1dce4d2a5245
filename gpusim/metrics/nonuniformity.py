"""The fixed pattern of averaged frames: EMVA Standard 1288, release 3.1, section 8."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.metrics.figure import Figure, root_in
from gpusim.metrics.photon_transfer import Transfer
from gpusim.metrics.statistics import Level, Parts, pooled

CLEAR_SIGMAS = 10.0  # by which a PRNU stands out, so that its pixels' noise can be compared


@dataclass(frozen=True)
class Pattern:
    """The fixed pattern of averaged frames.

    Attributes
    ----------
    frames : int
    photons, exposure_s, mean : float
    spatial : Parts
        Corrected for what temporal noise the average holds, DN^2.
    residual_dn2 : float
        That temporal noise, DN^2.
    covariance, covariance_u2 : float
        Covariance of the pixels' mean and temporal variance, DN^3, and its squared standard
        uncertainty.
    images : tuple of ndarray
        The average of each site, DN.
    """

    frames: int
    photons: float
    exposure_s: float
    mean: float
    spatial: Parts
    residual_dn2: float
    covariance: float
    covariance_u2: float
    images: tuple[np.ndarray, ...]


def pattern_of(level: Level, sites: Sequence[int]) -> Pattern:
    """Return the fixed pattern of some sites: section 8.1."""
    taken = [level.sites[number] for number in sites]
    return Pattern(
        frames=taken[0].frames,
        photons=level.photons,
        exposure_s=level.exposure_s,
        mean=float(np.mean([site.mean for site in taken])),
        spatial=pooled([site.spatial for site in taken]),
        residual_dn2=pooled([site.temporal for site in taken]).total / taken[0].frames,
        covariance=float(np.mean([site.covariance for site in taken])),
        covariance_u2=sum(site.covariance_u2 for site in taken) / len(taken) ** 2,
        images=tuple(site.average for site in taken),
    )


def dark_pattern(dark: Sequence[Level], sites: Sequence[int], exposure_s: float) -> Pattern | None:
    """Return the fixed pattern nearest to an exposure time, of the dark levels with a stack."""
    stacks = [one for one in dark if one.sites[0].frames > 2]
    if not stacks:
        return None
    return pattern_of(min(stacks, key=lambda one: abs(one.exposure_s - exposure_s)), sites)


def half_saturated(
    lit: Sequence[Level], wavelength: float | None, transfer: Transfer, sites: Sequence[int]
) -> Pattern | None:
    """Return the fixed pattern nearest to half of saturation, of a level between 40 and 60 %."""
    half = transfer.photons[transfer.saturation] / 2
    stacks = [
        one
        for one in lit
        if one.wavelength_nm == wavelength
        and one.sites[0].frames > 2
        and abs(one.photons - half) <= 0.2 * half
    ]
    if not stacks:
        return None
    return pattern_of(min(stacks, key=lambda one: abs(one.photons - half)), sites)


def by_part(
    name: str, suffix: str, spatial: Parts, unit: Figure, factor: float
) -> dict[str, Figure]:
    """Return a non-uniformity and its pixel, row and column parts: see `root_in`."""
    found = {}
    for part in ("total", "pixel", "row", "column"):
        key = f"{name}_{suffix}" if part == "total" else f"{name}_{part}_{suffix}"
        square_u = math.sqrt(getattr(spatial, f"{part}_u2"))
        found[key] = root_in(getattr(spatial, part), square_u, unit, factor)
    return found


def response_nonuniformity(
    bright: Pattern, dark: Pattern, gain: Figure
) -> tuple[dict[str, Figure], float]:
    """Return the non-uniformity of the response, and what it means for the responsivity.

    Parameters
    ----------
    bright, dark : Pattern
        Patterns of the photosites of a channel.
    gain : Figure
        K, DN per electron.

    Returns
    -------
    figures : dict of str to Figure
        ``prnu_percent`` and its parts; ``response_gain_dn_per_e`` where the PRNU is clear.
    mean_u2 : float
        Relative variance of the mean response between arrays of the type.
    """
    signal = bright.mean - dark.mean
    spatial = bright.spatial.minus(dark.spatial)
    figures = by_part("prnu", "percent", spatial, Figure(signal, 0.0), 100.0)
    if spatial.total > CLEAR_SIGMAS * math.sqrt(spatial.total_u2):
        figures["response_gain_dn_per_e"] = _response_gain(bright, dark, spatial, gain)
    rows, cols = bright.images[0].shape
    # The array is a sample of the type: the mean of its responses has a spread.
    mean_u2 = (
        max(spatial.pixel, 0.0) / (rows * cols * len(bright.images))
        + max(spatial.row, 0.0) / rows
        + max(spatial.column, 0.0) / cols
    ) / signal**2
    return figures, mean_u2


def _response_gain(bright: Pattern, dark: Pattern, of_response: Parts, gain: Figure) -> Figure:
    """Return the slope of the pixels' temporal variance against their means, DN per electron.

    Where responses differ before the shot noise, a pixel with more signal has more of it as any
    other signal has: the slope is K. Where the signal is multiplied afterwards, it is 2 K. What of
    the covariance comes from the noise of the means is subtracted: the third central moment of
    Poisson's law, which is K times the variance, over the number of frames.
    """
    shot = bright.residual_dn2 - dark.residual_dn2 * dark.frames / bright.frames
    slope = (bright.covariance - gain.value * shot) / of_response.total
    spread = math.hypot(math.sqrt(bright.covariance_u2), slope * math.sqrt(of_response.total_u2))
    return Figure(slope, spread / of_response.total)


def spectrogram(images: Sequence[np.ndarray], residual_dn2: float, axis: int) -> np.ndarray:
    """Return the power of the fixed pattern by spatial frequency: equations (49) and (50).

    Parameters
    ----------
    images : sequence of ndarray (rows, cols)
        Averages of equally many frames, DN.
    residual_dn2 : float
        Temporal variance that the averages hold.
    axis : int
        1 along rows (the horizontal spectrogram), 0 along columns.

    Returns
    -------
    ndarray (n // 2 + 1,)
        DN^2, at 0 to 1/2 cycles per pixel of the images: mean square amplitude of the lines, such
        that white noise has its variance at every frequency; less the temporal part.
    """
    powers = []
    for image in images:
        amplitudes = np.fft.rfft(image - image.mean(), axis=axis)
        powers.append(np.mean(np.abs(amplitudes) ** 2, axis=1 - axis) / image.shape[axis])
    return np.mean(powers, axis=0) - residual_dn2
