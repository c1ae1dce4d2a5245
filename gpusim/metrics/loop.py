"""Closing the loop: what the measurement should find on a simulated sensor, and whether it did.

A figure of the sensor file is what should be found, except where the measurement cannot see it: a
maximum of the temporal variance lies below the charge at which pixels clip, and a converter whose
steps are coarser than the noise, or whose black level is 0, shows another noise. There the expected
figure comes from the law of a pixel's digital numbers, integrated here in float64, and the row says
why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from gpusim.metrics.dark import LEAST_DARK_VARIANCE_DN2, QUANTISATION_DN2
from gpusim.metrics.emva import UNDERFLOW_SHARE, Channel, Characterisation
from gpusim.metrics.figure import Figure, line
from gpusim.metrics.law import PixelLaw
from gpusim.metrics.photon_transfer import DRAWS, Transfer
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.noise_model import LineNoise
from gpusim.sensor.sensor import Sensor

COVERAGE = 3  # k: 99.7 % of normal deviations lie within
ROUNDING = 1e-9  # of a figure without noise: of the sums that it is made of
SMALLEST = 1e-6  # e-^2, %^2: variances that matter to nobody, where no pixel of an array shows one
# Rounding is as good as independent noise of 1/12 DN^2 where the noise is wider than half a step:
# its variance is then off by less than 1 % (B. Widrow & I. Kollar, Quantization Noise, 2008).
COARSE_DN = 0.5


@dataclass(frozen=True)
class Row:
    """One parameter: what it is, what should be found, what was found.

    Attributes
    ----------
    parameter : str
        EMVA's symbol, with the channel where it is of one.
    unit : str
    data_sheet : float
        Value that the sensor file gives.
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
        What was found from frames of this sensor.
    sensor : Sensor
    """
    exposure_s = float(found.channels[0].transfer.exposure_s[0])
    says = _Parameters.of(sensor, exposure_s)
    reason = _why(sensor, says, exposure_s)
    table = []
    for channel in found.channels:
        of = f" {channel.name}" if len(found.channels) > 1 else ""
        table += _of_channel(channel, sensor, says, of, reason)
    unlike = found.figures.get("response_gain_dn_per_e")
    if unlike is not None and not reason:
        gain = sensor.system_gain_dn_per_e
        table.append(_row("K of unlike pixels", "DN/e-", gain, gain, unlike))
    gains = [row.expected for row in table if row.parameter.startswith("K")]
    return table + _in_the_dark(found, sensor, says, reason, float(np.mean(gains)))


@dataclass(frozen=True)
class _Parameters:
    """What the sensor file says, as the standard counts it: whole arrays, rows and columns apart.

    Attributes
    ----------
    noise_e : float
        Temporal dark noise without dark current, of pixels, rows, columns and reset together.
    row_noise_e, column_noise_e : float
    response : float
        Mean of the multiplicative mask.
    prnu_percent, dsnu_e : dict of str to float
        ``pixel``, ``row`` and ``column`` parts; masks and the spread of dark currents are pixels'.
    """

    noise_e: float
    row_noise_e: float
    column_noise_e: float
    response: float
    prnu_percent: dict[str, float]
    dsnu_e: dict[str, float]

    @classmethod
    def of(cls, sensor: Sensor, exposure_s: float) -> _Parameters:
        """Read a sensor file, for dark frames of an exposure time."""
        lines = sensor.lines or LineNoise()
        parts = (sensor.temporal_dark_noise_e, sensor.reset_noise_at(None))
        columns_e = _column_offsets_dn(sensor) / sensor.system_gain_dn_per_e
        mask, offsets_e = _mask(sensor, "gain"), _mask(sensor, "offset_e")
        currents_e = sensor.dcnu_percent / 100 * sensor.dark_current_e_per_s * exposure_s
        return cls(
            noise_e=math.hypot(*parts, lines.row_noise_e, lines.column_noise_e),
            response=float(mask.mean()),
            row_noise_e=lines.row_noise_e,
            column_noise_e=lines.column_noise_e,
            prnu_percent={
                "pixel": math.hypot(sensor.prnu_percent, 100 * mask.std() / mask.mean()),
                "row": lines.prnu_row_percent,
                "column": lines.prnu_column_percent,
            },
            dsnu_e={
                "pixel": math.hypot(sensor.dsnu_e, offsets_e.std(), currents_e),
                "row": lines.dsnu_row_e,
                "column": math.hypot(lines.dsnu_column_e, columns_e),
            },
        )

    @property
    def prnu(self) -> float:
        """PRNU of all parts together, per cent."""
        return math.hypot(*self.prnu_percent.values())

    @property
    def dsnu(self) -> float:
        """DSNU of all parts together, electrons."""
        return math.hypot(*self.dsnu_e.values())


def _law(sensor: Sensor, says: _Parameters, channel: str) -> PixelLaw:
    """Return the law of the pixels of a channel."""
    black_dn = (sensor.channel_black_level_dn or {}).get(channel, sensor.black_level_dn)
    return PixelLaw(sensor, black_dn, says.noise_e, says.dsnu, says.prnu)


def _of_channel(
    channel: Channel, sensor: Sensor, says: _Parameters, of: str, reason: str
) -> list[Row]:
    figures, transfer = channel.figures, channel.transfer
    sheet = float(np.interp(channel.wavelength_nm, WAVELENGTHS_NM, sensor.qe[channel.name]))
    efficiency, gain = says.response * sheet, sensor.system_gain_dn_per_e
    law = _law(sensor, says, channel.name)
    dark_e = transfer.exposure_s * sensor.dark_current_e_per_s
    mean, variance = law.levels(efficiency * transfer.photons, dark_e)
    expected = {"gain": gain, "efficiency": efficiency, "prnu": says.prnu}
    if reason:
        ideal = replace(transfer, mean=mean, variance=variance)
        expected |= _by_law(law, ideal, dark_e)
        if channel.bright is not None:
            light = efficiency * channel.bright.photons
            expected["prnu"] = law.response_percent(light, float(dark_e[0]))
    masked = "" if says.response == 1 else f"the mask passes {says.response:.4g} of the light"
    found = [
        _row(
            f"K{of}",
            "DN/e-",
            gain,
            expected["gain"],
            figures["system_gain_dn_per_e"],
            reason=reason,
        ),
        _row(
            f"eta{of} at {channel.wavelength_nm:g} nm",
            "1",
            sheet,
            expected["efficiency"],
            figures["quantum_efficiency"],
            reason=_both(reason, masked),
        ),
    ]
    found.append(_saturation(f"mu_e.sat{of}", channel, sensor, expected["efficiency"], variance))
    if "prnu_percent" in figures:
        others = "" if says.prnu == sensor.prnu_percent else "rows, columns and masks are in it"
        found.append(
            _row(
                f"PRNU{of}",
                "%",
                sensor.prnu_percent,
                expected["prnu"],
                figures["prnu_percent"],
                reason=_both(reason, others),
            )
        )
        if not reason:
            found += _parts(f"PRNU{of}", "%", says.prnu_percent, figures, "prnu_{}_percent")
    return found


def _saturation(
    name: str, channel: Channel, sensor: Sensor, efficiency: float, variance: np.ndarray
) -> Row:
    """Judge where the variance of levels, DN^2, is highest."""
    transfer, full = channel.transfer, channel.figures["saturation_e"]
    draws = np.random.default_rng(1289).standard_normal((DRAWS, variance.size))
    tops = (variance + np.sqrt(transfer.variance_u2) * draws).argmax(axis=1)
    capacity = efficiency * transfer.photons[tops]
    clips = sensor.saturation_e
    first = "well is full" if clips == sensor.full_well_e else f"converter ends, at {clips:.0f} e-"
    return _row(
        name,
        "e-",
        sensor.full_well_e,
        float(capacity.mean()),
        Figure(full.value, math.hypot(full.u, float(capacity.std()))),
        reason=f"the variance is highest a little before the {first}",
    )


def _by_law(law: PixelLaw, lit: Transfer, dark_e: np.ndarray) -> dict[str, float]:
    """Return the gain and the efficiency that the standard finds of a law's lit levels."""
    black, black_variance = law.levels(np.zeros_like(dark_e), dark_e)
    ideal = replace(lit, dark_mean=black, dark_variance=black_variance)
    none = np.zeros_like(ideal.mean)
    gain, _ = ideal.slope(ideal.variance - black_variance, ideal.signal, none, none)
    slope, _ = ideal.slope(ideal.signal, ideal.photons, none, none)
    return {"gain": gain, "efficiency": slope / gain}


def _parts(
    name: str, unit: str, says: Mapping[str, float], figures: Mapping[str, Figure], key: str
) -> list[Row]:
    """Judge the parts of a non-uniformity, where rows or columns have one."""
    if not (says["row"] or says["column"]):
        return []
    return [
        _row(f"{name}.{short}", unit, says[part], says[part], figures[key.format(part)])
        for part, short in (("pixel", "pixel"), ("row", "row"), ("column", "col"))
    ]


def _in_the_dark(
    found: Characterisation, sensor: Sensor, says: _Parameters, reason: str, gain: float
) -> list[Row]:
    """Judge what all photosites give; `gain` is the K that DN become electrons with."""
    figures = found.figures
    noise, offsets = says.noise_e, says.dsnu
    sheet = current = spread = sensor.dark_current_e_per_s
    if reason:
        law = _law(sensor, says, found.channels[0].name)
        times = found.series.exposure_s
        mean, variance = law.levels(np.zeros_like(times), times * sheet)
        current = line(times, mean, found.series.mean_u2)[1].value / gain
        start, slope = line(times, variance, found.series.variance_u2)
        spread = slope.value / gain**2
        least = max(start.value, LEAST_DARK_VARIANCE_DN2)
        noise = math.sqrt(least - QUANTISATION_DN2) / gain
        exposure_s = found.dark.exposure_s if found.dark else 0.0
        offsets = law.offset_spread_dn(exposure_s * sheet) / gain
    # The array is a sample of the type: its dark currents have a mean of their own.
    pixels = sum(channel.pixels for channel in found.channels)
    sample = sheet * sensor.dcnu_percent / 100 / math.sqrt(pixels)
    more = (
        "" if says.noise_e == sensor.temporal_dark_noise_e else "reset, rows and columns add to it"
    )
    others = "" if says.dsnu == sensor.dsnu_e else "rows, columns, masks or dark currents add to it"
    shown = [
        ("sigma_d", "e-", sensor.temporal_dark_noise_e, noise, more, "temporal_dark_noise_e"),
        ("mu_I (mean)", "e-/s", sheet, current, "", "dark_current_e_per_s"),
        ("mu_I (variance)", "e-/s", sheet, spread, "", "dark_current_variance_e_per_s"),
        ("DSNU", "e-", sensor.dsnu_e, offsets, others, "dsnu_e"),
    ]
    rows = []
    for name, unit, given, expected, why, key in shown:
        if key in figures:
            figure = figures[key]
            if unit == "e-/s":
                figure = Figure(figure.value, math.hypot(figure.u, sample))
            rows.append(_row(name, unit, given, expected, figure, reason=_both(reason, why)))
    if not reason:
        for name, given in (("row", says.row_noise_e), ("column", says.column_noise_e)):
            if given:
                key = f"{name}_noise_e"
                rows.append(_row(f"sigma_d.{name[:3]}", "e-", given, given, figures[key]))
        if "dsnu_e" in figures:
            rows += _parts("DSNU", "e-", says.dsnu_e, figures, "dsnu_{}_e")
    return rows


def _both(*reasons: str) -> str:
    """Return the reasons that there are."""
    return "; ".join(filter(None, reasons))


def _mask(sensor: Sensor, name: str) -> np.ndarray:
    """Return a mask of the sensor: (rows, cols), or of one value where it has none."""
    if sensor.masks is None or getattr(sensor.masks, name) is None:
        return np.full((1, 1), 1.0 if name == "gain" else 0.0)
    place = sensor.lit_place(sensor.frame.on_chip(sensor.frame.lit))
    return sensor.masks.part(name, place, (sensor.rows, sensor.cols)).astype(np.float64)


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
    parameter: str, unit: str, sheet: float, expected: float, figure: Figure, *, reason: str = ""
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


def _why(sensor: Sensor, says: _Parameters, exposure_s: float) -> str:
    """Return why the digital numbers do not follow the linear camera; empty where they do."""
    gain = sensor.system_gain_dn_per_e
    dark_e = exposure_s * sensor.dark_current_e_per_s
    noise = gain * math.hypot(says.noise_e, math.sqrt(dark_e))
    spread = math.hypot(noise, gain * says.dsnu)
    reasons = []
    if sensor.gaussian_variance_per_e is not None:
        per_e = sensor.gaussian_variance_per_e
        reasons.append(f"the temporal noise is not Poisson's: {per_e:g} e-^2 for each electron")
    if sensor.dual_gain is not None:
        reasons.append(f"from {sensor.dual_gain.switch_dn} DN on the read at low gain counts")
    if sensor.full_well_knee < 1:
        reasons.append(f"the well fills ever more slowly from {sensor.full_well_knee:.0%} of it on")
    if sensor.linearity is not None:
        low, high = sensor.linearity.error_percent(sensor.saturation_e)
        reasons.append(f"the response is off a straight line by {low:+.2g} to {high:+.2g} %")
    if noise < COARSE_DN:
        reasons.append(f"the dark noise of {noise:.2g} DN is finer than the converter's steps")
    level = min(sensor.site_black_dn) + gain * dark_e
    if spread and ndtr((0.5 - level) / spread) > UNDERFLOW_SHARE:
        reasons.append(f"the black level of {sensor.black_level_dn:g} DN lets the converter clip")
    return "; ".join(reasons)


def failed(table: Sequence[Row]) -> int:
    """Return how many parameters fall outside."""
    return sum(not row.within for row in table)
