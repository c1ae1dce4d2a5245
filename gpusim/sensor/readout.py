"""The sensor on one screen: what happens to the signal, in this order.

1. mosaic: each photosite's own light, and the veiling glare; border: none on the optical black
2. crosstalk, optical: light and diffusing charge that reach other pixels
3. exposure: response of pixels, rows and columns (PRNU, multiplicative mask), exposure time, dark
   current of each pixel (DCNU)
4. defects: dead and hot pixels
5. noise, its first half: shot noise of light and dark current, full well
6. electrical crosstalk: collected charge that is seen at other pixels
7. noise, its second half, what the read-out adds: offsets of pixels, rows and columns (DSNU,
   additive mask), noise of reset, read-out, rows and columns; one dispatch with the first where
   nothing comes between them
8. defects: stuck pixels
9. adc: system gain, non-linearity, black level, column offsets, quantisation, clip
10. merge, of sensors that read each charge at two gains: temporal dark noise, that of lines, stuck
    pixels and adc once for each, then one linear code of both

The order is part of the contract: response before shot noise, so that it does not change the
slope of the photon transfer; all that moves charge before all that is added when it is read.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass

from gpusim.gpu import Array, Recording
from gpusim.sensor.adc import record_adc
from gpusim.sensor.border import record_border
from gpusim.sensor.crosstalk import grown, reach, record_crosstalk
from gpusim.sensor.crosstalk_model import Crosstalk, Kernels
from gpusim.sensor.defects import record_defects, record_stuck
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.frame import Rect, overlap
from gpusim.sensor.merge import record_merge
from gpusim.sensor.mosaic import record_mosaic
from gpusim.sensor.noise import READ_OUT, record_noise
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

# By this the seed of the second read differs from that of the first: noise of its own.
LOW_GAIN_SEED = 0x6C6F775F6761696E
# What each of two reads has of its own; the rest comes once, with the charge.
EACH_READ = ("read noise", "line noise")


def noise_seed(seed: int, exposure_s: float, analogue_gain: float) -> int:
    """Return the seed of the noise of a frame that is taken with an exposure at a gain.

    With the same words for two exposures the noise of a bracket would be the same but for its size,
    and its frames no independent ones.

    Parameters
    ----------
    seed : int
        Seed of the capture, 0 to 2^64 - 1.
    exposure_s, analogue_gain : float
    """
    words = struct.pack("<Qdd", seed, exposure_s, analogue_gain)
    return int.from_bytes(hashlib.blake2b(words, digest_size=8).digest(), "little")


@dataclass(frozen=True)
class Shot:
    """What one frame is taken with.

    Attributes
    ----------
    exposure_s : float
    seed : int
        Seed of the temporal noise, 0 to 2^64 - 1.
    frame : int
        Frames of one seed have independent noise.
    temperature_c : float, optional
        Temperature of the sensor; by default that at which its dark current was measured.
    """

    exposure_s: float
    seed: int
    frame: int
    temperature_c: float | None = None


@dataclass(frozen=True)
class SiteLight:
    """The light at the photosites, as optics leave it, electrons/s.

    Attributes
    ----------
    sites : Array (S, rows, cols), f32
        See `gpusim.sensor.planes`.
    glare : Array (sites,), f32
        Veiling glare of each site of the filter pattern, row by row.
    lit : (row, col, rows, cols)
        The pixels that ``sites`` hold, whole periods of the planes: what of `rects_of` sees light.
    """

    sites: Array
    glare: Array
    lit: Rect


def record_light(
    rec: Recording,
    light: SiteLight,
    sensor: Sensor,
    rect: Rect,
    runs: Callable[[str], bool],
    *,
    label: str = "rate",
) -> Array:
    """Record the light on a rectangle of pixels, electrons/s (rows, cols): see `record_readout`."""
    seen, rate, lit = overlap(rect, sensor.frame.lit), light.sites, light.lit
    if 0 in seen[2:]:
        return record_border(rec, None, seen, rect, label=f"framed {label}")
    # In a sensor without filters the plane is the frame: one strip takes it whole.
    if runs("mosaic") or seen != lit:
        period = planes_of(sensor).period
        cell = lit[0] // period, lit[1] // period
        where = {"origin": seen[:2], "cell_origin": cell, "label": label}
        rate = record_mosaic(rec, light.sites, light.glare, sensor, seen[2:], **where)
    if seen == rect:
        return rate
    return record_border(rec, rate, seen, rect, label=f"framed {label}")


def _kernels(sensor: Sensor, runs: Callable[[str], bool]) -> tuple[Kernels | None, Kernels | None]:
    """Return the sensor's optical and electrical cross-talk, where they run."""
    spread = sensor.crosstalk or Crosstalk.model_construct()
    return (
        spread.optical if runs("crosstalk") else None,
        spread.electrical if runs("electrical crosstalk") else None,
    )


def rects_of(rect: Rect, sensor: Sensor, runs: Callable[[str], bool]) -> tuple[Rect, Rect]:
    """Return the pixels that collect charge for a rectangle, and those whose light they take.

    Each is the rectangle and what cross-talk needs around it, as far as the sensor goes.

    Parameters
    ----------
    rect : (row, col, rows, cols)
    sensor : Sensor
    runs : callable
        Whether a stage runs, by its name in the plan.
    """
    frame, period = sensor.frame.pixels, sensor.period
    optical, electrical = _kernels(sensor, runs)
    collecting = grown(rect, reach(electrical, period), frame) if electrical else rect
    return collecting, grown(collecting, reach(optical, period), frame) if optical else collecting


def record_readout(
    rec: Recording,
    light: SiteLight,
    sensor: Sensor,
    rect: Rect,
    *,
    shot: Shot,
    runs: Callable[[str], bool],
) -> dict[str, Array]:
    """Record what the sensor makes of the light on a rectangle of pixels.

    Parameters
    ----------
    rec : Recording
    light : SiteLight
    sensor : Sensor
    rect : (row, col, rows, cols)
        The rectangle, counted from the first lit pixel: the border has negative numbers.
    shot : Shot
    runs : callable
        Whether a stage runs, by its name in the plan.

    Returns
    -------
    dict of str to Array
        ``electrons``, f32, and ``dn``, u32, of the rectangle; ``mean`` electrons, f32, of the
        pixels that collect charge for it, and ``rate``, electrons/s, f32, of those whose light they
        take: see `rects_of`.
    """
    rate, mean = record_charge(rec, light, sensor, rect, shot=shot, runs=runs)
    read = record_read(rec, mean, sensor, rect, shot=shot, runs=runs)
    return {"rate": rate, "mean": mean, **read}


def record_charge(
    rec: Recording,
    light: SiteLight,
    sensor: Sensor,
    rect: Rect,
    *,
    shot: Shot,
    runs: Callable[[str], bool],
) -> tuple[Array, Array]:
    """Record ``rate`` and ``mean`` of `record_readout`, which all frames of an exposure share.

    Neither depends on seed and frame, nor on what a step of the sensor's gain changes.
    """
    optical, _ = _kernels(sensor, runs)
    collecting, taking = rects_of(rect, sensor, runs)
    spread = rate = record_light(rec, light, sensor, taking, runs)
    if optical:
        spread = record_crosstalk(rec, rate, optical, sensor, given=taking, wanted=collecting)
    clipped = {} if runs("noise") else {"limit_e": sensor.full_well_e}
    warm = {"origin": sensor.frame.on_chip(collecting), "temperature_c": shot.temperature_c}
    mean = record_exposure(rec, spread, sensor, shot.exposure_s, runs=runs, **warm, **clipped)
    if runs("defects"):
        record_defects(rec, mean, sensor, shot.exposure_s, **warm, **clipped)
    return rate, mean


def record_read(
    rec: Recording,
    mean: Array,
    sensor: Sensor,
    rect: Rect,
    *,
    shot: Shot,
    runs: Callable[[str], bool],
) -> dict[str, Array]:
    """Record ``electrons`` and ``dn`` of `record_readout` from the mean electrons."""
    frame, (_, electrical) = sensor.frame, _kernels(sensor, runs)
    collecting, _ = rects_of(rect, sensor, runs)
    origin, electrons = frame.on_chip(collecting), mean
    warm = {"origin": origin, "temperature_c": shot.temperature_c}

    def once(name: str) -> bool:
        return runs(name) and not (runs("merge") and name in EACH_READ)

    keyed = {"seed": shot.seed, "frame": shot.frame, "runs": once}
    if not electrical:
        if runs("noise"):
            electrons = record_noise(rec, electrons, sensor, **keyed, **warm)
    else:
        if runs("noise"):
            half = {"label": "charge", "read_out": False}
            electrons = record_noise(rec, electrons, sensor, **keyed, **warm, **half)
        coupled = {"given": collecting, "wanted": rect, "label": "electrical crosstalk"}
        electrons = record_crosstalk(rec, electrons, electrical, sensor, **coupled)
        origin = frame.on_chip(rect)
        warm |= {"origin": origin}
        if runs("noise") and any(map(once, READ_OUT.values())):
            electrons = record_noise(rec, electrons, sensor, shot=False, **keyed, **warm)
    if runs("merge"):
        return _two_reads(rec, electrons, sensor, shot, origin=origin, runs=runs)
    if runs("defects"):
        record_stuck(rec, electrons, sensor, origin=origin)
    dn = record_adc(rec, electrons, sensor, origin=origin, column_offset=runs("column fpn"))
    return {"electrons": electrons, "dn": dn}


def _two_reads(
    rec: Recording,
    charge: Array,
    sensor: Sensor,
    shot: Shot,
    *,
    origin: tuple[int, int],
    runs: Callable[[str], bool],
) -> dict[str, Array]:
    """Record two reads of a charge and their merged code; the electrons are the first read's."""
    reads, codes = [], []
    seeds = {"high": shot.seed, "low": shot.seed ^ LOW_GAIN_SEED}
    for one, name in ((sensor, "high"), (sensor.at_low_gain(), "low")):
        read = charge
        if runs("read noise"):
            read = record_noise(
                rec,
                charge,
                one,
                seed=seeds[name],
                frame=shot.frame,
                origin=origin,
                label=f"{name} gain",
                shot=False,
                runs=lambda effect: effect in EACH_READ and runs(effect),
            )
        if runs("defects"):
            record_stuck(rec, read, sensor, origin=origin)
        reads.append(read)
        offset = runs("column fpn")
        codes.append(
            record_adc(rec, read, one, origin=origin, label=f"{name} dn", column_offset=offset)
        )
    return {"electrons": reads[0], "dn": record_merge(rec, *codes, sensor)}
