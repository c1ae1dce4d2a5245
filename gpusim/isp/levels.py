"""Levels of a sensor's raw: black, saturation, the straight line between them, and its noise."""

from __future__ import annotations

import math

import numpy as np

from gpusim.scene.spectra import QUADRATURE_NM, WAVELENGTHS_NM, white_radiance
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.sensor import Sensor

MAX_CODE = 65535
# Sigmas of what the read-out adds, by which the white level lies below the mean code of a full
# well: of such pixels 1 in 741 has a lower code.
SATURATED_SIGMAS = 3.0
QUANTISATION_DN2 = 1 / 12  # variance of rounding
# ISO 12232:2019, 6.2: S_sat = 78 / H_sat, so that a diffuser of 18 % has 12.7 % of saturation.
ISO_SATURATION_LX_S = 78.0
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0  # exact in the SI of 2019


def saturation_dn(sensor: Sensor) -> int:
    """Return the code from which on a pixel is saturated.

    It is the highest one, or if lower that of a full well less `SATURATED_SIGMAS` of what read-out
    and fixed offsets spread it by, but not less than that of half a well.
    """
    lines = sensor.lines or LineNoise()
    last = sensor if sensor.dual_gain is None else sensor.at_low_gain()
    offset_dn = sensor.column_offset.sigma_dn if sensor.column_offset is not None else None
    spread_e = math.hypot(
        _read_noise_e(last, None),
        sensor.dsnu_e,
        lines.dsnu_row_e,
        lines.dsnu_column_e,
        (offset_dn or 0.0) / sensor.system_gain_dn_per_e,
    )
    full_e = sensor.full_well_e
    least_e = max(full_e - SATURATED_SIGMAS * spread_e, full_e / 2)
    if sensor.linearity is not None:
        least_e = float(sensor.linearity.read(least_e))
    full = sensor.black_level_dn + sensor.system_gain_dn_per_e * least_e
    return min(sensor.raw_max_dn, math.floor(full))


def saturated_share(raw: np.ndarray, sensor: Sensor) -> float:
    """Return the share of the pixels of a raw frame that are saturated, 0..1."""
    return float(np.mean(raw >= saturation_dn(sensor)))


def linear_dn(sensor: Sensor, codes: np.ndarray) -> np.ndarray:
    """Return what a linear converter would have given in place of some codes, DN."""
    if sensor.linearity is None:
        return np.asarray(codes, np.float64)
    black, gain = sensor.black_level_dn, sensor.system_gain_dn_per_e
    return black + gain * sensor.linearity.collected((codes - black) / gain)


def span_dn(sensor: Sensor) -> float:
    """Return the signal of a saturated pixel of a linear converter, DN."""
    return float(linear_dn(sensor, saturation_dn(sensor))) - sensor.black_level_dn


def linearization_table(sensor: Sensor) -> tuple[np.ndarray, int]:
    """Return what DNG's LinearizationTable makes of each code, and by how much it is scaled.

    The scale is the largest that fits 16 bits, so that rounding takes nothing from the raw. Where
    channels have black levels of their own the table is that of ``black_level_dn``.
    """
    linear = np.maximum(linear_dn(sensor, np.arange(sensor.raw_max_dn + 1)), 0)
    scale = max(1, int(MAX_CODE / linear.max()))
    return np.minimum(np.round(scale * linear), MAX_CODE).astype(np.uint16), scale


def noise_profile(sensor: Sensor, temperature_c: float | None = None) -> tuple[float, float]:
    """Return DNG's NoiseProfile (S, O): the variance is S x + O where x = 0 is black and 1 white.

    The line follows EMVA 1288's linear camera model, in DN^2: sigma^2 = K^2 sigma_d^2 + 1/12 + K
    (mu - black). The noise of resets, rows and columns is part of sigma_d. Where two numbers give
    the noise, the second is the variance for each electron. With two merged reads the line runs
    from the noise of the first one in the dark to that of the second one at saturation. Between
    these ends it is off by less than the difference of their read noise.

    Parameters
    ----------
    sensor : Sensor
    temperature_c : float, optional
        The sensor's temperature, on which its reset noise depends.
    """
    span, gain = span_dn(sensor), sensor.system_gain_dn_per_e
    per_e = sensor.gaussian_variance_per_e
    scale = gain * (1.0 if per_e is None else per_e) / span
    dark = _dark_variance_dn2(sensor, temperature_c) / span**2
    if sensor.dual_gain is None:
        return scale, dark
    low = sensor.at_low_gain()
    ratio = gain / low.system_gain_dn_per_e
    bright = ratio**2 * _dark_variance_dn2(low, temperature_c) / span**2
    return scale + bright - dark, dark


def _dark_variance_dn2(sensor: Sensor, temperature_c: float | None) -> float:
    """Return the temporal variance without signal, rounding included."""
    noise_dn = sensor.system_gain_dn_per_e * _read_noise_e(sensor, temperature_c)
    return noise_dn**2 + QUANTISATION_DN2


def _read_noise_e(sensor: Sensor, temperature_c: float | None) -> float:
    """Return the temporal noise that does not depend on the signal, electrons."""
    lines = sensor.lines or LineNoise()
    return math.hypot(
        sensor.temporal_dark_noise_e,
        sensor.reset_noise_at(temperature_c),
        lines.row_noise_e,
        lines.column_noise_e,
    )


def iso_speed(sensor: Sensor) -> int:
    """Return the ISO speed: what the sensor's file calls its gain, or the saturation-based one.

    That is ISO 12232's, in daylight (D55): 78 over the exposure, lx s, that saturates the channel
    that saturates first. One of 1 to 65535, as Exif counts.
    """
    if sensor.iso is not None:
        return sensor.iso
    light = white_radiance("D55", 1.0)
    photons = light * WAVELENGTHS_NM * 1e-9 / (PLANCK_J_S * LIGHT_M_S) * QUADRATURE_NM
    area_m2 = sensor.fill_factor * (sensor.pixel_pitch_um * 1e-6) ** 2
    # An even surround of 1 cd/m^2 makes pi lux, and pi times the irradiance of its radiance.
    electrons_per_lx_s = area_m2 * max(float(qe @ photons) for qe in sensor.qe.values())
    speed = ISO_SATURATION_LX_S * electrons_per_lx_s / sensor.saturation_e
    return min(max(round(speed), 1), MAX_CODE)
