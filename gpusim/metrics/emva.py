"""The EMVA 1288 measurement: from levels of light and their frames to a data sheet.

EMVA Standard 1288, release 3.1 (European Machine Vision Association, 2016), whose sections and
equations are quoted; release 4.0 Linear for the row, column and pixel parts of the non-uniformity.
Of a colour sensor each channel is measured for itself, at the wavelength to which it responds most.

Uncertainties are standard ones (k = 1) and statistical: the spread of the same measurement on other
frames, and on other pieces of the same type as far as the pixels of an array are a sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.statistics import Parts, SiteStatistics, pooled

QUANTISATION_DN2 = 1 / 12  # section 2.2: variance of rounding to whole numbers
# Below it the temporal dark noise is lost in the quantisation, and the standard takes this value in
# its place (release 3.1, section 6.6: sigma_y.dark < 0.49 DN).
LEAST_DARK_VARIANCE_DN2 = 0.24
FIT_SHARE = 0.7  # of saturation, up to which lines are fitted (section 6.6)
LINEARITY_SHARES = (0.05, 0.95)  # of saturation, between which linearity is judged (section 6.7)
LEAST_LEVELS = 50  # of light that the standard asks for (section 6.5)
LEAST_TIMES = 6  # of exposure for the dark current (section 7.1)
UNDERFLOW_SHARE = 0.005  # of dark pixels that may be 0 DN (section 6.5)
DRAWS = 2000  # of the photon transfer curve, for the spread of its maximum
CLEAR_SIGMAS = 10.0  # by which a PRNU stands out, so that its pixels' noise can be compared
DISORDER_SIGMAS = 6.0  # a fall of the mean that is no chance among thousands of levels


@dataclass(frozen=True)
class Level:
    """What one light and exposure time gave.

    Attributes
    ----------
    exposure_s : float
    photons : float
        Mean number per pixel during the exposure; 0 in the dark.
    wavelength_nm : float or None
        Of the light; None in the dark, or where it is not known.
    sites : tuple of SiteStatistics
        Of each site of the filter pattern, row by row.
    """

    exposure_s: float
    photons: float
    wavelength_nm: float | None
    sites: tuple[SiteStatistics, ...]


@dataclass(frozen=True)
class Figure:
    """A figure of the data sheet with its standard uncertainty.

    Attributes
    ----------
    value : float
    u : float
        Standard uncertainty.
    square, square_u : float or None
        Of a figure that is the root of a variance, that variance, which may have come out negative
        where there is nothing to be found, and its uncertainty: these are normal, the root is not.
    """

    value: float
    u: float
    square: float | None = None
    square_u: float | None = None

    @classmethod
    def root(cls, square: float, square_u: float) -> Figure:
        """Return the root of a variance, 0 of a negative one."""
        value = math.sqrt(max(square, 0.0))
        return cls(value, math.sqrt(max(square, 0.0) + square_u) - value, square, square_u)


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


@dataclass(frozen=True)
class Linearity:
    """The straight line through the signal, and how far it is missed.

    Attributes
    ----------
    offset_dn, slope_dn : float
        Of the line with the least relative deviations (section 6.7, equations (35) to (37)).
    fitted : ndarray of bool (n,)
    deviation_percent : ndarray (n,)
        Equation (38).
    """

    offset_dn: float
    slope_dn: float
    fitted: np.ndarray
    deviation_percent: np.ndarray


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
        Of the pixels' mean and temporal variance, DN^3, and its squared standard uncertainty.
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
    figures: Mapping[str, Figure]


@dataclass(frozen=True)
class DarkSeries:
    """Dark frames against exposure time.

    Attributes
    ----------
    exposure_s, mean, mean_u2, variance, variance_u2 : ndarray (n,)
        s; DN, DN^2, of all photosites.
    """

    exposure_s: np.ndarray
    mean: np.ndarray
    mean_u2: np.ndarray
    variance: np.ndarray
    variance_u2: np.ndarray


@dataclass(frozen=True)
class Characterisation:
    """The whole measurement.

    Attributes
    ----------
    channels : tuple of Channel
    series : DarkSeries
    dark : Pattern or None
        Of all photosites.
    figures : dict of str to Figure
        Of all photosites: ``system_gain_dn_per_e`` and ``response_gain_dn_per_e``;
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
    series = _dark_series(dark)
    variance, current_dn, current_dn2 = _dark_lines(series, notes)
    stacks = [one for one in dark if one.sites[0].frames > 2]
    if not stacks:
        notes.append("no dark level has more than two frames: DSNU and PRNU are not measured")
    channels = tuple(
        _channel(name, pattern, lit, dark, variance, notes) for name in dict.fromkeys(pattern)
    )
    gain = _weighted([one.figures["system_gain_dn_per_e"] for one in channels])
    figures = {"system_gain_dn_per_e": gain}
    if all("response_gain_dn_per_e" in one.figures for one in channels):
        unlike = [one.figures["response_gain_dn_per_e"] for one in channels]
        figures["response_gain_dn_per_e"] = _weighted(unlike)
    if variance.value < LEAST_DARK_VARIANCE_DN2:
        notes.append(
            f"the temporal dark noise is lost in the converter's steps; the standard takes "
            f"{math.sqrt(LEAST_DARK_VARIANCE_DN2):.2g} DN in its place, which is an upper limit"
        )
        variance = Figure(LEAST_DARK_VARIANCE_DN2, variance.u)
    figures["temporal_dark_noise_dn"] = Figure.root(variance.value, variance.u)
    without_steps = variance.value - QUANTISATION_DN2  # equation (31)
    figures["temporal_dark_noise_e"] = _root(without_steps, variance.u, gain, 1.0)
    if current_dn is not None:
        figures["dark_current_e_per_s"] = _over(current_dn, gain)
        figures["dark_current_variance_e_per_s"] = _over(current_dn2, gain, power=2)
    most = max(dark, key=lambda one: one.sites[0].frames)
    temporal = pooled([site.temporal for site in most.sites])
    for part in ("row", "column"):
        figures[f"{part}_noise_e"] = _root(
            getattr(temporal, part), math.sqrt(getattr(temporal, f"{part}_u2")), gain, 1.0
        )
    pattern_dark = None
    if stacks:
        wanted = lit[0].exposure_s
        stack = min(stacks, key=lambda one: abs(one.exposure_s - wanted))
        pattern_dark = _pattern(stack, range(len(pattern)))
        figures |= _by_part("dsnu", "e", pattern_dark.spatial, gain, 1.0)
    underflow = max(site.zero_share for one in dark for site in one.sites)
    if underflow > UNDERFLOW_SHARE:
        notes.append(
            f"{underflow:.1%} of the dark pixels are 0 DN, the standard allows "
            f"{UNDERFLOW_SHARE:.1%}: the black level is too low, and what is below it is lost"
        )
    return Characterisation(channels, series, pattern_dark, figures, tuple(dict.fromkeys(notes)))


def _channel(
    name: str,
    pattern: Sequence[str],
    lit: Sequence[Level],
    dark: Sequence[Level],
    dark_variance: Figure,
    notes: list[str],
) -> Channel:
    """Measure one channel: sections 6.6, 6.7 and 8; the threshold by equation (17)."""
    sites = [number for number, one in enumerate(pattern) if one == name]
    curves = {
        wavelength: _transfer([one for one in lit if one.wavelength_nm == wavelength], dark, sites)
        for wavelength in dict.fromkeys(one.wavelength_nm for one in lit)
    }
    wavelength = max(
        curves,
        key=lambda one: curves[one].signal @ curves[one].photons / np.sum(curves[one].photons ** 2),
    )
    transfer = curves[wavelength]
    where = "" if len(pattern) == 1 else f" of channel {name}"
    _refuse_disorder(transfer, where)
    if transfer.photons.size < LEAST_LEVELS:
        notes.append(
            f"{transfer.photons.size} levels of light, the standard asks for {LEAST_LEVELS}"
        )
    full = transfer.saturation
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
    rows, cols = dark[0].sites[sites[0]].shape
    figures: dict[str, Figure] = {"system_gain_dn_per_e": gain}
    bright = _bright(lit, wavelength, transfer, sites)
    prnu_u2 = 0.0
    stacks = [one for one in dark if one.sites[0].frames > 2]
    if bright is not None and stacks:
        at = min(stacks, key=lambda one: abs(one.exposure_s - bright.exposure_s))
        below = _pattern(at, sites)
        signal = bright.mean - below.mean
        of_response = bright.spatial.minus(below.spatial)
        figures |= _by_part("prnu", "percent", of_response, Figure(signal, 0.0), 100.0)
        if of_response.total > CLEAR_SIGMAS * math.sqrt(of_response.total_u2):
            figures["response_gain_dn_per_e"] = _response_gain(bright, below, of_response, gain)
        # The array is a sample of the type: the mean of its responses has a spread.
        prnu_u2 = (
            max(of_response.pixel, 0.0) / (rows * cols * len(sites))
            + max(of_response.row, 0.0) / rows
            + max(of_response.column, 0.0) / cols
        ) / signal**2
    elif bright is None:
        notes.append("no level near half of saturation has more than two frames: no PRNU")
    responsivity = Figure(slope, math.hypot(spread, slope * math.sqrt(prnu_u2)))
    efficiency = _over(responsivity, gain)
    photons = Figure(float(transfer.photons[full]), _maximum_u(transfer))
    capacity = Figure(
        efficiency.value * photons.value,
        math.hypot(efficiency.u * photons.value, efficiency.value * photons.u),
    )
    noise = Figure.root(max(dark_variance.value, LEAST_DARK_VARIANCE_DN2), dark_variance.u)
    least_e = _over(noise, gain)
    least_e = Figure(least_e.value + 0.5, least_e.u)
    least = _over(least_e, efficiency)
    straight = _linearity(transfer)
    inside = straight.deviation_percent[straight.fitted]
    fitted = straight.fitted
    deviation_u = 100 * np.sqrt(transfer.mean_u2[fitted]) / transfer.signal[fitted]
    figures |= {
        "responsivity_dn_per_photon": responsivity,
        "quantum_efficiency": efficiency,
        "saturation_photons": photons,
        "saturation_e": capacity,
        "sensitivity_threshold_photons": least,
        "sensitivity_threshold_e": least_e,
        "snr_max": Figure(math.sqrt(capacity.value), capacity.u / 2 / math.sqrt(capacity.value)),
        "dynamic_range": _over(photons, least),
        "linearity_error_min_percent": Figure(
            float(inside.min()), float(deviation_u[inside.argmin()])
        ),
        "linearity_error_max_percent": Figure(
            float(inside.max()), float(deviation_u[inside.argmax()])
        ),
    }
    pixels = rows * cols * len(sites)
    return Channel(name, wavelength, pixels, transfer, straight, bright, figures)


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


def _transfer(lit: Sequence[Level], dark: Sequence[Level], sites: Sequence[int]) -> Transfer:
    """Return mean and variance of some sites against the light."""
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
        rows.append(
            [black.exposure_s, level.photons, *_of_sites(level, sites), *_of_sites(black, sites)]
        )
    return Transfer(*np.array(rows).T)


def _of_sites(level: Level, sites: Sequence[int]) -> tuple[float, float, float, float]:
    """Return mean and temporal variance over some sites, each with its squared uncertainty."""
    taken = [level.sites[number] for number in sites]
    temporal = pooled([site.temporal for site in taken])
    (rows, cols), frames = taken[0].shape, taken[0].frames
    # Sites may lie in the same rows and columns, whose noise they then share.
    mean_u2 = (
        max(temporal.pixel, 0.0) / (rows * cols * len(taken))
        + max(temporal.row, 0.0) / rows
        + max(temporal.column, 0.0) / cols
    ) / frames
    return (
        float(np.mean([site.mean for site in taken])),
        mean_u2,
        temporal.total,
        temporal.total_u2,
    )


def _refuse_disorder(transfer: Transfer, where: str) -> None:
    """Refuse levels from which nothing can be measured, with the reason."""
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


def _maximum_u(transfer: Transfer) -> float:
    """Return the standard uncertainty of where the variance is highest, in photons.

    Two parts: the spread of the maximum over curves with the noise that this one has, and that of
    a place between levels.
    """
    full = transfer.saturation
    draws = np.random.default_rng(1288).standard_normal((DRAWS, transfer.photons.size))
    curves = transfer.variance + np.sqrt(transfer.variance_u2) * draws
    spread = float(transfer.photons[curves.argmax(axis=1)].std())
    step = (transfer.photons[full + 1] - transfer.photons[full - 1]) / 2
    return math.hypot(spread, step / math.sqrt(12))


def _linearity(transfer: Transfer) -> Linearity:
    """Fit the line with the least relative deviations: section 6.7, equations (35) to (38)."""
    fitted = transfer.between(*LINEARITY_SHARES)
    x, y = transfer.photons[fitted], transfer.signal[fitted]
    if x.size < 2:
        low, high = LINEARITY_SHARES
        raise UserError(
            f"too few levels between {low:.0%} and {high:.0%} of saturation for the linearity",
            field="photons",
            value=x.size,
            allowed=f"2 or more; the standard asks for {LEAST_LEVELS} levels",
        )
    slope, offset = np.polyfit(x, y, 1, w=1 / y)
    line = offset + slope * transfer.photons
    return Linearity(float(offset), float(slope), fitted, 100 * (transfer.signal - line) / line)


def _bright(
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
    return _pattern(min(stacks, key=lambda one: abs(one.photons - half)), sites)


def _pattern(level: Level, sites: Sequence[int]) -> Pattern:
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


def _dark_series(dark: Sequence[Level]) -> DarkSeries:
    every = range(len(dark[0].sites))
    rows = [[level.exposure_s, *_of_sites(level, every)] for level in dark]
    return DarkSeries(*np.array(rows).T)


def _dark_lines(
    series: DarkSeries, notes: list[str]
) -> tuple[Figure, Figure | None, Figure | None]:
    """Return the dark variance without dark current, and both slopes against time (section 7.1).

    The lines weigh each time by its uncertainty, since the noise rises with the time.
    """
    times = np.unique(series.exposure_s).size
    if times < 3:
        notes.append(f"exposure times in the dark: {times}; the dark current is not measured")
        first = Figure(float(series.variance[0]), math.sqrt(series.variance_u2[0]))
        return first, None, None
    if times < LEAST_TIMES:
        notes.append(f"exposure times in the dark: {times}; the standard asks for {LEAST_TIMES}")
    _, mean = line(series.exposure_s, series.mean, series.mean_u2)
    start, variance = line(series.exposure_s, series.variance, series.variance_u2)
    return start, mean, variance


def line(x: np.ndarray, y: np.ndarray, u2: np.ndarray) -> tuple[Figure, Figure]:
    """Return offset and slope of the line through points, weighted by their uncertainties."""
    weight = 1 / np.maximum(u2, 1e-30)
    total = weight.sum()
    middle = weight @ x / total
    square = weight @ (x - middle) ** 2
    slope = weight @ ((x - middle) * y) / square
    offset = weight @ y / total - slope * middle
    return (
        Figure(float(offset), math.sqrt(1 / total + middle**2 / square)),
        Figure(float(slope), 1 / math.sqrt(square)),
    )


def _weighted(figures: Sequence[Figure]) -> Figure:
    """Return the mean of independent figures, weighted by their uncertainties."""
    weights = np.array([1 / max(one.u, 1e-30) ** 2 for one in figures])
    values = np.array([one.value for one in figures])
    return Figure(float(weights @ values / weights.sum()), float(weights.sum() ** -0.5))


def _over(one: Figure, other: Figure, power: int = 1) -> Figure:
    """Return the quotient of two independent figures, the second to a power."""
    divisor = other.value**power
    value = one.value / divisor
    return Figure(value, math.hypot(one.u / divisor, power * value * other.u / other.value))


def _root(square: float, square_u: float, unit: Figure, factor: float) -> Figure:
    """Return the root of a variance in DN^2 as `factor` times a multiple of `unit`."""
    scale = (factor / unit.value) ** 2
    of_unit = 2 * abs(square) * scale * unit.u / unit.value
    return Figure.root(scale * square, math.hypot(scale * square_u, of_unit))


def _by_part(
    name: str, suffix: str, spatial: Parts, unit: Figure, factor: float
) -> dict[str, Figure]:
    """Return a non-uniformity and its row, column and pixel parts."""
    found = {}
    for part in ("total", "pixel", "row", "column"):
        key = f"{name}_{suffix}" if part == "total" else f"{name}_{part}_{suffix}"
        square_u = math.sqrt(getattr(spatial, f"{part}_u2"))
        found[key] = _root(getattr(spatial, part), square_u, unit, factor)
    return found
