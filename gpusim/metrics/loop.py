"""Closing the loop: what the measurement should find on a simulated sensor, and whether it did.

A figure of the sensor file is what should be found, except where the measurement cannot see it: a
maximum of the temporal variance lies below the charge at which pixels clip, and a converter whose
steps are coarser than the noise, or whose black level is 0, shows another noise. There the expected
figure comes from the law of a pixel's digital numbers, integrated here in float64, and the row says
why.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr
from scipy.stats import poisson

from gpusim.metrics.emva import (
    DRAWS,
    LEAST_DARK_VARIANCE_DN2,
    QUANTISATION_DN2,
    UNDERFLOW_SHARE,
    Channel,
    Characterisation,
    Figure,
    line,
)
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

COVERAGE = 3  # k: 99.7 % of normal deviations lie within
ROUNDING = 1e-9  # of a figure without noise: of the sums that it is made of
SMALLEST = 1e-6  # e-^2, %^2: variances that matter to nobody, where no pixel of an array shows one
# Rounding is as good as independent noise of 1/12 DN^2 where the noise is wider than half a step:
# its variance is then off by less than 1 % (B. Widrow & I. Kollar, Quantization Noise, 2008).
COARSE_DN = 0.5
_NODES = 121  # of a normal law: sums over so even a grid are exact to rounding
_SIGMAS = 6.0
# From here on rounding is independent noise even where the converter clips, to 1 % of the variance;
# below it the codes are summed.
_FINE_DN = 3.0
_SMALL_E = 200.0  # up to where Poisson's law is summed, and normal from there


@dataclass(frozen=True)
class Row:
    """One parameter: what it is, what should be found, what was found.

    Attributes
    ----------
    parameter : str
        EMVA's symbol, with the channel where it is of one.
    unit : str
    data_sheet : float
        Of the sensor file.
    expected : float
        What the measurement should find.
    reason : str
        Why that is not the data sheet's; empty where it is.
    recovered : float
    uncertainty : float
        Expanded, of `recovered`, with the coverage factor k of COVERAGE.
    sigmas : float
        Distance of the two in standard uncertainties; of a root of a variance that of the variance.
    within : bool
        Whether they agree within the uncertainty.
    """

    parameter: str
    unit: str
    data_sheet: float
    expected: float
    reason: str
    recovered: float
    uncertainty: float
    sigmas: float
    within: bool


def rows(found: Characterisation, sensor: Sensor) -> list[Row]:
    """Compare what was found with the sensor file.

    Parameters
    ----------
    found : Characterisation
        Of frames of this sensor.
    sensor : Sensor
    """
    reason = _why(sensor, float(found.channels[0].transfer.exposure_s[0]))
    table = []
    for channel in found.channels:
        of = f" {channel.name}" if len(found.channels) > 1 else ""
        table += _of_channel(channel, sensor, of, reason)
    unlike = found.figures.get("response_gain_dn_per_e")
    if unlike is not None and not reason:
        gain = sensor.system_gain_dn_per_e
        table.append(_row("K of unlike pixels", "DN/e-", gain, gain, "", unlike))
    gains = [row.expected for row in table if row.unit == "DN/e-"]
    return table + _in_the_dark(found, sensor, reason, float(np.mean(gains)))


def _of_channel(channel: Channel, sensor: Sensor, of: str, reason: str) -> list[Row]:
    figures, transfer = channel.figures, channel.transfer
    efficiency = float(np.interp(channel.wavelength_nm, WAVELENGTHS_NM, sensor.qe[channel.name]))
    gain = sensor.system_gain_dn_per_e
    model = _Model(sensor, _black_dn(sensor, channel.name))
    dark_e = transfer.exposure_s * sensor.dark_current_e_per_s
    mean, variance = model.levels(efficiency * transfer.photons, dark_e)
    expected = {"gain": gain, "efficiency": efficiency, "prnu": sensor.prnu_percent}
    if reason:
        black, black_variance = model.levels(np.zeros_like(dark_e), dark_e)
        ideal = replace(
            transfer, mean=mean, variance=variance, dark_mean=black, dark_variance=black_variance
        )
        none = np.zeros_like(mean)
        expected["gain"], _ = ideal.slope(variance - black_variance, ideal.signal, none, none)
        slope, _ = ideal.slope(ideal.signal, transfer.photons, none, none)
        expected["efficiency"] = slope / expected["gain"]
        if channel.bright is not None:
            light = efficiency * channel.bright.photons
            expected["prnu"] = model.response_percent(light, float(dark_e[0]))
    found = [
        _row(f"K{of}", "DN/e-", gain, expected["gain"], reason, figures["system_gain_dn_per_e"]),
        _row(
            f"eta{of} at {channel.wavelength_nm:g} nm",
            "1",
            efficiency,
            expected["efficiency"],
            reason,
            figures["quantum_efficiency"],
        ),
    ]
    draws = np.random.default_rng(1289).standard_normal((DRAWS, mean.size))
    tops = (variance + np.sqrt(transfer.variance_u2) * draws).argmax(axis=1)
    capacity = expected["efficiency"] * transfer.photons[tops]
    full = figures["saturation_e"]
    clips = sensor.saturation_e
    first = "well is full" if clips == sensor.full_well_e else f"converter ends, at {clips:.0f} e-"
    found.append(
        _row(
            f"mu_e.sat{of}",
            "e-",
            sensor.full_well_e,
            float(capacity.mean()),
            f"the variance is highest a little before the {first}",
            Figure(full.value, math.hypot(full.u, float(capacity.std()))),
        )
    )
    if "prnu_percent" in figures:
        prnu = sensor.prnu_percent
        found.append(
            _row(f"PRNU{of}", "%", prnu, expected["prnu"], reason, figures["prnu_percent"])
        )
    return found


def _in_the_dark(found: Characterisation, sensor: Sensor, reason: str, gain: float) -> list[Row]:
    """Judge what all photosites give; `gain` is the K that DN become electrons with."""
    figures = found.figures
    noise, offsets = sensor.temporal_dark_noise_e, sensor.dsnu_e
    current = spread = sensor.dark_current_e_per_s
    if reason:
        model = _Model(sensor, sensor.black_level_dn)
        times = found.series.exposure_s
        mean, variance = model.levels(np.zeros_like(times), times * current)
        current = line(times, mean, found.series.mean_u2)[1].value / gain
        start, slope = line(times, variance, found.series.variance_u2)
        spread = slope.value / gain**2
        least = max(start.value, LEAST_DARK_VARIANCE_DN2)
        noise = math.sqrt(least - QUANTISATION_DN2) / gain
        exposure_s = found.dark.exposure_s if found.dark else 0.0
        offsets = model.offset_spread_dn(exposure_s * sensor.dark_current_e_per_s) / gain
    columns_e, of_columns = _column_offsets_dn(sensor) / gain, ""
    if columns_e:
        of_columns = "; ".join(filter(None, [reason, "the columns' converters add their offsets"]))
    shown = [
        ("sigma_d", "e-", sensor.temporal_dark_noise_e, noise, reason, "temporal_dark_noise_e"),
        ("mu_I (mean)", "e-/s", sensor.dark_current_e_per_s, current, reason, _CURRENT),
        ("mu_I (variance)", "e-/s", sensor.dark_current_e_per_s, spread, reason, _CURRENT_BY_NOISE),
        (
            "DSNU",
            "e-",
            sensor.dsnu_e,
            math.hypot(offsets, columns_e),
            of_columns or reason,
            "dsnu_e",
        ),
    ]
    if columns_e:
        shown.append(("DSNU.col", "e-", columns_e, columns_e, "", "dsnu_column_e"))
    return [
        _row(name, unit, sheet, expected, why, figures[key])
        for name, unit, sheet, expected, why, key in shown
        if key in figures
    ]


_CURRENT, _CURRENT_BY_NOISE = "dark_current_e_per_s", "dark_current_variance_e_per_s"


def _black_dn(sensor: Sensor, channel: str) -> float:
    """Return the black level of a channel, DN."""
    return (sensor.channel_black_level_dn or {}).get(channel, sensor.black_level_dn)


def _column_offsets_dn(sensor: Sensor) -> float:
    """Return the standard deviation of the columns' offsets in the part that is read, DN."""
    offset = sensor.column_offset
    if offset is None:
        return 0.0
    if offset.sigma_dn is not None:
        return offset.sigma_dn
    first = sensor.first_col + sensor.frame.on_chip(sensor.frame.lit)[1]
    return float(np.std(offset.offsets_dn[first : first + sensor.cols], ddof=1))


def _row(
    parameter: str, unit: str, sheet: float, expected: float, reason: str, figure: Figure
) -> Row:
    """Judge one figure; one that is a root of a variance as that variance, whose law is normal."""
    if figure.square is None:
        uncertainty = COVERAGE * figure.u
        away, u = abs(figure.value - expected), figure.u
        least = ROUNDING * abs(expected)
    else:
        most = max(figure.square, 0.0) + COVERAGE * figure.square_u
        uncertainty = math.sqrt(most) - figure.value
        away, u = abs(figure.square - expected**2), figure.square_u
        least = SMALLEST
    sigmas = away / max(u, least, np.finfo(float).tiny)
    within = bool(sigmas <= COVERAGE)
    return Row(parameter, unit, sheet, expected, reason, figure.value, uncertainty, sigmas, within)


def _why(sensor: Sensor, exposure_s: float) -> str:
    """Return why the digital numbers do not follow the linear camera; empty where they do."""
    gain = sensor.system_gain_dn_per_e
    dark_e = exposure_s * sensor.dark_current_e_per_s
    noise = gain * math.hypot(sensor.temporal_dark_noise_e, math.sqrt(dark_e))
    spread = math.hypot(noise, gain * sensor.dsnu_e)
    reasons = []
    if sensor.linearity is not None:
        low, high = sensor.linearity.error_percent(sensor.saturation_e)
        reasons.append(f"the response is off a straight line by {low:+.2g} to {high:+.2g} %")
    if noise < COARSE_DN:
        reasons.append(f"the dark noise of {noise:.2g} DN is finer than the converter's steps")
    level = min(sensor.site_black_dn) + gain * dark_e
    if spread and ndtr((0.5 - level) / spread) > UNDERFLOW_SHARE:
        reasons.append(f"the black level of {sensor.black_level_dn:g} DN lets the converter clip")
    return "; ".join(reasons)


class _Model:
    """The law of a pixel's digital numbers: well, read noise, converter; in float64."""

    def __init__(self, sensor: Sensor, black_dn: float) -> None:
        self.sensor = sensor
        self.black_dn = black_dn
        self.z = np.linspace(-_SIGMAS, _SIGMAS, _NODES)
        self.weight = np.exp(-(self.z**2) / 2)
        self.weight /= self.weight.sum()
        # Of the pixels' responses, and of their offsets under light, where no single step matters.
        nodes, weight = np.polynomial.hermite_e.hermegauss(9)
        self.nodes, self.node_weight = nodes, weight / weight.sum()

    def levels(self, light_e: np.ndarray, dark_e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and temporal variance over the pixels of an array, DN and DN^2: (n,) each."""
        found = []
        for light, dark in zip(light_e, dark_e, strict=True):
            if light:
                found.append(self.node_weight @ (self._unlike(light, dark) @ self.node_weight))
            else:
                found.append(np.array(self._pixels(dark, self.z)) @ self.weight)
        mean, variance = np.array(found).T
        return mean, variance

    def response_percent(self, light_e: float, dark_e: float) -> float:
        """Return the spread of the pixels' mean signals for their responses, per cent of it."""
        means = self._unlike(light_e, dark_e)[:, 0] @ self.node_weight
        (black,), _ = self.levels(np.zeros(1), np.array([dark_e]))
        middle = self.node_weight @ means
        return 100 * math.sqrt(self.node_weight @ (means - middle) ** 2) / (middle - black)

    def _unlike(self, light_e: float, dark_e: float) -> np.ndarray:
        """Return mean and variance by response and by offset: (responses, 2, offsets)."""
        spread = self.sensor.prnu_percent / 100
        means = np.maximum(light_e * (1 + spread * self.nodes), 0) + dark_e
        return np.array([self._pixels(mean, self.nodes) for mean in means])

    def offset_spread_dn(self, dark_e: float) -> float:
        """Return the standard deviation of the pixels' mean dark signals, DN."""
        mean, _ = self._pixels(dark_e, self.z)
        return math.sqrt(self.weight @ (mean - self.weight @ mean) ** 2)

    def _pixels(self, mean_e: float, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance of the digital numbers of pixels, by their offset in sigmas."""
        sensor = self.sensor
        if mean_e < _SMALL_E:
            charge = np.arange(int(mean_e + 10 * math.sqrt(mean_e)) + 12.0)
            weight = poisson.pmf(charge, mean_e)
        else:
            charge, weight = mean_e + math.sqrt(mean_e) * self.z, self.weight
        charge = np.minimum(charge, sensor.full_well_e)
        electrons = np.add.outer(sensor.dsnu_e * offsets, charge)
        noise = sensor.system_gain_dn_per_e * sensor.temporal_dark_noise_e
        if sensor.linearity is not None:
            read = sensor.linearity.read
            noise = noise * (read(electrons + 0.5) - read(electrons - 0.5))
            electrons = read(electrons)
        middle = self.black_dn + sensor.system_gain_dn_per_e * electrons
        first, second = _converted(middle, np.asarray(noise), sensor.max_dn)
        mean, square = first @ weight, second @ weight
        return mean, square - mean**2


def _converted(middle: np.ndarray, noise: np.ndarray, top: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second moment of what a converter makes of normal voltages.

    Parameters
    ----------
    middle : ndarray
        Mean, DN.
    noise : ndarray
        Standard deviation, DN: of all, or of each.
    top : int
        Highest digital number.
    """
    if noise.min() >= _FINE_DN:
        low, high = -middle / noise, (top - middle) / noise
        inside = ndtr(high) - ndtr(low)
        density_low, density_high = (np.exp(-(end**2) / 2) / math.tau**0.5 for end in (low, high))
        first = middle * inside + noise * (density_low - density_high) + top * ndtr(-high)
        second = (
            (middle**2 + noise**2 + QUANTISATION_DN2) * inside
            + noise * (density_low * middle - density_high * (middle + top))
            + top**2 * ndtr(-high)
        )
        return first, second
    base = np.floor(middle + 0.5)
    reach = math.ceil(_SIGMAS * float(noise.max())) + 1
    first, second = np.zeros_like(middle), np.zeros_like(middle)
    for step in range(-reach, reach + 1):
        code = base + step
        if noise.all():
            share = ndtr((code + 0.5 - middle) / noise) - ndtr((code - 0.5 - middle) / noise)
        else:
            share = (step == 0) * np.ones_like(middle)
        code = np.clip(code, 0, top)
        first += share * code
        second += share * code**2
    return first, second


def failed(table: Sequence[Row]) -> int:
    """Return how many parameters fall outside."""
    return sum(not row.within for row in table)
