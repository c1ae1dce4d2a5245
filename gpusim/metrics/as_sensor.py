"""The sensor file of a measured camera: what EMVA 1288's figures say, in the fields of a sensor.

Real cameras are not quite linear: what the converter reads bends by a per cent or two. The mean
signal against the light, a polynomial, gives its form, and where it bends the file gets it as its
``linearity``. One number is left, the quantum efficiency: a signal S(mu_p) that is bent after the
charge has collected has the temporal variance

    sigma^2 = sigma_dark^2 + (dS / d mu_p)^2 mu_p / eta,

to which eta is fitted; K is the response in the dark, (dS / d mu_p)(0) / eta. A pixel that responds
by 1 + r as much has the signal S((1 + r) mu_p): its PRNU is what the standard finds over
(mu_p / S) (dS / d mu_p). Where the response is straight, these are the figures of the standard.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Polynomial

from gpusim.metrics.dark import QUANTISATION_DN2
from gpusim.metrics.emva import Channel, Characterisation
from gpusim.metrics.figure import Figure
from gpusim.metrics.frames import Frames
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

DEGREE = 4  # of the response: its two per cent over 37 levels of a real camera, to 0.03 %
STRAIGHT_PERCENT = 0.1  # a response that bends less is written as straight
POINTS = 17
BEYOND = 1.1  # of saturation, where the response ends
HIGHEST = 0.97  # of the signal at saturation: beyond, levels clip in part
CLIPPED = 0.25  # of a step: levels this near the highest code are the converter's own clipping
UNKNOWN_PITCH_UM = 5.0
MEASURED = "measured by EMVA 1288"
ASSUMED = {
    "fill_factor": "assumed: of no consequence to frames of even light",
    "reference_temperature_c": "assumed: that of the measurement",
    "doubling_temperature_c": "assumed: dark current of silicon about doubles each 6 K",
    "veiling_glare": "the sensor by itself: no lens",
}


def as_sensor(found: Characterisation, frames: Frames, size: tuple[int, int]) -> Sensor:
    """Return the sensor that was measured.

    Parameters
    ----------
    found : Characterisation
        Figures of one channel, or of several whose gain and noise are then taken as one.
    frames : Frames
    size : (int, int)
        Rows and columns of the frames.
    """
    most = max(float(one.transfer.mean.max()) for one in found.channels)
    bits = frames.bit_depth or max(1, math.ceil(math.log2(most + 1)))
    first = found.channels[0]
    response, eta = _response(first)
    gain = float(response.deriv()(0.0)) / eta
    figures = found.figures
    noise2 = {
        part: max(figures[f"{part}_noise_e"].square or 0.0, 0.0) for part in ("row", "column")
    }
    scale = found.figures["system_gain_dn_per_e"].value / gain  # figures in e- are by K
    dark2 = figures["temporal_dark_noise_dn"].value ** 2 - QUANTISATION_DN2
    pixel2 = dark2 / gain**2 - scale**2 * sum(noise2.values())
    of = {name: scale * _value(figures, f"dsnu_{name}_e") for name in ("pixel", "row", "column")}
    black = float(found.series.mean[np.argmin(found.series.exposure_s)])
    bent = _linearity(response, eta, gain, first)
    steeper = 1.0 if bent is None else _steepness(response, first)
    prnu = {
        name: _value(first.figures, f"prnu_{name}_percent") / steeper
        for name in ("pixel", "row", "column")
    }
    full, says = _full_well(first, bits, black, gain=gain, eta=eta, bent=bent)
    fields = {
        "name": frames.name,
        "rows": size[0],
        "cols": size[1],
        "pixel_pitch_um": frames.pixel_pitch_um or UNKNOWN_PITCH_UM,
        "fill_factor": 1.0,
        "cfa": {"pattern": [list(row) for row in frames.pattern]},
        "quantum_efficiency": _efficiency(found, eta),
        "system_gain_dn_per_e": gain,
        "black_level_dn": black,
        "bit_depth": bits,
        "full_well_e": full,
        "temporal_dark_noise_e": math.sqrt(max(pixel2, 0.0)),
        "dark_current_e_per_s": max(scale * _value(figures, "dark_current_e_per_s"), 0.0),
        "reference_temperature_c": 25.0,
        "doubling_temperature_c": 6.0,
        "dsnu_e": of["pixel"],
        "prnu_percent": prnu["pixel"],
        "veiling_glare": 0.0,
        "lines": _lines(prnu, of, {part: scale * math.sqrt(noise2[part]) for part in noise2}),
        "sources": _sources(frames, first.wavelength_nm, says),
    }
    if bent is not None:
        fields["linearity"] = bent
        fields["sources"]["linearity"] = f"{MEASURED}: the mean signal against the light"
    return Sensor.model_validate(fields)


def _lines(
    prnu_percent: dict[str, float], dsnu_e: dict[str, float], noise_e: dict[str, float]
) -> dict[str, float]:
    """Return what whole rows and columns have."""
    return {
        "prnu_row_percent": prnu_percent["row"],
        "prnu_column_percent": prnu_percent["column"],
        "dsnu_row_e": dsnu_e["row"],
        "dsnu_column_e": dsnu_e["column"],
        "row_noise_e": noise_e["row"],
        "column_noise_e": noise_e["column"],
    }


def _sources(frames: Frames, wavelength_nm: float | None, full_well: str) -> dict[str, str]:
    """Return where each field comes from."""
    light = "" if wavelength_nm is None else f" at {wavelength_nm:g} nm"
    return ASSUMED | {
        "pixel_pitch_um": "as the list of frames says"
        if frames.pixel_pitch_um
        else "assumed: the list of frames does not say it",
        "quantum_efficiency": f"{MEASURED}{light}; taken as the same at all wavelengths",
        "system_gain_dn_per_e": f"{MEASURED}; the response in the dark",
        "black_level_dn": f"{MEASURED}: mean of the shortest dark frames",
        "full_well_e": full_well,
        **dict.fromkeys(
            ("temporal_dark_noise_e", "dark_current_e_per_s", "dsnu_e", "prnu_percent", "lines"),
            MEASURED,
        ),
    }


def _value(figures: dict[str, Figure], name: str) -> float:
    return figures[name].value if name in figures else 0.0


def _response(channel: Channel) -> tuple[Polynomial, float]:
    """Return the signal in DN over the photons, and the quantum efficiency."""
    transfer = channel.transfer
    fitted = transfer.between(-np.inf, HIGHEST)
    photons, signal = transfer.photons[fitted], transfer.signal[fitted]
    degree = DEGREE if photons.size > 4 * DEGREE else 1
    unit = photons.max()
    design = (photons[:, None] / unit) ** np.arange(1, degree + 1)  # no light, no signal
    # Lamps wander in proportion to the light; the root weighs the lowest levels as well.
    root = 1 / np.sqrt(photons)
    found, *_ = np.linalg.lstsq(design * root[:, None], signal * root, rcond=None)
    response = Polynomial([0.0, *(found / unit ** np.arange(1, degree + 1))])
    shape = response.deriv()(photons) ** 2 * photons
    excess = (transfer.variance - transfer.dark_variance)[fitted]
    # Each level counts by the same share: a level of many frames is not more of the camera.
    weight = 1 / shape**2
    return response, float(np.sum(weight * shape**2) / np.sum(weight * shape * excess))


def _steepness(response: Polynomial, channel: Channel) -> float:
    """Return d ln S / d ln mu_p where the PRNU was measured."""
    if channel.bright is None:
        return 1.0
    photons = channel.bright.photons
    return float(photons * response.deriv()(photons) / response(photons))


def _linearity(
    response: Polynomial, eta: float, gain: float, channel: Channel
) -> dict[str, list[float]] | None:
    """Return electrons and what is read of them; None where that is straight."""
    transfer = channel.transfer
    top = float(transfer.photons[transfer.between(-np.inf, HIGHEST)].max())
    photons = np.linspace(0.0, top, POINTS)
    electrons, read = eta * photons, response(photons) / gain
    if np.abs(read[1:] / electrons[1:] - 1).max() < STRAIGHT_PERCENT / 100:
        return None
    # Beyond the levels it runs straight on.
    slope = float(response.deriv()(top)) / gain / eta
    last = BEYOND * eta * float(transfer.photons[-1])
    electrons = np.append(electrons, max(last, BEYOND * electrons[-1]))
    read = np.append(read, read[-1] + slope * (electrons[-1] - electrons[-2]))
    return {"electrons": electrons.tolist(), "read_e": read.tolist()}


def _full_well(
    channel: Channel,
    bits: int,
    black: float,
    *,
    gain: float,
    eta: float,
    bent: dict[str, list[float]] | None,
) -> tuple[float, str]:
    """Return the full well, electrons, and how it is known."""
    transfer = channel.transfer
    top = float(transfer.mean.max())
    if top > 2**bits - 1 - CLIPPED:
        # Beyond what the converter reads: the charge of the brightest level is enough.
        return eta * float(transfer.photons[-1]), "at least: the converter clips below it"
    read = (top - black) / gain
    full = read if bent is None else float(np.interp(read, bent["read_e"], bent["electrons"]))
    return full, "measured: the mean of saturated levels"


def _efficiency(found: Characterisation, eta: float) -> dict:
    """Return the quantum efficiency of each channel, even over the wavelengths."""
    first = found.channels[0].figures["responsivity_dn_per_photon"].value
    ends = [float(WAVELENGTHS_NM[0]), float(WAVELENGTHS_NM[-1])]
    return {
        "wavelengths_nm": ends,
        "channels": {
            one.name: [eta * one.figures["responsivity_dn_per_photon"].value / first] * 2
            for one in found.channels
        },
    }
