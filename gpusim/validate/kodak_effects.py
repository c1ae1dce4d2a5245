"""The full camera of Short, Williams & Jones (1999), section 2: effects on and off, and their laws.

The squares of figure 7 stand before the stand-in lens and the paper's sensor, of which every effect
is off. Each effect is then switched on alone. What it does is held against its law, worked out here
from the picture without it, S (electrons), by plain loops over pixels, rows and transfers:

    flare             S + V mean(S of the channel)                        section 2.1
    filter array      of the full images of the bands, each site's own    section 2.2
    misregistration   of the same, by the share of the aperture that each filter covers
    cross-talk        sum over neighbours of k S
    smear             S + leak t_row (sum of the column's electrons/s)
    transfer          a packet leaves e of its charge to the next one, once for each transfer
    noise             temporal variance S + D + sigma_d^2
    fixed pattern     gain mask S + offset mask
    ADC               |DN - (K S + black level)| <= 1/2
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from gpusim.camera import Camera
from gpusim.formats.ready import ready_lens
from gpusim.lens.prescription import Prescription
from gpusim.library.expose import expose
from gpusim.library.irradiance import on_tile, without_array
from gpusim.library.light import Light
from gpusim.plan import Accuracy
from gpusim.render.look import look
from gpusim.scene import make_scene
from gpusim.sensor.load import load_sensor
from gpusim.sensor.noise_model import Masks
from gpusim.sensor.readout import Shot
from gpusim.sensor.sensor import Sensor
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certified_lights, pooled
from gpusim.validate.kodak import BANDS, EXPOSURE_S, LENS, SENSOR

SCENE = "kodak-squares"
# Renders that are compared keep their tolerance; their difference keeps twice that.
TOLERANCE, PROBES = 5e-3, 8
SEED = 3650
# The lower right corner, farthest from the read-out at row 0 and column 0; and figure 8's own, the
# upper right one, there 160 x 128 samples at two for each pixel.
CORNER = 544, 400, 96, 80
UPPER = 560, 0, 80, 64
OFF: dict[str, Any] = dict.fromkeys(
    ("smear", "parallel_cti", "serial_cti", "crosstalk", "masks")
) | dict.fromkeys(
    ("veiling_glare", "prnu_percent", "dsnu_e", "dark_current_e_per_s", "temporal_dark_noise_e"),
    0.0,
)
# The paper gives no figures for these two; assumed: a tenth of a pixel each way, and what diffuses
# from a pixel of this size.
SHIFT_PX = (0.1, 0.05)
KERNEL = ((0.003, 0.012, 0.003), (0.012, 0.940, 0.012), (0.003, 0.012, 0.003))
MASK_GAIN, MASK_OFFSET_E = 0.01, 40.0  # amplitudes of the masks, drawn from a seed
# What has to hold: of the effect's own size where both pictures come from one light, in float32.
READ_BAR = 1e-3
# The flare's error, over the flare: gpusim.optics.flare takes the scene's mean before the PSFs, and
# at the reference wavelength: blue, which is magnified more, comes out 3e-3 off.
FLARE_BAR = 5e-3
LIGHT_BAR = 2 * TOLERANCE
ADC_BAR = 0.5 + 1e-3  # DN; float32 holds 1023 DN to 6e-5
ALARM = 1e-3  # chance of a false alarm of the noise


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect: the picture without it and with it, and how far that is from the law.

    Attributes
    ----------
    name, told : str
        Told says what was switched on.
    off, on : ndarray (rows, cols)
        The corner, electrons; of the ADC DN.
    bar : Bar
    """

    name: str
    told: str
    off: np.ndarray
    on: np.ndarray
    bar: Bar


@dataclass(frozen=True, eq=False)
class Effects:
    """The squares, and all effects.

    Attributes
    ----------
    picture : ndarray (rows, cols)
        The whole frame without effects, electrons.
    bands : ndarray (rows, cols, 3)
        Red, green and blue of the upper right corner, without a filter array, electrons.
    found : sequence of Effect
    certificates : dict of str to Certified
    """

    picture: np.ndarray
    bands: np.ndarray
    found: Sequence[Effect]
    certificates: Mapping[str, Certified]

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        return [one.bar for one in self.found]


def plain_sensor() -> Sensor:
    """Return the sensor of the paper with every effect off."""
    return load_sensor(SENSOR).model_copy(update=OFF)


def measure_effects(
    lens: Prescription,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> tuple[Effects, Light]:
    """Render the squares, and each effect on and off; return the light without effects too."""
    sensor, own, scene = plain_sensor(), load_sensor(SENSOR), make_scene(SCENE)
    total = 4

    def seen(sensor: Sensor) -> Camera:
        return Camera(lens=lens, sensor=sensor, title="stand-in, squares")

    accuracy = Accuracy(TOLERANCE, PROBES)

    def lit(camera: Camera, *tiles: tuple[int, int, int, int]) -> list[Light]:
        return certified_lights(camera, scene, accuracy, tiles, like=light)

    progress("squares", 0, total)
    light = expose(seen(sensor), scene, TOLERANCE, probes=PROBES)
    progress("squares", 1, total)
    nm = np.array(sensor.quantum_efficiency.wavelengths_nm)
    curves = np.array([sensor.quantum_efficiency.channels[name] for name in BANDS])
    bands = lit(without_array(seen(sensor), nm, curves), UPPER, CORNER)
    upper, corner = (
        EXPOSURE_S * on_tile(one, tile).transpose(1, 2, 0)
        for one, tile in zip(bands, (UPPER, CORNER), strict=True)
    )
    progress("squares", 2, total)
    glare = sensor.model_copy(update={"veiling_glare": own.veiling_glare})
    (flare,) = lit(seen(glare), CORNER)
    progress("squares", 3, total)
    shifted = sensor.cfa.model_copy(update={"shift_px": SHIFT_PX})
    moved = Sensor(**{**dict(sensor), "cfa": shifted})
    # For mixtures of filters a survey asks for other fields than for filters, and for a bank of its
    # own: pictures that are to differ by one effect share one.
    same = ready_lens(look(seen(sensor), scene, accuracy).bank, "traced", LENS)
    (beside,) = lit(Camera(lens=same, sensor=moved, title="stand-in, squares"), CORNER)
    progress("squares", total, total)

    off = read(light, sensor)
    seen = cut(off)
    found = [
        flare_effect(seen, off, read(flare, flare.sensor), sensor, own.veiling_glare),
        filter_effect(seen, corner, sensor),
        misregistration_effect(seen, corner, read(beside, beside.sensor), sensor),
        *charge_effects(light, off, own),
        noise_effect(light, off, own),
        mask_effect(light, off),
        adc_effect(light, off),
    ]
    certificates = {
        name: Certified(one.certificate, TOLERANCE)
        for name, one in (("squares", light), ("flare", flare), ("misregistration", beside))
    } | {"squares in three full bands, two corners": pooled(bands, TOLERANCE)}
    for one in (flare, beside):
        one.release()
    return Effects(off, upper, found, certificates), light


def read(
    light: Light, sensor: Sensor, *, noise: bool = False, plane: str = "electrons"
) -> np.ndarray:
    """Return the electrons (rows, cols) that a sensor makes of a light, or another plane."""
    planes = light.at(sensor=sensor).read({plane: np.float32}, Shot(EXPOSURE_S, SEED, 0), noise)
    return planes[plane].astype(float)


def cut(picture: np.ndarray) -> np.ndarray:
    """Return the corner of a picture of the whole frame."""
    x, y, width, height = CORNER
    return picture[y : y + height, x : x + width]


def sites(sensor: Sensor, shape: tuple[int, int]) -> np.ndarray:
    """Return the number in `BANDS` of the filter over each pixel of a picture of whole patterns."""
    pattern = np.array([[BANDS.index(name) for name in row] for row in sensor.cfa.letters])
    periods = shape[0] // pattern.shape[0], shape[1] // pattern.shape[1]
    return np.tile(pattern, periods)


def flare_effect(
    seen: np.ndarray, off: np.ndarray, on: np.ndarray, sensor: Sensor, share: float
) -> Effect:
    """Return the flare: uniform in each channel, a share of the frame's mean."""
    own, everywhere = sites(sensor, seen.shape), sites(sensor, off.shape)
    means = np.array([off[everywhere == k].mean() for k in range(len(BANDS))])
    flare = share * means[own]
    bar = Bar.largest(
        "flare against its law", ((on - seen - flare) / flare).ravel(), FLARE_BAR, "of it"
    )
    return Effect("flare", f"{share:.0%} of the mean, even over the frame", seen, on, bar)


def filter_effect(seen: np.ndarray, bands: np.ndarray, sensor: Sensor) -> Effect:
    """Return the filter array: each pixel keeps one band of three."""
    kept = np.take_along_axis(bands, sites(sensor, seen.shape)[..., None], axis=2)[..., 0]
    name = "filter array: each site's own band"
    bar = Bar.largest(name, [_rms((seen - kept) / kept)], LIGHT_BAR, "of the signal, RMS")
    told = "Bayer; without it the mean of the three full images"
    return Effect("filter array", told, bands.mean(axis=2), seen, bar)


def misregistration_effect(
    seen: np.ndarray, bands: np.ndarray, on: np.ndarray, sensor: Sensor
) -> Effect:
    """Return shifted filters: pixels see what covers their aperture."""
    own, side = sites(sensor, seen.shape), math.sqrt(sensor.fill_factor)
    expected = np.zeros(seen.shape)
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            covered = 1.0
            for shift, away in zip(SHIFT_PX, (dx, dy), strict=True):
                low, high = away + shift - 0.5, away + shift + 0.5
                covered *= max(min(high, side / 2) - max(low, -side / 2), 0.0) / side
            over = np.roll(own, (-dy, -dx), axis=(0, 1))
            expected += covered * np.take_along_axis(bands, over[..., None], axis=2)[..., 0]
    name = "misregistration against its law"
    error = _rms((on - expected) / expected)
    bar = Bar.largest(name, [error], LIGHT_BAR, "of the signal, RMS")
    told = f"filters {SHIFT_PX[0]:g} px to the right, {SHIFT_PX[1]:g} px down"
    return Effect("misregistration", told, seen, on, bar)


def charge_effects(light: Light, off: np.ndarray, own: Sensor) -> list[Effect]:
    """Return what moves signal to other pixels: cross-talk, smear, transfer inefficiency."""
    rows, cols = off.shape
    spread = np.zeros(off.shape)
    # At the rim the nearest pixels of the same filter stand for those beyond.
    padded = np.pad(off, 1, mode="reflect")
    for dy, dx in np.ndindex(3, 3):
        spread += KERNEL[dy][dx] * padded[2 - dy :, 2 - dx :][:rows, :cols]
    smear = own.smear.leak * own.smear.row_s * (off / EXPOSURE_S).sum(axis=0)
    laws = {
        "cross-talk": (
            {"crosstalk": {"optical": {"*": [list(row) for row in KERNEL]}}},
            spread,
            f"{1 - KERNEL[1][1]:.0%} of a pixel's signal in its neighbours",
        ),
        "smear": (
            {"smear": own.smear},
            off + smear,
            f"{own.smear.leak:g} of the light, {1e6 * own.smear.row_s:g} us a row",
        ),
        "parallel transfer": (
            {"parallel_cti": own.parallel_cti},
            transferred(off, own.parallel_cti.inefficiency),
            f"{own.parallel_cti.inefficiency:g} left behind in each",
        ),
        "serial transfer": (
            {"serial_cti": own.serial_cti},
            transferred(off.T, own.serial_cti.inefficiency).T,
            f"{own.serial_cti.inefficiency:g} left behind in each",
        ),
    }
    made = []
    for name, (change, expected, told) in laws.items():
        on = read(light, Sensor(**{**dict(light.sensor), **change}))
        bar = _against(f"{name} against its law", on, expected, off)
        made.append(Effect(name, told, cut(off), cut(on), bar))
    return made


def transferred(charge: np.ndarray, inefficiency: float) -> np.ndarray:
    """Return what is read of packets (packets, ...), of which packet k makes k + 1 transfers."""
    waiting, read_out = np.array(charge), np.empty_like(charge)
    for k in range(len(charge)):
        # The register moves by one: each packet leaves its share to the one behind it.
        left = inefficiency * waiting
        waiting = waiting - left
        waiting[1:] += left[:-1]
        read_out[k] = waiting[0]
        waiting = waiting[1:]
    return read_out


def noise_effect(light: Light, off: np.ndarray, own: Sensor) -> Effect:
    """Return temporal noise: shot noise of light and dark current, and that of the read-out."""
    fields = {
        name: getattr(own, name) for name in ("temporal_dark_noise_e", "dark_current_e_per_s")
    }
    on = read(light, light.sensor.model_copy(update=fields), noise=True)
    dark_e = own.dark_current_e_per_s * EXPOSURE_S
    variance = off + dark_e + own.temporal_dark_noise_e**2
    # Normalised squares have mean 1; of n of them the sum is chi-square, for large n normal. Shot
    # noise adds at most 1 / variance to the fourth moment: 1e-3 here.
    found = np.mean((on - off - dark_e) ** 2 / variance)
    allowed = math.sqrt(2 / off.size) * float(norm.isf(ALARM / 2))
    bar = Bar.largest(
        "temporal noise: variance over its law, less 1", [found - 1], allowed, "of it"
    )
    sigma = own.temporal_dark_noise_e
    told = f"shot noise, {dark_e:.0f} e- of dark current, {sigma:g} e- of the read-out"
    return Effect("noise", told, cut(off), cut(on), bar)


def mask_effect(light: Light, off: np.ndarray) -> Effect:
    """Return the fixed pattern of a pair of masks, one a factor and one added."""
    drawn = np.random.default_rng(SEED)
    rows, cols = off.shape
    gain = 1 + MASK_GAIN * drawn.standard_normal((1, cols)) * np.ones((rows, 1))
    offset = MASK_OFFSET_E * np.sin(np.arange(rows) / 3)[:, None] * np.ones((1, cols))
    masks = {"gain": gain.astype(np.float32), "offset_e": offset.astype(np.float32)}
    with tempfile.TemporaryDirectory() as folder:
        for name, values in masks.items():
            np.save(Path(folder) / f"{name}.npy", values)
        files = {name: str(Path(folder) / f"{name}.npy") for name in masks}
        # Two numbers that are nought: a frame with fixed patterns and without temporal noise.
        fields = {"masks": Masks(**files), "gaussian_variance_per_e": 0.0}
        on = read(light, Sensor(**{**dict(light.sensor), **fields}), noise=True)
    expected = off * masks["gain"] + masks["offset_e"]
    bar = _against("masks of the fixed pattern against their law", on, expected, off)
    told = f"columns by {MASK_GAIN:.0%} (a factor), rows by {MASK_OFFSET_E:g} e- (added)"
    return Effect("fixed pattern", told, cut(off), cut(on), bar)


def adc_effect(light: Light, off: np.ndarray) -> Effect:
    """Return the converter: system gain, black level, whole codes."""
    sensor = light.sensor
    on = read(light, sensor, plane="dn")
    exact = sensor.system_gain_dn_per_e * off + sensor.black_level_dn
    bar = Bar.largest("ADC: code less its law", [np.abs(on - exact).max()], ADC_BAR, "DN")
    told = f"{sensor.bit_depth} bit, {1 / sensor.system_gain_dn_per_e:.1f} e- for each DN"
    return Effect("ADC", told, cut(exact), cut(on), bar)


def _against(name: str, on: np.ndarray, expected: np.ndarray, off: np.ndarray) -> Bar:
    """Return the bar of an effect's error, RMS, over the effect's own size."""
    error = _rms(on - expected) / _rms(expected - off)
    return Bar.largest(name, [error], READ_BAR, "of the effect, RMS")


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
