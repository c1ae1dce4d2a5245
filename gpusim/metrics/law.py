"""The law of a pixel's digital numbers, integrated in float64: what a measurement should find.

It shares nothing with the shaders: sums and quadratures of the laws that the sensor file states.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr
from scipy.stats import poisson

from gpusim.metrics.dark import QUANTISATION_DN2
from gpusim.sensor.sensor import Sensor

_NODES = 121  # of a normal law: sums over so even a grid are exact to rounding
_SIGMAS = 6.0
# From here on rounding is independent noise even where the converter clips, to 1 % of the variance;
# below it the codes are summed.
_FINE_DN = 3.0
_SMALL_E = 200.0  # up to where Poisson's law is summed, and normal from there


class PixelLaw:
    """The law of a pixel's digital numbers: charge, well, read noise, converter.

    Parameters
    ----------
    sensor : Sensor
        Gives full well and knee, the law of the temporal noise, the response and the converter.
    black_dn : float
        Black level, DN.
    noise_e, dsnu_e, prnu_percent : float
        Temporal dark noise, spread of the offsets and of the responses, all parts together.
    """

    def __init__(
        self, sensor: Sensor, black_dn: float, noise_e: float, dsnu_e: float, prnu_percent: float
    ) -> None:
        self.sensor = sensor
        self.black_dn, self.noise_e, self.dsnu_e = black_dn, noise_e, dsnu_e
        self.response = prnu_percent / 100
        self.z = np.linspace(-_SIGMAS, _SIGMAS, _NODES)
        self.weight = np.exp(-(self.z**2) / 2)
        self.weight /= self.weight.sum()
        # Nodes for the pixels' responses, and for their offsets under light: no single step matters
        # there.
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
        means = np.maximum(light_e * (1 + self.response * self.nodes), 0) + dark_e
        return np.array([self._pixels(mean, self.nodes) for mean in means])

    def offset_spread_dn(self, dark_e: float) -> float:
        """Return the standard deviation of the pixels' mean dark signals, DN."""
        mean, _ = self._pixels(dark_e, self.z)
        return math.sqrt(self.weight @ (mean - self.weight @ mean) ** 2)

    def _pixels(self, mean_e: float, offsets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance of the digital numbers of pixels, by their offset in sigmas."""
        sensor = self.sensor
        per_e = sensor.gaussian_variance_per_e
        if per_e is not None:  # the read noise is in it
            charge, weight = mean_e + math.sqrt(per_e * mean_e) * self.z, self.weight
        elif mean_e < _SMALL_E:
            charge = np.arange(int(mean_e + 10 * math.sqrt(mean_e)) + 12.0)
            weight = poisson.pmf(charge, mean_e)
        else:
            charge, weight = mean_e + math.sqrt(mean_e) * self.z, self.weight
        if sensor.full_well_knee < 1:
            knee = sensor.full_well_knee * sensor.full_well_e
            room = sensor.full_well_e - knee
            above = np.maximum(charge - knee, 0)
            charge = np.minimum(charge, knee) + room * -np.expm1(-above / room)
        charge = np.minimum(charge, sensor.full_well_e)
        electrons = np.add.outer(self.dsnu_e * offsets, charge)
        noise = sensor.system_gain_dn_per_e * self.noise_e
        if sensor.linearity is not None:
            read = sensor.linearity.read
            noise = noise * (read(electrons + 0.5) - read(electrons - 0.5))
            electrons = read(electrons)
        middle = self.black_dn + sensor.system_gain_dn_per_e * electrons
        if sensor.dual_gain is None:
            first, second = converted(middle, np.asarray(noise), sensor.max_dn)
        else:
            first, second = self._merged(middle, np.asarray(noise), electrons)
        mean, square = first @ weight, second @ weight
        return mean, square - mean**2

    def _merged(
        self, middle: np.ndarray, noise: np.ndarray, electrons: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return first and second moment of the codes that two reads of a charge are merged to.

        Parameters
        ----------
        middle, noise : ndarray
            Those of the read at high gain, DN.
        electrons : ndarray
        """
        sensor, low = self.sensor, self.sensor.at_low_gain()
        switch = sensor.dual_gain.switch_dn
        # Codes below the switch are kept: what they count for is what a converter gives that ends
        # just below it, less what clips there.
        share = ndtr((middle - (switch - 0.5)) / np.maximum(noise, 1e-9))
        first, second = converted(middle, noise, switch - 1)
        first, second = first - share * (switch - 1), second - share * (switch - 1) ** 2
        gain, high = low.system_gain_dn_per_e, sensor.temporal_dark_noise_e
        noise_e = math.sqrt(self.noise_e**2 - high**2 + low.temporal_dark_noise_e**2)
        codes, squares = converted(
            low.black_level_dn + gain * electrons, np.asarray(gain * noise_e), low.max_dn
        )
        ratio = sensor.system_gain_dn_per_e / gain
        offset = self.black_dn - ratio * low.black_level_dn
        first += share * (offset + ratio * codes)
        second += share * (offset**2 + 2 * offset * ratio * codes + ratio**2 * squares)
        return first, second


def converted(middle: np.ndarray, noise: np.ndarray, top: int) -> tuple[np.ndarray, np.ndarray]:
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
