"""The bank's part of the certificate: its PSFs against PSFs traced anew, and the light beyond them.

At some image heights between the bank's fields (of a lens without an axis: image points) the lens
is traced in float64, at wavelengths between the bank's lines. Around pixels there the scene is
integrated twice by the exact model: with what the bank makes of the place, and with what was
traced. PSFs are taken as the same for all source points, in both, so that they differ by the bank
alone: interpolation over field and wavelength, sampling of the pupil, pitch, and folding.

A lens that is known by its PSFs alone is taken as given. What its own sampling leaves open is told
by the same comparison of every other field with those between: cubics err by a sixteenth of it
where fields are half as far apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gpusim.certify.budget import EXACT, Judged, Measure, Placed, Share
from gpusim.certify.engine import ExactModel
from gpusim.certify.places import pixels_near, pixels_on_rings, points_of, radii_of
from gpusim.certify.probes import beyond_circle
from gpusim.lens.prescription import Prescription
from gpusim.parallel import each
from gpusim.psf.bank import Bank
from gpusim.psf.beyond import landing_share
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.traced import cached_traced_bank, cached_traced_plane_field
from gpusim.reference.exact_model import ExactCore
from gpusim.reference.fields import Grid, Heights, OneHeight, OnePoint, TracedHeight, TracedPoint
from gpusim.reference.wide import Wide
from gpusim.scene.chart import Chart

# Width of the windows of PSFs that are traced anew, over the bank's. Beyond a window light is rays
# and a rim's diffraction to first order, which what judges a bank must not share: a decentred
# triplet that throws 15 % beyond 30 um had edges off by 1e-2, and a certificate of 1.1e-3.
WIDER = 2
THINNED = 1 / 16  # of the error with fields twice as far apart: cubics go with the fourth power


def bank_share(
    exact: ExactModel,
    lens: object,
    rate: Placed,
    by: Measure,
    *,
    progress: Callable[[int, int], None] | None = None,
    dropped: float = 0.0,
) -> Judged:
    """Judge a bank by its lens, as far as a scene shows it.

    Parameters
    ----------
    exact : ExactModel
        The scene before the camera that has the bank.
    lens : Prescription, or anything else
        Traced where it is a prescription.
    rate : Placed
        Electrons/s of the render, or of a rectangle of it.
    by : Measure
    progress : callable, optional
        Called with (done, total) of the fields that are traced.
    dropped : float
        Share of the light that was left out for its wavelength: see `gpusim.plan.band`. It counts
        with the window's.
    """
    bank, sensor = exact.bank, exact.sensor
    window, notes = beyond(bank, rate, by)
    if dropped:
        window += left_out(rate.plane, by, dropped)
        notes += (f"window: with it {dropped:.1e} of the light, left out for its wavelength",)
    traced, axial = isinstance(lens, Prescription), isinstance(bank, Bank)
    fields = bank.field_deg.shape if axial else (len(bank.field_y_deg), len(bank.field_x_deg))
    if not traced and min(fields) < 5:
        words = f"bank: taken as given; {' x '.join(map(str, fields))} fields are too few to tell"
        return Judged(EXACT, window, (*notes, f"{words} more"))
    places_of, near = (radii_of, pixels_on_rings) if axial else (points_of, pixels_near)
    places, numbers = places_of(bank, sensor, rate.plane.shape, rate.origin, between=traced)
    pixels, owners = near(sensor, rate.plane, rate.origin, places)
    if traced:
        pairs_of = _traced_pairs if axial else _traced_points
        pairs = pairs_of(bank, lens, places, progress)
        words = (
            f"bank: {len(pixels)} pixels at {len(places)} image {'heights' if axial else 'points'} "
            "between its fields, where the lens was traced anew in float64, at wavelengths between "
            "its lines"
        )
    else:
        pairs = (_thinned_pairs if axial else _thinned_points)(bank, places, numbers)
        words = (
            f"bank: the PSFs are taken as given; without every other field {len(pixels)} pixels "
            "change by 16 times as much"
        )
    if not len(pixels):
        return Judged(EXACT, window, (*notes, "bank: not measured, no light falls there"))
    change = _changes(pairs, exact, pixels, owners)
    if not traced:
        change *= THINNED
    own = rate.at(*pixels.T)
    found = by.errors(own + change, own)
    share = Share(float(np.sqrt(np.mean(found**2))), float(found.max()), len(found))
    return Judged(share, window, (*notes, words))


def beyond(bank: FieldBank, rate: Placed, by: Measure) -> tuple[float, tuple[str, ...]]:
    """Return what the light beyond the widest PSF costs, and a word on it.

    So far out it is spread evenly: every pixel lacks its share of the mean signal, as far as that
    lands on it (`gpusim.psf.beyond`).
    """
    share = getattr(bank, "beyond_energy", None)
    if share is None:
        return 0.0, ("window: what lands beyond the PSFs is not known to the bank",)
    last = bank.levels[-1]
    reach_um = last.psf.shape[-1] / 2 * last.pitch_um
    most = float(share.max())
    # Pixels beyond the image circle have no light to lose, and do not count.
    plane, sensor = rate.plane, by.sensor
    some = np.unravel_index(np.arange(0, plane.size, max(1, plane.size // 4096)), plane.shape)
    pixels = np.stack(some, axis=1) + rate.origin
    counts = ~beyond_circle(bank, sensor, pixels) & (plane[some] > 0)
    if not counts.any():
        return 0.0, ()
    middle = np.array([sensor.rows, sensor.cols]) / 2
    at_um = (pixels[counts] + 0.5 - middle)[:, ::-1] * sensor.pixel_pitch_um
    landing = landing_share(bank, np.hypot(*(at_um - bank.centre_um).T))
    if not landing.any():
        return 0.0, (f"window: light beyond {reach_um / 1e3:.3g} mm lands beside the sensor",)
    lit = plane[some][counts].astype(np.float64)
    lacking = most * landing * float(plane.mean(dtype=np.float64))
    lost = by.errors(lit + lacking, lit)
    words = f"window: {most:.1e} of the light lands more than {reach_um / 1e3:.3g} mm from its "
    words += f"chief ray, {landing.mean():.0%} of that on pixels"
    return float(np.sqrt(np.mean(lost**2))), (words,)


def left_out(rate: np.ndarray, by: Measure, share: float) -> float:
    """Return the RMS error that a share of the light makes which every pixel lacks."""
    some = rate.ravel()[:: max(1, rate.size // 4096)].astype(np.float64)
    lit = some[some > 0]
    lost = by.errors(lit * (1 + share), lit)
    return float(np.sqrt(np.mean(lost**2))) if len(lit) else 0.0


Fields = Heights | Grid
Pair = Callable[[int], tuple[tuple[FieldBank, Fields], tuple[FieldBank, Fields]]]


def _traced_pairs(
    bank: Bank, lens: Prescription, radii: np.ndarray, progress: Callable[[int, int], None] | None
) -> list[Pair]:
    """Return, for each height, bank and lens with the fields to take, by level."""
    if not len(radii):
        return []
    lines = _between_lines(bank)
    traced = cached_traced_bank(
        lens,
        wavelengths_nm=lines,
        field_deg=np.concatenate([[0.0], bank.angle_from_height(radii)[0]]),
        reference_nm=float(lines[np.abs(lines - bank.reference_nm).argmin()]),
        map_nm=float(bank.reference_nm),
        pitch_um=bank.pitch_um,
        size=WIDER * bank.psf.shape[-1],
        progress=progress,
    )
    theirs = traced.levels

    def pair(number: int) -> Pair:
        def of_level(level: int):
            ours = bank.levels[level]
            return (
                (ours, OneHeight(ours, radii[number])),
                (theirs[level], TracedHeight(ours, theirs[level], number + 1, radii[number])),
            )

        return of_level

    return [pair(number) for number in range(len(radii))]


def _between_lines(bank: FieldBank) -> np.ndarray:
    """Return wavelengths half-way between a bank's lines, and its ends."""
    lines = bank.wavelengths_nm
    between = (lines[1:] + lines[:-1]) / 2
    return np.concatenate([lines[:1], between, lines[-1:]]) if len(lines) > 1 else lines


def _traced_points(
    bank: PlaneBank,
    lens: Prescription,
    points: np.ndarray,
    progress: Callable[[int, int], None] | None,
) -> list[Pair]:
    """Return, for each image point, bank and lens with the fields to take, by level."""
    lines = _between_lines(bank)
    settings = {
        "wavelengths_nm": lines,
        "reference_nm": float(lines[np.abs(lines - bank.reference_nm).argmin()]),
        "map_nm": float(bank.reference_nm),
        "pitch_um": bank.pitch_um,
        "size": WIDER * bank.psf.shape[-1],
    }
    pairs = []
    for done, point in enumerate(points, start=1):
        angles = tuple(float(one) for one in bank.field_deg(*point))
        traced = cached_traced_plane_field(lens, field_deg=angles, **settings)
        pairs.append(_at_point(bank, traced.levels, 0, point))
        if progress is not None:
            progress(done, len(points))
    return pairs


def _at_point(
    ours: PlaneBank, levels: tuple[PlaneBank, ...], field: int, point: np.ndarray
) -> Pair:
    """Return a bank at an image point, and a field of other levels that lies there."""

    def of_level(level: int):
        own, other = ours.levels[level], levels[level]
        return (own, OnePoint(own, point)), (other, TracedPoint(own, other, field, point))

    return of_level


def _thinned_points(bank: PlaneBank, points: np.ndarray, numbers: list[int]) -> list[Pair]:
    """Return, for each field that is left out, the bank without it and the field itself."""
    names = ("chief_x_um", "chief_y_um", "psf", "relative_illumination")
    thin = replace(
        bank,
        field_x_deg=bank.field_x_deg[::2],
        field_y_deg=bank.field_y_deg[::2],
        halo=None if bank.halo is None else bank.halo[:, ::2, ::2],
        **{name: getattr(bank, name)[::2, ::2] for name in names},
    )
    return [
        _at_point(thin, bank.levels, number, point)
        for number, point in zip(numbers, points, strict=True)
    ]


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
    pairs: list[Pair], exact: ExactModel, pixels: np.ndarray, owners: np.ndarray
) -> np.ndarray:
    """Return by how much (P,) electrons/s change from bank to lens."""
    scene, placed, changes = exact.scene, exact.placed, np.zeros(len(pixels))
    landings = exact.landings  # made before the threads begin, which share it

    def of_height(number: int) -> None:
        own = np.flatnonzero(owners == number)
        if not len(own):
            return
        for level in range(len(exact.bank.levels)):
            ours, (theirs, fields) = pairs[number](level)
            given = theirs, exact.sensor, scene.spectra, scene.wavelengths_nm
            banks = {"fields": fields, "less": ours, "landings": landings}
            if level:
                changes[own] += Wide(*given, **banks).at(placed, pixels[own])
            else:
                core = ExactCore(*given, **banks)
                evaluate = core.chart if isinstance(placed, Chart) else core.raster
                changes[own] += evaluate(placed, pixels[own])

    each(of_height, range(len(pairs)))
    return changes
