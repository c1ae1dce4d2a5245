"""The measurement's set-up on a simulated sensor: even light of one wavelength, no lens.

Every site of the filter pattern has the same light; what happens to it is the sensor's own stages,
as in a capture (:func:`gpusim.sensor.readout.record_readout`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import Device, Recording
from gpusim.metrics.dark import LEAST_TIMES
from gpusim.metrics.statistics import Accumulator, Level
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import Shot, SiteLight, record_readout
from gpusim.sensor.sensor import Sensor

SIDE_PX = 512  # of the region, at most
STACK = 64  # frames for the non-uniformities
EXPOSURE_S = 0.01
BEYOND = 1.1  # of the highest light, over what should saturate
LEVELS = 66  # evenly spaced up to there: 60 of them up to saturation
DARK_SIGNAL_E = 50.0  # that the longest dark frame should hold
LONGEST_S = 60.0
LEAST_STEPS = 16  # of the converter, and sigmas of dark noise, up to saturation

# Stages that move light or charge between pixels: the standard's camera (release 3.1, section 2)
# has none, and its figures are those of the pixels for themselves. The light comes in pulses, so
# that none falls while charge is shifted.
BETWEEN_PIXELS = (
    "crosstalk",
    "electrical crosstalk",
    "smear",
    "bloom",
    "parallel cti",
    "serial cti",
)


@dataclass(frozen=True)
class Light:
    """One light of the measurement, and how many frames it takes.

    Attributes
    ----------
    exposure_s : float
    photons : float
        Mean number per pixel in that time; 0 in the dark.
    wavelength_nm : float or None
        None in the dark.
    frames : int
    """

    exposure_s: float
    photons: float
    wavelength_nm: float | None
    frames: int


def region(sensor: Sensor, side_px: int = SIDE_PX) -> Sensor:
    """Return the part about the centre that is measured: whole filter patterns.

    Without its defect pixels, which the standard counts apart, and which no figure of it foresees.
    """
    step = math.lcm(*sensor.period)
    rows, cols = (
        max(step, min(side_px, side) // step * step) for side in (sensor.rows, sensor.cols)
    )
    return sensor.roi(rows, cols).model_copy(update={"defects": None})


def left_out(sensor: Sensor, runs: Callable[[str], bool]) -> str:
    """Return what of a sensor the measurement leaves out; nothing where that is nothing."""
    names = [name for name in BETWEEN_PIXELS if runs(name)]
    names += ["defect pixels"] if sensor.defects else []
    return f"; left out: {', '.join(names)}" if names else ""


def peak_nm(sensor: Sensor, channel: str) -> float:
    """Return the wavelength at which a channel responds most."""
    return float(WAVELENGTHS_NM[np.argmax(sensor.qe[channel])])


def lights(
    sensor: Sensor,
    *,
    levels: int = LEVELS,
    stack: int = STACK,
    exposure_s: float = EXPOSURE_S,
) -> list[Light]:
    """Return the lights of the measurement.

    For each wavelength at which a channel responds most: pairs of frames at evenly spaced levels up
    to beyond saturation, and a stack at half of it. In the dark: a stack and, for the dark current,
    pairs at evenly spaced exposure times.

    Raises
    ------
    UserError
        The sensor saturates in its own dark noise, or within few steps of its converter.
    """
    full = sensor.saturation_e
    steps, noise = full * sensor.system_gain_dn_per_e, sensor.temporal_dark_noise_e
    if steps < LEAST_STEPS or full < LEAST_STEPS * noise:
        raise UserError(
            "the sensor has no range for a photon transfer",
            field="full_well_e, bit_depth",
            value=f"{full:.3g} e- in {steps:.3g} DN, dark noise {noise:g} e-",
            allowed=f"{LEAST_STEPS} DN or more, and so many times the dark noise",
        )
    wanted = [Light(exposure_s, 0.0, None, stack)]
    longest = LONGEST_S
    if sensor.dark_current_e_per_s > 0:
        charge = min(max(DARK_SIGNAL_E, sensor.temporal_dark_noise_e**2), 0.2 * full)
        longest = min(longest, charge / sensor.dark_current_e_per_s)
    times = np.linspace(0, max(longest, 2 * exposure_s), LEAST_TIMES + 1)[1:]
    wanted += [Light(float(time), 0.0, None, 2) for time in times]
    for wavelength in dict.fromkeys(peak_nm(sensor, one) for one in sensor.channels):
        efficiency = max(
            sensor.qe[one].max() for one in sensor.channels if peak_nm(sensor, one) == wavelength
        )
        photons = full / float(efficiency)
        steps = np.arange(1, levels + 1) * BEYOND / levels
        wanted += [Light(exposure_s, float(photons * step), wavelength, 2) for step in steps]
        wanted.append(Light(exposure_s, 0.495 * photons, wavelength, stack))
    return wanted


def measure(
    sensor: Sensor,
    wanted: list[Light],
    device: Device,
    runs: Callable[[str], bool],
    *,
    seed: int,
    keep: Callable[[Light, int, np.ndarray], None] | None = None,
    progress: Callable[[str, int, int], None] = lambda phase, done, total: None,
) -> Iterator[Level]:
    """Take the frames of every light, and yield what is left of them: their statistics.

    Parameters
    ----------
    sensor : Sensor
        Or a region of it, of whole filter patterns.
    wanted : list of Light
    device : Device
    runs : callable
        Whether a stage runs, by its name in the plan; those BETWEEN_PIXELS do not in any case.
    seed : int
        Seed of the temporal noise; no two frames have the same.
    keep : callable, optional
        Called with each light, the number of the frame among all, and the frame: (rows, cols), u16.
    progress : callable, optional
        Called with (what, done, total).
    """
    frame, total = 0, sum(light.frames for light in wanted)
    for light in wanted:
        statistics = Accumulator(sensor.period)
        for _ in range(light.frames):
            taken = take(sensor, light, device, runs, seed=seed, frame=frame)
            statistics.add(taken)
            if keep is not None:
                keep(light, frame, taken)
            frame += 1
            progress("frames", frame, total)
        yield Level(light.exposure_s, light.photons, light.wavelength_nm, statistics.sites())


def take(
    sensor: Sensor,
    light: Light,
    device: Device,
    runs: Callable[[str], bool],
    *,
    seed: int,
    frame: int,
) -> np.ndarray:
    """Take one frame: (rows, cols), uint16, DN.

    Mean electrons per second of a photosite are eta mu_p / t (EMVA 1288 R3.1, section 2.1).
    """
    made = planes_of(sensor)
    rates = np.zeros(len(made.channels), np.float32)
    if light.photons:
        rates += [
            np.interp(light.wavelength_nm, WAVELENGTHS_NM, sensor.qe[sensor.channels[channel]])
            * light.photons
            / light.exposure_s
            for channel in made.channels
        ]
    rows, cols = (-(-side // made.period) for side in (sensor.rows, sensor.cols))
    rec = Recording(device)
    planes = rec.buffer("sites", (len(rates), rows, cols), np.float32)
    rec.upload(planes, np.broadcast_to(rates[:, None, None], planes.shape).copy())
    glare = rec.buffer("glare", (len(sensor.site_channels()),), np.float32)
    rec.clear(glare)
    whole = (0, 0, sensor.rows, sensor.cols)
    shot = Shot(light.exposure_s, seed, frame)
    outputs = record_readout(
        rec,
        SiteLight(planes, glare, whole),
        sensor,
        whole,
        shot=shot,
        runs=lambda name: name not in BETWEEN_PIXELS and runs(name),
    )
    label = rec.download(outputs["dn"])
    return rec.run()[label].astype(np.uint16)
