"""Signal and noise of the Samsung validation, by exposure and ISO, against its equations.

An even grey field in the middle of the picture is exposed in steps at steps of the analogue gain.
The paper's equations 2 and 3,

    mu = min(integral eta(l) l A / (h c) E(l) t dl, full well),
    Y = min(max(0, K mu + black), top),

give the signal, with E = L(l) T(l) Omega from the light of the scene, the glass surfaces and the
pupil's projected solid angle of an independent tracer; and EMVA 1288, release 3.1, equation 11,

    SNR = mu / sqrt(mu + mu_dark + sigma_d^2 + 1 / (12 K^2))

the temporal signal-to-noise ratio, which two frames of a pair give without the fixed pattern.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from gpusim.lens.prescription import Prescription
from gpusim.library.expose import expose
from gpusim.scene import make_scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificates_of
from gpusim.validate.predict import Predictor
from gpusim.validate.samsung_camera import SENSOR, STANDARD, camera_of

SIDE_PX = 128  # of the field: a channel's noise is known to 1.1 % from a pair
TOLERANCE, PROBES, SEED = 2e-3, 8, 1288
EXPOSURES_S = (1 / 2000, 1 / 500, 1 / 125, 1 / 60, 1 / 30)
ISOS = (100, 200, 400, 800, 1600)
H_J_S, C_M_S = 6.62607015e-34, 2.99792458e8
SIGNAL_BAR = TOLERANCE  # of the signal, beyond what chance leaves
ALARM = 0.01  # chance of a false alarm of all ratios together
CHANNELS = "RGB"
COUNT = len(EXPOSURES_S) * len(ISOS) * len(CHANNELS)


@dataclass(frozen=True)
class Reading:
    """One channel of one exposure: measured and by the equations.

    Where pixels are saturated there is no noise to speak of: both ratios are None.
    """

    channel: str
    iso: int
    exposure_s: float
    signal_dn: float
    expected_dn: float
    u_signal_dn: float
    snr: float | None
    expected_snr: float | None
    pixels: int

    @property
    def signal_error(self) -> float:
        """Share by which the signal is off."""
        return self.signal_dn / self.expected_dn - 1

    @property
    def allowance(self) -> float:
        """Share by which it may be: the bar, and what chance leaves at the chance `ALARM`."""
        chance = norm.isf(ALARM / COUNT / 2) * self.u_signal_dn
        return SIGNAL_BAR + float(chance) / self.expected_dn

    @property
    def deviation(self) -> float:
        """Ratio of variances' distance from 1, in half-widths of its chi-square interval."""
        if self.snr is None or self.expected_snr is None:
            return 0.0
        ratio = (self.expected_snr / self.snr) ** 2
        freedom, tail = self.pixels - 1, ALARM / COUNT / 2
        low, high = chi2.ppf((tail, 1 - tail), freedom) / freedom
        return (ratio - 1) / (high - 1 if ratio > 1 else 1 - low)


@dataclass(frozen=True, eq=False)
class Noise:
    """All readings, and the certificate of the light that was read."""

    readings: Sequence[Reading]
    certificates: dict[str, Certified]

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        signals = [one.signal_error / one.allowance for one in self.readings]
        allowed = f"of {SIGNAL_BAR:g} and what chance leaves"
        deviations = [one.deviation for one in self.readings if one.snr is not None]
        unit = "half-widths of its interval"
        name = f"SNR of {len(ISOS)} ISOs by exposure, against the equations (chi-square)"
        return [
            Bar.largest("signal by exposure and ISO, against equations 2 and 3", signals, 1.0,
                        allowed),
            Bar.largest(name, deviations, 1.0, unit),
        ]  # fmt: skip

    def worst(self, iso: int, exposure_s: float) -> Reading | None:
        """Return the channel whose signal is off by the largest part of its allowance."""
        own = [one for one in self.readings if (one.iso, one.exposure_s) == (iso, exposure_s)]
        return max(own, key=lambda one: abs(one.signal_error) / one.allowance, default=None)


def electrons_per_s(sensor: Sensor, predictor: Predictor) -> dict[str, float]:
    """Return equation 2's electrons per second of a grey scene on the axis, by channel."""
    scene, nm = make_scene("grey"), WAVELENGTHS_NM
    light = predictor.shown(np.zeros(1), nm)[:, 0]
    photons = scene.spectra[0] * light * nm * 1e-9 / (H_J_S * C_M_S)
    area = (sensor.pixel_pitch_um * 1e-6) ** 2 * sensor.fill_factor
    return {name: float(np.sum(sensor.qe[name] * photons) * 5.0 * area) for name in CHANNELS}


def measure_noise(lens: Prescription, predictor: Predictor) -> Noise:
    """Read an even field by exposure and ISO."""
    sensor = load_sensor(SENSOR).model_copy(update={"veiling_glare": 0.0})
    small = sensor.roi(SIDE_PX, SIDE_PX)
    light = expose(camera_of(STANDARD, lens, small), make_scene("grey"), TOLERANCE, probes=PROBES)
    rates = electrons_per_s(small, predictor)
    letters = np.array([list(row) for row in small.cfa.letters])
    readings = []
    for iso in ISOS:
        own = light.at(iso=iso).sensor
        for exposure in EXPOSURES_S:
            pair = [
                light.capture(exposure, iso=iso, seed=SEED, frame=number).raw.astype(float)
                for number in (0, 1)
            ]
            for name in CHANNELS:
                expected = _expected(own, rates[name], exposure)
                if expected is not None:
                    sites = [pair[k][_sites(letters, name, pair[k].shape)] for k in (0, 1)]
                    readings.append(
                        _read(name, iso, exposure, sites=sites, sensor=own, expected=expected)
                    )
    light.release()
    return Noise(readings, certificates_of({"noise": light}, TOLERANCE))


def _sites(letters: np.ndarray, name: str, shape: tuple[int, int]) -> np.ndarray:
    repeats = [-(-side // period) for side, period in zip(shape, letters.shape, strict=True)]
    return np.tile(letters == name, repeats)[: shape[0], : shape[1]]


def _expected(sensor: Sensor, rate: float, exposure_s: float) -> tuple[float, float | None] | None:
    """Return the signal, DN, and SNR by the equations.

    There is no SNR where all pixels saturate, and nothing where some may and some not: the minima
    and maxima of the paper's equations are those of one pixel, not of a mean.
    """
    gain, mean = sensor.system_gain_dn_per_e, rate * exposure_s
    dark = sensor.dark_current_e_per_s * exposure_s
    spread = np.sqrt(mean + (sensor.prnu_percent / 100 * mean) ** 2)
    if mean + dark - 6 * spread > sensor.saturation_e:
        top_dn = 2**sensor.bit_depth - 1 - sensor.black_level_dn
        return min(gain * sensor.full_well_e, top_dn), None
    if mean + dark + 6 * spread > sensor.saturation_e:
        return None
    variance = mean + dark + sensor.temporal_dark_noise_e**2 + 1 / (12 * gain**2)
    return gain * (mean + dark), float(mean / np.sqrt(variance))


def _read(
    name: str,
    iso: int,
    exposure_s: float,
    *,
    sites: Sequence[np.ndarray],
    sensor: Sensor,
    expected: tuple[float, float | None],
) -> Reading:
    """Measure a pair of frames of one channel."""
    signal = np.mean(sites) - sensor.black_level_dn
    dark = sensor.system_gain_dn_per_e * sensor.dark_current_e_per_s * exposure_s
    variance = np.var(sites[1] - sites[0], ddof=1) / 2
    snr = None if expected[1] is None else float((signal - dark) / np.sqrt(variance))
    # Standard uncertainty of the mean of both frames, fixed pattern included.
    u_signal = float(np.std(np.mean(sites, axis=0), ddof=1)) / np.sqrt(sites[0].size)
    given = float(signal), expected[0], float(u_signal), snr, expected[1]
    return Reading(name, iso, exposure_s, *given, sites[0].size)
