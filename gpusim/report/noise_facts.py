"""The EMVA 1288 data sheet as plain facts: what ``noise.json`` holds, and names and units."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gpusim.metrics.emva import Channel, Characterisation
from gpusim.metrics.figure import Figure
from gpusim.metrics.loop import COVERAGE, Row
from gpusim.metrics.nonuniformity import Pattern

# Name, symbol and unit of each figure, in the order of the standard's summary sheet.
OF_A_CHANNEL = {
    "quantum_efficiency": ("Quantum efficiency", "eta", "1"),
    "system_gain_dn_per_e": ("Overall system gain", "K", "DN/e-"),
    "responsivity_dn_per_photon": ("Responsivity", "R", "DN/photon"),
    "saturation_photons": ("Saturation", "mu_p.sat", "photons"),
    "saturation_e": ("Saturation capacity", "mu_e.sat", "e-"),
    "sensitivity_threshold_photons": ("Absolute sensitivity threshold", "mu_p.min", "photons"),
    "sensitivity_threshold_e": ("The same", "mu_e.min", "e-"),
    "snr_max": ("Highest signal-to-noise ratio", "SNR_max", "1"),
    "dynamic_range": ("Dynamic range", "DR", "1"),
    "linearity_error_min_percent": ("Linearity error", "LE_min", "%"),
    "linearity_error_max_percent": ("The same", "LE_max", "%"),
    "prnu_percent": ("Photo response non-uniformity", "PRNU", "%"),
    "prnu_pixel_percent": ("Its pixel part", "PRNU.pixel", "%"),
    "prnu_row_percent": ("Its row part", "PRNU.row", "%"),
    "prnu_column_percent": ("Its column part", "PRNU.col", "%"),
    "response_gain_dn_per_e": ("Noise of unlike pixels over signal", "K.prnu", "DN/e-"),
}
IN_THE_DARK = {
    "temporal_dark_noise_dn": ("Temporal dark noise", "sigma_y.dark", "DN"),
    "temporal_dark_noise_e": ("The same", "sigma_d", "e-"),
    "row_noise_e": ("Shared by rows", "sigma_d.row", "e-"),
    "column_noise_e": ("Shared by columns", "sigma_d.col", "e-"),
    "dark_current_e_per_s": ("Dark current, from the mean", "mu_I.mean", "e-/s"),
    "dark_current_variance_e_per_s": ("Dark current, from the variance", "mu_I.var", "e-/s"),
    "dsnu_e": ("Dark signal non-uniformity", "DSNU", "e-"),
    "dsnu_pixel_e": ("Its pixel part", "DSNU.pixel", "e-"),
    "dsnu_row_e": ("Its row part", "DSNU.row", "e-"),
    "dsnu_column_e": ("Its column part", "DSNU.col", "e-"),
}


def noise_facts(found: Characterisation, rows: Sequence[Row] | None) -> dict[str, Any]:
    """Return the data sheet as JSON has it: numbers, lists, texts.

    Parameters
    ----------
    found : Characterisation
    rows : sequence of Row, optional
        The loop's verdicts, where the frames are of a simulated sensor.
    """
    facts = {
        "standard": "EMVA 1288 R3.1, and R4.0 Linear for rows, columns and pixels",
        "uncertainties": "standard (k = 1), statistical",
        "channels": [_channel(one) for one in found.channels],
        "all_pixels": {
            "figures": _figures(found.figures),
            "series": {name: values.tolist() for name, values in vars(found.series).items()},
            "dark_stack": _pattern(found.dark),
        },
        "notes": list(found.notes),
    }
    if rows is not None:
        facts["coverage_factor"] = COVERAGE
        facts["verdicts"] = [dataclasses.asdict(row) for row in rows]
        facts["outside"] = sum(not row.within for row in rows)
    return facts


def noise_rows(found: Characterisation) -> Iterator[Sequence[object]]:
    """Yield the lines of the CSV file: the photon transfer of each channel, level by level."""
    of = ("mean", "variance", "dark_mean", "dark_variance")
    units = [f"{name}_{'dn2' if 'variance' in name else 'dn'}" for name in of]
    beside = [name for unit in units for name in (unit, f"u_{unit}")]
    yield ["channel", "exposure_s", "photons", *beside]
    for channel in found.channels:
        transfer = channel.transfer
        for at, photons in enumerate(transfer.photons):
            values = (
                value
                for name in of
                for value in (
                    getattr(transfer, name)[at],
                    math.sqrt(getattr(transfer, f"{name}_u2")[at]),
                )
            )
            yield [
                channel.name, f"{transfer.exposure_s[at]:.9g}", f"{photons:.9g}",
                *(f"{value:.9g}" for value in values),
            ]  # fmt: skip


def _figures(figures: Mapping[str, Figure]) -> dict[str, dict[str, float]]:
    return {
        name: {key: value for key, value in vars(one).items() if value is not None}
        for name, one in figures.items()
    }


def _channel(channel: Channel) -> dict[str, Any]:
    line = channel.linearity
    return {
        "name": channel.name,
        "wavelength_nm": channel.wavelength_nm,
        "pixels": channel.pixels,
        "figures": _figures(channel.figures),
        "transfer": {name: values.tolist() for name, values in vars(channel.transfer).items()},
        "outliers": [dataclasses.asdict(one) for one in channel.outliers],
        "linearity": {
            "offset_dn": line.offset_dn,
            "slope_dn": line.slope_dn,
            "fitted": line.fitted.tolist(),
            "deviation_percent": line.deviation_percent.tolist(),
        },
        "bright_stack": _pattern(channel.bright),
    }


def _pattern(pattern: Pattern | None) -> dict[str, Any] | None:
    if pattern is None:
        return None
    return {
        "frames": pattern.frames,
        "photons": pattern.photons,
        "exposure_s": pattern.exposure_s,
        "mean_dn": pattern.mean,
        "residual_dn2": pattern.residual_dn2,
        "spatial_dn2": vars(pattern.spatial),
    }


def number(value: float, uncertainty: float) -> str:
    """Return a number with as many places as its uncertainty has, and two digits of that."""
    if not uncertainty:
        return f"{value:.6g}"
    places = max(0, 1 - _exponent(uncertainty))
    return f"{value:.{places}f}" if places < 10 else f"{value:.3g}"


def two_digits(uncertainty: float) -> str:
    """Return an uncertainty with two digits: 780, 0.052, 6.4e-05."""
    return f"{float(f'{uncertainty:.1e}'):g}"


def _exponent(value: float) -> int:
    return int(f"{value:.1e}".partition("e")[2])
