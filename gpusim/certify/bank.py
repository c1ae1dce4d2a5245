"""The bank's part of the certificate: its PSFs against PSFs traced anew, and the light beyond them.

At some image heights between the bank's fields the lens is traced in float64, at wavelengths
between the bank's lines. Around pixels at these heights the scene is integrated twice by the exact
model: with what the bank makes of the height, and with what was traced. PSFs are taken as the same
for all source points, in both, so that they differ by the bank alone: interpolation over field and
wavelength, sampling of the pupil, pitch, and folding.

A lens that is known by its PSFs alone is taken as given. What its own sampling leaves open is told
by the same comparison of every other field with those between: cubics err by a sixteenth of it
where fields are half as far apart.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from threadpoolctl import threadpool_limits

from gpusim.certify.budget import EXACT, Judged, Share, errors
from gpusim.certify.probes import beyond_circle
from gpusim.lens.bank import Bank
from gpusim.lens.field_bank import FieldBank
from gpusim.lens.prescription import Prescription
from gpusim.lens.traced import cached_traced_bank
from gpusim.plan import Accuracy
from gpusim.reference.fields import Heights, OneHeight, TracedHeight
from gpusim.reference.truth import Truth
from gpusim.reference.wide import Wide
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.sensor import Sensor

HEIGHTS = 4  # image heights at which the lens is traced
EACH = 3  # pixels at each of them, on the steepest edges
THINNED = 1 / 16  # of the error with fields twice as far apart: cubics go with the fourth power
AZIMUTHS = 1440  # places on a ring among which pixels are chosen


def bank_share(
    bank: FieldBank,
    lens: object,
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    rate: np.ndarray,
    origin: tuple[int, int],
    exposure_s: float,
    accuracy: Accuracy,
    progress: Callable[[int, int], None] | None = None,
) -> Judged:
    """Judge a bank by its lens, as far as a scene shows it.

    Parameters
    ----------
    bank : FieldBank
    lens : Prescription, or anything else
        Traced where it is a prescription.
    sensor, scene
    placed : Chart or PlacedRaster
        The scene's source on the sensor, um.
    rate : ndarray (rows, cols)
        Electrons/s of the render, or of a rectangle of it.
    origin : (int, int)
        Row and column of the rectangle's first pixel.
    exposure_s : float
    accuracy : Accuracy
    progress : callable, optional
        Called with (done, total) of the fields that are traced.
    """
    window, notes = beyond(bank, sensor, rate, origin, exposure_s, accuracy)
    if not isinstance(bank, Bank):
        words = "bank: a lens without an axis is taken as its bank has it; not measured"
        return Judged(EXACT, window, (*notes, words))
    traced = isinstance(lens, Prescription)
    if not traced and len(bank.field_deg) < 5:
        words = f"bank: taken as given; {len(bank.field_deg)} fields are too few to tell more"
        return Judged(EXACT, window, (*notes, words))
    radii, numbers = _radii(bank, sensor, rate.shape, origin, between=traced)
    pixels, owners = _pixels(sensor, rate, origin, radii)
    if traced:
        pairs = _traced_pairs(bank, lens, radii, progress)
        words = (
            f"bank: {len(pixels)} pixels at {len(radii)} image heights between its fields, where "
            "the lens was traced anew in float64, at wavelengths between its lines"
        )
    else:
        pairs = _thinned_pairs(bank, radii, numbers)
        words = (
            f"bank: the PSFs are taken as given; without every other field {len(pixels)} pixels "
            "change by 16 times as much"
        )
    if not len(pixels):
        return Judged(EXACT, window, (*notes, "bank: not measured, no light falls there"))
    change = _changes(pairs, sensor, scene, placed, pixels, owners, len(bank.levels))
    if not traced:
        change *= THINNED
    there = tuple((pixels - origin).T)
    own = rate[there].astype(np.float64)
    found = errors(sensor, own + change, own, exposure_s, accuracy)
    share = Share(float(np.sqrt(np.mean(found**2))), float(found.max()), len(found))
    return Judged(share, window, (*notes, words))


def beyond(
    bank: FieldBank,
    sensor: Sensor,
    rate: np.ndarray,
    origin: tuple[int, int],
    exposure_s: float,
    accuracy: Accuracy,
) -> tuple[float, tuple[str, ...]]:
    """Return what the light beyond the widest PSF costs, and a word on it.

    So far out it is spread evenly: every pixel lacks its share of the mean signal.
    """
    share = getattr(bank, "beyond_energy", None)
    if share is None:
        return 0.0, ("window: what lands beyond the PSFs is not known to the bank",)
    most = float(share.max())
    even = most * float(rate.mean(dtype=np.float64))
    # Pixels beyond the image circle have no light to lose, and do not count.
    some = np.unravel_index(np.arange(0, rate.size, max(1, rate.size // 4096)), rate.shape)
    inside = ~beyond_circle(bank, sensor, np.stack(some, axis=1) + origin)
    lit = rate[some][inside].astype(np.float64)
    lit = lit[lit > 0]
    if not len(lit):
        return 0.0, ()
    lost = errors(sensor, lit + even, lit, exposure_s, accuracy)
    last = bank.levels[-1]
    reach_mm = last.psf.shape[-1] / 2 * last.pitch_um / 1e3
    words = f"window: {most:.1e} of the light lands more than {reach_mm:.3g} mm from its chief ray"
    return float(np.sqrt(np.mean(lost**2))), (words,)


def _radii(
    bank: Bank, sensor: Sensor, shape: tuple[int, int], origin: tuple[int, int], between: bool
) -> tuple[np.ndarray, list[int]]:
    """Return image heights in a rectangle to judge the bank at, and the fields that lie there.

    Half-way between fields; or else odd fields, to be judged by their neighbours.
    """
    half = np.array([sensor.rows, sensor.cols]) / 2
    low = (np.array(origin) - half) * sensor.pixel_pitch_um
    high = low + np.array(shape) * sensor.pixel_pitch_um
    nearest = np.hypot(*np.clip(0.0, low, high))
    farthest = np.hypot(*np.maximum(np.abs(low), np.abs(high)))
    own = bank.real_height_um[:, bank.reference]
    if between:
        start, end = np.maximum(own[:-1], nearest), np.minimum(own[1:], farthest)
        there = np.flatnonzero(end > start)
        places = (start + end)[there] / 2
    else:
        there = np.arange(1, len(own) - 1, 2)
        there = there[(own[there] > nearest) & (own[there] < farthest)]
        places = own[there]
    if not len(places):
        return places, []
    # The rim is where a lens changes most; the rest evenly.
    chosen = np.unique(np.round(np.linspace(0, len(places) - 1, HEIGHTS + 1)[1:]).astype(int))
    return places[chosen], [int(number) for number in there[chosen]]


def _pixels(
    sensor: Sensor, rate: np.ndarray, origin: tuple[int, int], radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (P, 2) at the heights, on the steepest edges, and the height (P,) of each."""
    period = sensor.period
    chosen, owners = [], []
    turn = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)
    for number, radius in enumerate(radii):
        ring = radius / sensor.pixel_pitch_um * np.stack([np.sin(turn), np.cos(turn)], axis=1)
        at = np.floor(ring + np.array([sensor.rows, sensor.cols]) / 2).astype(int) - origin
        inside = np.all((at >= 0) & (at < np.array(rate.shape)), axis=1)
        at, where = at[inside], np.flatnonzero(inside)
        slope = np.zeros(len(at))
        for axis in (0, 1):
            step = np.eye(2, dtype=int)[axis] * period[axis]
            other = np.clip(at + step, 0, np.array(rate.shape) - 1)
            here, there = (rate[tuple(one.T)].astype(np.float64) for one in (at, other))
            slope = np.maximum(slope, np.abs(here - there))
        lit = rate[tuple(at.T)] > 0
        for part in np.array_split(np.arange(AZIMUTHS), EACH):
            own = np.flatnonzero((where >= part[0]) & (where <= part[-1]) & lit)
            if len(own):
                chosen.append(at[own[slope[own].argmax()]] + origin)
                owners.append(number)
    return np.array(chosen, int).reshape(-1, 2), np.array(owners, int)


Pair = Callable[[int], tuple[tuple[FieldBank, Heights], tuple[FieldBank, Heights]]]


def _traced_pairs(
    bank: Bank, lens: Prescription, radii: np.ndarray, progress: Callable[[int, int], None] | None
) -> list[Pair]:
    """Return, for each height, bank and lens with the fields to take, by level."""
    if not len(radii):
        return []
    lines = bank.wavelengths_nm
    between = (lines[1:] + lines[:-1]) / 2
    lines = np.concatenate([lines[:1], between, lines[-1:]]) if len(lines) > 1 else lines
    traced = cached_traced_bank(
        lens,
        wavelengths_nm=lines,
        field_deg=np.concatenate([[0.0], bank.angle_from_height(radii)[0]]),
        reference_nm=float(lines[np.abs(lines - bank.reference_nm).argmin()]),
        pitch_um=bank.pitch_um,
        size=bank.psf.shape[-1],
        progress=progress,
    )

    # How an even scene is shown follows from the fields around, which were not traced.
    height = bank.real_height_um[:, bank.reference]
    ratio = bank.scatter / bank.relative_illumination
    at = [[0.0, *radii], lines]
    ratio = RegularGridInterpolator((height, bank.wavelengths_nm), ratio)(
        np.stack(np.meshgrid(*at, indexing="ij"), axis=-1)
    )
    theirs = traced.levels_of(traced.relative_illumination * ratio)

    def pair(number: int) -> Pair:
        def of_level(level: int):
            ours = bank.levels[level]
            return (
                (ours, OneHeight(ours, radii[number])),
                (theirs[level], TracedHeight(ours, theirs[level], number + 1, radii[number])),
            )

        return of_level

    return [pair(number) for number in range(len(radii))]


def _thinned_pairs(bank: Bank, radii: np.ndarray, numbers: list[int]) -> list[Pair]:
    """Return, for each field that is left out, the bank without it and the field itself."""

    def pair(place: int) -> Pair:
        kept = np.arange(0, len(bank.field_deg), 2)

        def of_level(level: int):
            whole = bank.levels[level]
            thin = replace(
                whole,
                psf=whole.psf[kept],
                relative_illumination=whole.relative_illumination[kept],
                real_height_um=whole.real_height_um[kept],
                field_deg=whole.field_deg[kept],
                ideal_height_um=whole.ideal_height_um[kept],
            )
            return (
                (thin, OneHeight(thin, radii[place])),
                (whole, TracedHeight(whole, whole, numbers[place], radii[place])),
            )

        return of_level

    return [pair(place) for place in range(len(radii))]


def _changes(
    pairs: list[Pair],
    sensor: Sensor,
    scene: Scene,
    placed: Chart | PlacedRaster,
    pixels: np.ndarray,
    owners: np.ndarray,
    levels: int,
) -> np.ndarray:
    """Return by how much (P,) electrons/s change from bank to lens."""
    changes = np.zeros(len(pixels))

    def of_height(number: int) -> None:
        own = np.flatnonzero(owners == number)
        if not len(own):
            return
        for level in range(levels):
            ours, (theirs, fields) = pairs[number](level)
            given = (theirs, sensor, scene.spectra, WAVELENGTHS_NM, fields, ours)
            if level:
                changes[own] += Wide(*given).at(placed, pixels[own])
            else:
                truth = Truth(*given)
                evaluate = truth.chart if isinstance(placed, Chart) else truth.raster
                changes[own] += evaluate(placed, pixels[own])

    with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(of_height, range(len(pairs))))
    return changes
