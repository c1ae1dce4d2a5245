"""Hue shift and parametric noise of Short, Williams & Jones (1999), section 2.2: closed forms.

**Hue.** Where each transfer of the serial register leaves the fraction e behind, the packet that is
read from column c holds, of what started d columns before it, the share
(1 - e) C(c, d) (1 - e)^(c - d) e^d (Janesick 2001, "Scientific Charge-Coupled Devices", chapter 5).
Filters alternate along a row: the packet has (1 - (1 - 2 e)^c) / 2 of the other filter's charge.

**Noise.** The paper takes temporal noise as normal, with a variance a + b S of two numbers; nature
counts electrons. With a = sigma_d^2 + D and b = 1 both have the same variance. Counting is skewed:
its third moment over that of the deviation is (S + D) / (S + D + sigma_d^2)^(3/2), where the
normal law has 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from gpusim.isp.colour import colour_matrix, response
from gpusim.library.light import Light
from gpusim.scene.spectra import colorchecker, white_radiance
from gpusim.sensor.cti_model import Cti
from gpusim.sensor.load import load_sensor
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.kodak import BANDS, EXPOSURE_S, SENSOR
from gpusim.validate.kodak_effects import SEED, plain_sensor

# Left behind in each transfer: as the file has it, and that of worn or cold registers.
INEFFICIENCIES = (2e-5, 5e-5, 2e-4)
PATCHES = ("neutral 5 (.70 D)", "red", "orange", "yellow", "green", "cyan", "blue")
WHITE_SHARE = 0.8  # of the full well, that the white of the light of the patches makes
ILLUMINANT = "D65"
HUE_BAR = 1e-5  # of a ratio of channels; sums of float32 packets keep 1e-6
LEVELS_E = (0.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 3000.0, 10000.0, 20000.0)
FRAMES = 8  # of each level: skewness is then known to 0.0016
ALARM = 1e-3  # chance of a false alarm of all figures of noise together


@dataclass(frozen=True, eq=False)
class Hues:
    """Ratios of channels along a row, and the hues that follow.

    Attributes
    ----------
    columns : ndarray (N,)
        Where the pairs of photosites begin.
    ratios : ndarray (E, 2, N)
        R/G and B/G of the grey over those of column 0, by inefficiency: read from the sensor.
    expected : ndarray (E, 2, N)
        By the closed form.
    hue_deg : ndarray (E, P, N)
        Shift of the hue angle of CIELAB of the coloured patches.
    delta_e : ndarray (E, P + 1)
        CIEDE2000 at the last column, of all patches.
    """

    columns: np.ndarray
    ratios: np.ndarray
    expected: np.ndarray
    hue_deg: np.ndarray
    delta_e: np.ndarray

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        errors = (self.ratios / self.expected - 1).ravel()
        name = "R/G and B/G of a grey along a row, against the closed form"
        return [Bar.largest(name, errors, HUE_BAR, "of the ratio")]


@dataclass(frozen=True)
class Moments:
    """Temporal noise at a level: variance and skewness of both models, and their laws.

    ``signal_e`` holds the dark current too.
    """

    signal_e: float
    pixels: int
    expected_variance: float
    expected_skewness: float
    variance: dict[str, float]
    skewness: dict[str, float]
    kurtosis: float

    def deviates(self) -> list[float]:
        """Return how far each figure is from its law, in its standard deviations."""
        u_variance = np.sqrt((self.kurtosis + 2) / self.pixels)  # of the variance, relative
        u_skewness = np.sqrt(6 / self.pixels)
        found = [(one / self.expected_variance - 1) / u_variance for one in self.variance.values()]
        laws = {"physical": self.expected_skewness, "parametric": 0.0}
        return found + [(self.skewness[name] - law) / u_skewness for name, law in laws.items()]


@dataclass(frozen=True, eq=False)
class Noises:
    """Both models of temporal noise, by level."""

    levels: Sequence[Moments]

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        deviates = [one for level in self.levels for one in level.deviates()]
        bound = float(norm.isf(ALARM / len(deviates) / 2))
        name = "variance and skewness of physical and parametric noise, against their laws"
        return [Bar.largest(name, deviates, bound, "standard deviations")]


def even(light: Light, sensor: Sensor, electrons: np.ndarray) -> Light:
    """Return a light that makes mean electrons (S,) at the photosites of a pattern everywhere."""
    rates = np.asarray(electrons, float)[:, None, None] / EXPOSURE_S
    shape = light.rates.shape
    return replace(light, sensor=sensor, rates=np.broadcast_to(rates, shape).astype(np.float32))


def odd_share(column: np.ndarray, inefficiency: float) -> np.ndarray:
    """Return the share of the other filter's charge in the packets of columns."""
    return (1 - (1 - 2 * inefficiency) ** column) / 2


def measure_hues(light: Light) -> Hues:
    """Read rows of even colours through registers that leave charge behind."""
    import colour

    sensor = plain_sensor()
    names = [BANDS.index(name) for name in sensor.site_channels()]
    seen = response(sensor.qe)
    white = white_radiance(ILLUMINANT, 1.0)
    unit = WHITE_SHARE * sensor.full_well_e / (seen @ white).max()
    patches = np.stack([colorchecker()[name] for name in PATCHES])
    electrons = unit * (patches * white) @ seen.T  # (P, RGB)
    # Camera to XYZ, the light's white at its own chromaticity and Y = 1.
    camera_white = seen @ white
    xy = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"][ILLUMINANT]
    to_xyz = np.linalg.inv(colour_matrix(seen, ILLUMINANT))
    balance = colour.xy_to_XYZ(xy) / (to_xyz @ camera_white)

    columns = np.arange(0, sensor.cols, 2)
    ratios, expected, hues, errors = [], [], [], []
    for inefficiency in INEFFICIENCIES:
        change = {"serial_cti": Cti(inefficiency=inefficiency)}
        leaving = sensor.model_copy(update=change)
        found = np.stack(
            [_channels(even(light, leaving, own[names]), leaving) for own in electrons]
        )  # (P, RGB, N)
        own, grey = found[0], electrons[0]
        ratios.append(own[[0, 2]] / own[1] / (grey[[0, 2]] / grey[1])[:, None])
        expected.append(_law(columns, sensor, inefficiency, grey))
        lab = np.stack(
            [
                colour.XYZ_to_Lab((to_xyz @ one / unit).T * balance, xy)
                for one in (*found, *(electrons[:, :, None] * np.ones(columns.size)))
            ]
        )  # (2 P, N, 3)
        now, before = lab[: len(PATCHES)], lab[len(PATCHES) :]
        angle = np.degrees(
            np.angle(
                (now[1:, :, 1] + 1j * now[1:, :, 2]) / (before[1:, :, 1] + 1j * before[1:, :, 2])
            )
        )
        hues.append(angle)
        errors.append(colour.delta_E(before[:, -1], now[:, -1], method="CIE 2000"))
    made = (np.array(one) for one in (ratios, expected, hues, errors))
    return Hues(columns, *made)


def _channels(light: Light, sensor: Sensor) -> np.ndarray:
    """Return red, green (mean of both) and blue along a row of patterns, electrons: (3, N)."""
    plane = light.read({"electrons": np.float32}, Shot(EXPOSURE_S, SEED, 0), noise=False)
    rows = plane["electrons"].astype(float)
    light.release()
    of: dict[str, list[np.ndarray]] = {name: [] for name in BANDS}
    for site, name in enumerate(sensor.site_channels()):
        of[name].append(rows[site // 2 :: 2, site % 2 :: 2].mean(axis=0))
    return np.stack([np.mean(of[name], axis=0) for name in BANDS])


def _law(
    columns: np.ndarray, sensor: Sensor, inefficiency: float, electrons: np.ndarray
) -> np.ndarray:
    """Return R/G and B/G (2, N) over those of what the light makes, by the closed form."""
    read: dict[str, list[np.ndarray]] = {name: [] for name in BANDS}
    for row in sensor.cfa.pattern:
        for col, name in enumerate(row):
            own, other = (electrons[BANDS.index(row[at])] for at in (col, 1 - col))
            odd = odd_share(columns + col, inefficiency)
            read[name].append((1 - odd) * own + odd * other)
    red, green, blue = (np.mean(read[name], axis=0) for name in BANDS)
    start = electrons / electrons[1]
    return np.stack([red / green / start[0], blue / green / start[2]])


def measure_noises(light: Light) -> Noises:
    """Read even fields with both models of temporal noise, by level."""
    own = load_sensor(SENSOR)
    kept = ("temporal_dark_noise_e", "dark_current_e_per_s")
    physical = plain_sensor().model_copy(update={name: getattr(own, name) for name in kept})
    sensors = {
        "physical": physical,
        "parametric": physical.model_copy(update={"gaussian_variance_per_e": 1.0}),
    }
    dark_e = own.dark_current_e_per_s * EXPOSURE_S
    levels = []
    for number, level in enumerate(LEVELS_E):
        mean = level + dark_e
        variance, skewness = {}, {}
        for name, sensor in sensors.items():
            field = even(light, sensor, np.full(len(sensor.site_channels()), level))
            away = (
                np.stack(
                    [
                        field.read(
                            {"electrons": np.float32}, Shot(EXPOSURE_S, SEED, FRAMES * number + k)
                        )["electrons"].astype(float)
                        for k in range(FRAMES)
                    ]
                )
                - mean
            )
            field.release()
            variance[name] = float(np.mean(away**2))
            about = away - away.mean()  # its chance is then 6 / n, and 15 / n about the known mean
            skewness[name] = float(np.mean(about**3) / np.mean(about**2) ** 1.5)
        expected = mean + own.temporal_dark_noise_e**2
        levels.append(
            Moments(
                mean, away.size, expected, mean / expected**1.5, variance, skewness,
                mean / expected**2,
            )
        )  # fmt: skip
    return Noises(levels)
