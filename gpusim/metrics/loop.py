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
    QUANTISATION_DN2,
    UNDERFLOW_SHARE,
    Channel,
    Characterisation,
    Figure,
)
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

COVERAGE = 3  # k: 99.7 % of normal deviations lie within
# Rounding is as good as independent noise of 1/12 DN^2 where the noise is wider than half a step:
# its variance is then off by less than 1 % (B. Widrow & I. Kollar, Quantization Noise, 2008).
COARSE_DN = 0.5
_NODES = 121  # of a normal law: sums over so even a grid are exact to rounding
_SIGMAS = 6.0
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
    within : bool
        Whether the two agree within the uncertainty.
    """

    parameter: str
    unit: str
    data_sheet: float
    expected: float
    reason: str
    recovered: float
    uncertainty: float
    within: bool


def rows(found: Characterisation, sensor: Sensor) -> list[Row]:
    """Compare what was found with the sensor file.

    Parameters
    ----------
    found : Characterisation
        Of frames of this sensor.
    sensor : Sensor
    """
    dark = found.channels[0].transfer
    coarse = _why_coarse(sensor, float(dark.exposure_s[0]))
    table = []
    for channel in found.channels:
        of = f" {channel.name}" if len(found.channels) > 1 else ""
        table += _of_channel(channel, sensor, of, coarse)
    table += _in_the_dark(found, sensor, coarse)
    return table


def _of_channel(channel: Channel, sensor: Sensor, of: str, coarse: str) -> list[Row]:
    figures, transfer = channel.figures, channel.transfer
    efficiency = float(np.interp(channel.wavelength_nm, WAVELENGTHS_NM, sensor.qe[channel.name]))
    gain = sensor.system_gain_dn_per_e
    model = _Model(sensor)
    dark_e = transfer.exposure_s * sensor.dark_current_e_per_s
    mean, variance = model.levels(efficiency * transfer.photons, dark_e)
    expected_gain, expected_efficiency = gain, efficiency
    if coarse:
        black, black_variance = model.levels(np.zeros_like(dark_e), dark_e)
        ideal = replace(
            transfer, mean=mean, variance=variance, dark_mean=black, dark_variance=black_variance
        )
        none = np.zeros_like(mean)
        expected_gain, _ = ideal.slope(variance - black_variance, ideal.signal, none, none)
        slope, _ = ideal.slope(ideal.signal, transfer.photons, none, none)
        expected_efficiency = slope / expected_gain
    found = [
        _row(f"K{of}", "DN/e-", gain, expected_gain, coarse, figures["system_gain_dn_per_e"]),
        _row(
            f"eta{of} at {channel.wavelength_nm:g} nm",
            "1",
            efficiency,
            expected_efficiency,
            coarse,
            figures["quantum_efficiency"],
        ),
    ]
    draws = np.random.default_rng(1289).standard_normal((DRAWS, mean.size))
    tops = (variance + np.sqrt(transfer.variance_u2) * draws).argmax(axis=1)
    capacity = efficiency * transfer.photons[tops]
    full = figures["saturation_e"]
    converter = (sensor.max_dn + 0.5 - sensor.black_level_dn) / gain
    first = "well" if sensor.full_well_e <= converter else f"converter, at {converter:.0f} e-,"
    found.append(
        _row(
            f"mu_e.sat{of}",
            "e-",
            sensor.full_well_e,
            float(capacity.mean()),
            f"the variance is highest before the {first} clips",
            Figure(full.value, math.hypot(full.u, float(capacity.std()))),
        )
    )
    prnu = sensor.prnu_percent
    if "prnu_percent" in figures:
        found.append(_row(f"PRNU{of}", "%", prnu, prnu, "", figures["prnu_percent"]))
    if "response_gain_dn_per_e" in figures:
        slope = figures["response_gain_dn_per_e"]
        found.append(_row(f"K{of} of unlike pixels", "DN/e-", gain, gain, "", slope))
    return found


def _in_the_dark(found: Characterisation, sensor: Sensor, coarse: str) -> list[Row]:
    figures = found.figures
    noise, offsets = sensor.temporal_dark_noise_e, sensor.dsnu_e
    current = spread = sensor.dark_current_e_per_s
    if coarse:
        model, gain = _Model(sensor), sensor.system_gain_dn_per_e
        times = found.series.exposure_s
        mean, variance = model.levels(np.zeros_like(times), times * current)
        weights = found.series.mean_u2**-0.5, found.series.variance_u2**-0.5
        current = float(np.polyfit(times, mean, 1, w=weights[0])[0]) / gain
        slope, start = np.polyfit(times, variance, 1, w=weights[1])
        spread = float(slope) / gain**2
        noise = math.sqrt(max(start - QUANTISATION_DN2, 0.0)) / gain
        exposure_s = found.dark.exposure_s if found.dark else 0.0
        offsets = model.offset_spread_dn(exposure_s * sensor.dark_current_e_per_s) / gain
    shown = [
        ("sigma_d", "e-", sensor.temporal_dark_noise_e, noise, "temporal_dark_noise_e"),
        ("mu_I (mean)", "e-/s", sensor.dark_current_e_per_s, current, "dark_current_e_per_s"),
        (
            "mu_I (variance)",
            "e-/s",
            sensor.dark_current_e_per_s,
            spread,
            "dark_current_variance_e_per_s",
        ),
        ("DSNU", "e-", sensor.dsnu_e, offsets, "dsnu_e"),
    ]
    return [
        _row(name, unit, sheet, expected, coarse, figures[key])
        for name, unit, sheet, expected, key in shown
        if key in figures
    ]


def _row(
    parameter: str, unit: str, sheet: float, expected: float, reason: str, figure: Figure
) -> Row:
    """Judge one figure; one that is a root of a variance as that variance, whose law is normal."""
    if figure.square is None:
        uncertainty = COVERAGE * figure.u
        within = abs(figure.value - expected) <= uncertainty
    else:
        most = max(figure.square, 0.0) + COVERAGE * figure.square_u
        uncertainty = math.sqrt(most) - figure.value
        within = abs(figure.square - expected**2) <= COVERAGE * figure.square_u
    return Row(parameter, unit, sheet, expected, reason, figure.value, uncertainty, bool(within))


def _why_coarse(sensor: Sensor, exposure_s: float) -> str:
    """Return why the converter does not show the dark signal as it is; empty where it does."""
    gain = sensor.system_gain_dn_per_e
    dark_e = exposure_s * sensor.dark_current_e_per_s
    noise = gain * math.hypot(sensor.temporal_dark_noise_e, math.sqrt(dark_e))
    if noise < COARSE_DN:
        return f"the dark noise of {noise:.2f} DN is lost in the converter's steps"
    spread = math.hypot(noise, gain * sensor.dsnu_e)
    level = sensor.black_level_dn + gain * dark_e
    if ndtr((0.5 - level) / spread) > UNDERFLOW_SHARE:
        return f"the black level of {sensor.black_level_dn:g} DN clips the dark signal at 0 DN"
    return ""


class _Model:
    """The law of a pixel's digital numbers: well, read noise, converter; in float64."""

    def __init__(self, sensor: Sensor) -> None:
        self.sensor = sensor
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
                spread = self.sensor.prnu_percent / 100
                means = light * (1 + spread * self.nodes) + dark
                pixels = np.array([self._pixels(mean, self.nodes) for mean in means])
                found.append(self.node_weight @ (pixels @ self.node_weight))
            else:
                found.append(np.array(self._pixels(dark, self.z)) @ self.weight)
        mean, variance = np.array(found).T
        return mean, variance

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
        middle = sensor.black_level_dn + sensor.system_gain_dn_per_e * electrons
        noise = sensor.system_gain_dn_per_e * sensor.temporal_dark_noise_e
        first, second = _converted(middle, noise, sensor.max_dn)
        mean, square = first @ weight, second @ weight
        return mean, square - mean**2


def _converted(middle: np.ndarray, noise: float, top: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first and second moment of what a converter makes of normal voltages.

    Parameters
    ----------
    middle : ndarray
        Mean, DN.
    noise : float
        Standard deviation, DN.
    top : int
        Highest digital number.
    """
    if noise >= 1:  # rounding is independent noise; clipping is that of a normal law
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
    reach = math.ceil(_SIGMAS * noise) + 1
    first, second = np.zeros_like(middle), np.zeros_like(middle)
    for step in range(-reach, reach + 1):
        code = base + step
        if noise:
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
