"""Cases of the sensor's levels: from no light to more than it holds, from 0 to the last code."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from gpusim.gpu import Recording, default_device
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.adc import record_adc
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise import record_noise
from gpusim.sensor.sensor import Sensor
from gpusim.stress.made import FLAT, camera_of, gaussian_bank, mono
from gpusim.stress.table import Case

QUIET = {
    "temporal_dark_noise_e": 0.0,
    "dsnu_e": 0.0,
    "prnu_percent": 0.0,
    "dark_current_e_per_s": 0.0,
}


def white() -> Scene:
    """Return an even white scene."""
    return Scene("white", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)


def raw_of(sensor: Sensor, exposure_s: float, tile_px: int | None = None) -> np.ndarray:
    """Return the raw (rows, cols) of an even white scene."""
    renderer = Renderer(camera_of(gaussian_bank(), sensor), white(), Accuracy(1e-3, 0))
    try:
        return np.array(renderer.capture(exposure_s, seed=3, tile_px=tile_px).raw)
    finally:
        renderer.release()


def read_out(rate: np.ndarray, sensor: Sensor, exposure_s: float, **of_exposure: object) -> tuple:
    """Return electrons and DN of rates (rows, cols) by the stages alone."""
    device = default_device()
    light = device.resident("rate", np.asarray(rate, np.float32))
    rec = Recording(device)
    mean = record_exposure(rec, light, sensor, exposure_s, **of_exposure)
    charge = record_noise(rec, mean, sensor, seed=5)
    labels = rec.download(charge), rec.download(record_adc(rec, charge, sensor))
    try:
        done = rec.run()
        return tuple(done[label].astype(np.float64) for label in labels)
    finally:
        light.destroy()


def code_of(electrons: float, sensor: Sensor) -> float:
    """Return the DN of a charge (EMVA 1288)."""
    level = sensor.system_gain_dn_per_e * electrons + sensor.black_level_dn
    return min(max(math.floor(level + 0.5), 0), 2**sensor.bit_depth - 1)


def even_code(raw: np.ndarray, code: float) -> tuple:
    """Return expected, got and whether all of a raw is one code."""
    return f"{code:g} DN everywhere", f"{raw.min():g} to {raw.max():g}", bool(np.all(raw == code))


def exposed(exposure_s: float) -> Callable[[], tuple]:
    """Return the case of an exposure time that fills every pixel, or none."""

    def case() -> tuple:
        sensor = mono(16, 24).model_copy(update={**QUIET, "full_well_e": 8000.0})
        light = 8000.0 if exposure_s > 1 else 0.0
        return even_code(raw_of(sensor, exposure_s), code_of(light, sensor))

    return case


def extreme_rates() -> tuple:
    """Take rates that no optics makes: below 0, infinite, beyond any count."""
    rate = np.float32([[-np.inf, -1e30, -1.0, 0.0, 1e30, 3e38, np.inf]])
    sensor = mono(8, 8).model_copy(update={**QUIET, "full_well_e": 5e4, "bit_depth": 16})
    charge, _ = read_out(rate, sensor, 1.0)
    wanted = np.float64([[0, 0, 0, 0, 5e4, 5e4, 5e4]])
    return "0 below 0, the full well above", str(charge[0]), np.array_equal(charge, wanted)


def hot_sensor() -> tuple:
    """Take a sensor at 196 degrees: dark current of 5e8 e-/s fills the well within a second."""
    sensor = mono(8, 8).model_copy(update={**QUIET, "dark_current_e_per_s": 1.0})
    charge, _ = read_out(np.zeros((4, 4)), sensor, 1.0, temperature_c=25 + 29 * 5.9)
    return (
        "the full well, 1e7 e-",
        f"{charge.min():g} to {charge.max():g}",
        bool(np.all(charge == 1e7)),
    )


def below_absolute_zero() -> tuple:
    """Cool a sensor to -1 K."""
    read_out(np.zeros((4, 4)), mono(8, 8), 1.0, temperature_c=-274.15)
    return "refused", "accepted", False


def clipped_at_black() -> tuple:
    """Read a dark frame without a black level: half of the noise is cut off, and none wraps."""
    changes = {**QUIET, "temporal_dark_noise_e": 50.0, "black_level_dn": 0.0}
    sensor = mono(8, 8).model_copy(update={**changes, "system_gain_dn_per_e": 1.0})
    _, dn = read_out(np.zeros((512, 512)), sensor, 1.0)
    # A normal number cut at 0: mean sigma / sqrt(2 pi), variance sigma^2 (1/2 - 1 / (2 pi)).
    mean = 50 / math.sqrt(2 * math.pi)
    sigma = 50 * math.sqrt((0.5 - 0.5 / math.pi) / dn.size)
    off = (dn.mean() - mean) / sigma
    got = f"{off:+.1f} sigma, at most {dn.max():g} DN"
    return (
        f"mean {mean:.2f} DN within 5 sigma, at most 400 DN",
        got,
        abs(off) < 5 and dn.max() < 400,
    )


def converter(bits: int) -> Callable[[], tuple]:
    """Return the case of a converter with so many bits that reads a ramp over all its codes."""

    def case() -> tuple:
        top = 2**bits - 1
        sensor = mono(8, 8).model_copy(
            update={
                "bit_depth": bits,
                "black_level_dn": 0.25 * top,
                "system_gain_dn_per_e": top / 1e5,
            }
        )
        ramp = np.float32(np.linspace(-3e4, 9e4, 2**17).reshape(256, -1))
        device = default_device()
        charge = device.resident("electrons", ramp)
        rec = Recording(device)
        label = rec.download(record_adc(rec, charge, sensor))
        try:
            dn = rec.run()[label].astype(np.float64)
        finally:
            charge.destroy()
        exact = ramp.astype(np.float64) * sensor.system_gain_dn_per_e + sensor.black_level_dn
        # Gain, product and sum round to 2^-24 each: 4 ULP of the largest code at most.
        off = np.abs(dn - np.clip(exact, 0, top)).max() - 0.5
        seen = np.unique(dn)
        every = seen.size == top + 1 and seen[0] == 0 and seen[-1] == top
        bound = 4 * 2.0**-24 * top
        got = f"{off:.1e} DN beyond a half, {seen.size} codes"
        return f"{top + 1} codes, rounded to {bound:.1e} DN", got, every and off <= bound

    return case


def tiles(rows: int, cols: int) -> Callable[[], tuple]:
    """Return the case of a Bayer sensor of an odd size in tiles of a few pixels: the same bits."""

    def case() -> tuple:
        sensor = load_sensor("imx477").roi(rows, cols)
        whole = raw_of(sensor, 0.01)
        parts = raw_of(sensor, 0.01, tile_px=max(2, min(rows, cols) // 3))
        same = int(np.sum(whole != parts))
        return (
            f"{rows} x {cols} pixels, no bit differs",
            f"{same} pixels differ",
            (same == 0 and whole.shape == (rows, cols)),
        )

    return case


CASES: tuple[Case, ...] = (
    ("exposure of 0 s", exposed(0.0), "exposure"),
    ("exposure of 1e-12 s", exposed(1e-12), None),
    ("exposure of 1e9 s", exposed(1e9), None),
    ("exposure without end", exposed(math.inf), "exposure"),
    ("rates below 0 and infinite", extreme_rates, None),
    ("sensor at 196 degrees", hot_sensor, None),
    ("sensor below absolute zero", below_absolute_zero, "-273.15"),
    ("dark frame without black level", clipped_at_black, None),
    ("converter of 1 bit", converter(1), None),
    ("converter of 16 bits", converter(16), None),
    ("Bayer sensor of one pixel", tiles(1, 1), None),
    ("Bayer sensor of 1 x 37", tiles(1, 37), None),
    ("Bayer sensor of 23 x 41 in tiles", tiles(23, 41), None),
)
