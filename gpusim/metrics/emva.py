"""The EMVA 1288 measurement: from levels of light and their frames to a data sheet.

EMVA Standard 1288, release 3.1 (European Machine Vision Association, 2016), whose sections and
equations are quoted; release 4.0 Linear for the row, column and pixel parts of the non-uniformity.
Each channel of a colour sensor is measured for itself, at the wavelength to which it responds most.

Uncertainties are standard ones (k = 1) and statistical: the spread of the same measurement on other
frames, and on other pieces of the same type as far as the pixels of an array are a sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.dark import (
    LEAST_DARK_VARIANCE_DN2,
    QUANTISATION_DN2,
    DarkSeries,
    dark_lines,
    dark_series,
)
from gpusim.metrics.figure import Figure, root_in, weighted
from gpusim.metrics.linearity import Linearity, linearity_errors, linearity_of
from gpusim.metrics.nonuniformity import (
    Pattern,
    by_part,
    dark_pattern,
    half_saturated,
    response_nonuniformity,
)
from gpusim.metrics.outliers import Outlier, without_outliers
from gpusim.metrics.photon_transfer import LEAST_LEVELS, Transfer, refuse_disorder, transfer_of
from gpusim.metrics.statistics import Level, pooled

UNDERFLOW_SHARE = 0.005  # of dark pixels that may be 0 DN (section 6.5)


@dataclass(frozen=True)
class Channel:
    """What was found of the photosites of one channel.

    Attributes
    ----------
    name : str
    wavelength_nm : float or None
    pixels : int
    transfer : Transfer
    linearity : Linearity
    bright : Pattern or None
    outliers : tuple of Outlier
        Levels that contradict the others; no figure counts them.
    figures : dict of str to Figure
        ``responsivity_dn_per_photon``, ``system_gain_dn_per_e``, ``quantum_efficiency``,
        ``saturation_photons``, ``saturation_e``, ``sensitivity_threshold_photons``,
        ``sensitivity_threshold_e``, ``snr_max``, ``dynamic_range``,
        ``linearity_error_min_percent``, ``linearity_error_max_percent``, ``prnu_percent`` and its
        parts ``prnu_pixel_percent``, ``prnu_row_percent`` and ``prnu_column_percent``;
        ``response_gain_dn_per_e``.
    """

    name: str
    wavelength_nm: float | None
    pixels: int
    transfer: Transfer
    linearity: Linearity
    bright: Pattern | None
    outliers: tuple[Outlier, ...]
    figures: Mapping[str, Figure]


@dataclass(frozen=True)
class Characterisation:
    """The whole measurement.

    Attributes
    ----------
    channels : tuple of Channel
    series : DarkSeries
    dark : Pattern or None
        Pattern of all photosites.
    figures : dict of str to Figure
        Figures of all photosites: ``system_gain_dn_per_e`` and ``response_gain_dn_per_e``;
        ``temporal_dark_noise_dn``, ``temporal_dark_noise_e`` and the parts of it that whole rows
        and columns share, ``row_noise_e`` and ``column_noise_e``; ``dark_current_e_per_s`` and
        ``dark_current_variance_e_per_s``; ``dsnu_e`` and its parts ``dsnu_pixel_e``,
        ``dsnu_row_e`` and ``dsnu_column_e``.
    notes : tuple of str
        What the data leave open, and where they are less than the standard asks for.
    """

    channels: tuple[Channel, ...]
    series: DarkSeries
    dark: Pattern | None
    figures: Mapping[str, Figure]
    notes: tuple[str, ...]


def characterise(levels: Sequence[Level], pattern: Sequence[str]) -> Characterisation:
    """Work out the data sheet.

    Parameters
    ----------
    levels : sequence of Level
        Lit ones; dark ones at the exposure times of the lit ones, and at others for the dark
        current. Levels of more than two frames give the non-uniformities.
    pattern : sequence of str
        Channel of each site of the filter pattern, row by row.

    Raises
    ------
    UserError
        No dark frames, or none at an exposure time of lit ones; too few levels of light; a mean
        that does not rise with the light; a variance that only rises, or only falls.
    """
    dark = sorted((one for one in levels if one.photons == 0), key=lambda one: one.exposure_s)
    lit = sorted((one for one in levels if one.photons > 0), key=lambda one: one.photons)
    for found, kind, allowed in (
        (dark, "dark", "two frames or more with 0 photons"),
        (lit, "lit", "frames with more than 0 photons"),
    ):
        if not found:
            raise UserError(f"there are no {kind} frames", field="photons", allowed=allowed)
    notes: list[str] = []
    series = dark_series(dark)
    variance, current_dn, current_dn2 = dark_lines(series, notes)
    fixed = dark_pattern(dark, range(len(pattern)), lit[0].exposure_s)
    if fixed is None:
        notes.append("no dark level has more than two frames: DSNU and PRNU are not measured")
    channels = tuple(
        _channel(name, pattern, lit, dark, dark_variance=variance, notes=notes)
        for name in dict.fromkeys(pattern)
    )
    gain = weighted([one.figures["system_gain_dn_per_e"] for one in channels])
    figures = {"system_gain_dn_per_e": gain}
    if all("response_gain_dn_per_e" in one.figures for one in channels):
        unlike = [one.figures["response_gain_dn_per_e"] for one in channels]
        figures["response_gain_dn_per_e"] = weighted(unlike)
    figures |= _dark_noise(variance, gain, notes)
    if current_dn is not None:
        figures["dark_current_e_per_s"] = current_dn.over(gain)
        figures["dark_current_variance_e_per_s"] = current_dn2.over(gain, power=2)
    most = max(dark, key=lambda one: one.sites[0].frames)
    temporal = pooled([site.temporal for site in most.sites])
    for part in ("row", "column"):
        figures[f"{part}_noise_e"] = root_in(
            getattr(temporal, part), math.sqrt(getattr(temporal, f"{part}_u2")), gain, 1.0
        )
    if fixed is not None:
        figures |= by_part("dsnu", "e", fixed.spatial, gain, 1.0)
    underflow = max(site.zero_share for one in dark for site in one.sites)
    if underflow > UNDERFLOW_SHARE:
        notes.append(
            f"{underflow:.1%} of the dark pixels are 0 DN, the standard allows "
            f"{UNDERFLOW_SHARE:.1%}: the black level is too low, and what is below it is lost"
        )
    return Characterisation(channels, series, fixed, figures, tuple(dict.fromkeys(notes)))


def _dark_noise(variance: Figure, gain: Figure, notes: list[str]) -> dict[str, Figure]:
    """Return the temporal dark noise of its variance, DN^2."""
    if variance.value < LEAST_DARK_VARIANCE_DN2:
        notes.append(
            f"the temporal dark noise is lost in the converter's steps; the standard takes "
            f"{math.sqrt(LEAST_DARK_VARIANCE_DN2):.2g} DN in its place, which is an upper limit"
        )
        variance = Figure(LEAST_DARK_VARIANCE_DN2, variance.u)
    without_steps = variance.value - QUANTISATION_DN2  # equation (31)
    return {
        "temporal_dark_noise_dn": Figure.root(variance.value, variance.u),
        "temporal_dark_noise_e": root_in(without_steps, variance.u, gain, 1.0),
    }


def _channel(
    name: str,
    pattern: Sequence[str],
    lit: Sequence[Level],
    dark: Sequence[Level],
    *,
    dark_variance: Figure,
    notes: list[str],
) -> Channel:
    """Measure one channel: sections 6.6, 6.7 and 8."""
    sites = [number for number, one in enumerate(pattern) if one == name]
    curves = {
        nm: transfer_of([one for one in lit if one.wavelength_nm == nm], dark, sites)
        for nm in dict.fromkeys(one.wavelength_nm for one in lit)
    }
    wavelength = max(
        curves,
        key=lambda one: curves[one].signal @ curves[one].photons / np.sum(curves[one].photons ** 2),
    )
    transfer = curves[wavelength]
    where = "" if len(pattern) == 1 else f" of channel {name}"
    refuse_disorder(transfer, where)
    transfer, outliers = without_outliers(transfer)
    notes += [f"{one}{where}" for one in outliers]
    if transfer.photons.size < LEAST_LEVELS:
        notes.append(
            f"{transfer.photons.size} levels of light, the standard asks for {LEAST_LEVELS}"
        )
    gain = Figure(
        *transfer.slope(
            transfer.variance - transfer.dark_variance,
            transfer.signal,
            transfer.variance_u2,
            transfer.dark_variance_u2,
        )
    )
    slope, spread = transfer.slope(
        transfer.signal, transfer.photons, transfer.mean_u2, transfer.dark_mean_u2
    )
    figures: dict[str, Figure] = {"system_gain_dn_per_e": gain}
    bright = half_saturated(lit, wavelength, transfer, sites)
    prnu_u2 = 0.0
    if bright is None:
        notes.append("no level near half of saturation has more than two frames: no PRNU")
    elif (below := dark_pattern(dark, sites, bright.exposure_s)) is not None:
        of_response, prnu_u2 = response_nonuniformity(bright, below, gain)
        figures |= of_response
    responsivity = Figure(slope, math.hypot(spread, slope * math.sqrt(prnu_u2)))
    figures |= _light_figures(transfer, gain, responsivity, dark_variance)
    straight = linearity_of(transfer)
    least_error, largest_error = linearity_errors(straight, transfer)
    figures |= {
        "linearity_error_min_percent": least_error,
        "linearity_error_max_percent": largest_error,
    }
    pixels = math.prod(dark[0].sites[sites[0]].shape) * len(sites)
    return Channel(name, wavelength, pixels, transfer, straight, bright, outliers, figures)


def _light_figures(
    transfer: Transfer, gain: Figure, responsivity: Figure, dark_variance: Figure
) -> dict[str, Figure]:
    """Return efficiency, saturation, the threshold by equation (17), and what follows of them."""
    efficiency = responsivity.over(gain)
    photons = Figure(float(transfer.photons[transfer.saturation]), transfer.saturation_u)
    capacity = Figure(
        efficiency.value * photons.value,
        math.hypot(efficiency.u * photons.value, efficiency.value * photons.u),
    )
    noise = Figure.root(max(dark_variance.value, LEAST_DARK_VARIANCE_DN2), dark_variance.u)
    least_e = noise.over(gain)
    least_e = Figure(least_e.value + 0.5, least_e.u)
    least = least_e.over(efficiency)
    return {
        "responsivity_dn_per_photon": responsivity,
        "quantum_efficiency": efficiency,
        "saturation_photons": photons,
        "saturation_e": capacity,
        "sensitivity_threshold_photons": least,
        "sensitivity_threshold_e": least_e,
        "snr_max": Figure(math.sqrt(capacity.value), capacity.u / 2 / math.sqrt(capacity.value)),
        "dynamic_range": photons.over(least),
    }
