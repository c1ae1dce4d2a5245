"""How a photograph's highlights are to be summed: squares, bundles with one kernel, their tables.

The tolerance and the memory for tables decide it; no device is needed.
`gpusim.optics.point_sources` does what is planned here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gpusim.optics.highlight_sampling import Sampling, sampling
from gpusim.optics.highlight_squares import Squares, bundled, of_few_spectra, squares_on_sensor
from gpusim.optics.highlight_tables import (
    TRIED,
    MixingErrors,
    Mixture,
    Tables,
    distinct,
    mixing_errors,
    mixture,
    turned,
)
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import FieldPsfs, Heights, Places
from gpusim.scene.highlights import Highlights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

# Share of the PSF's light that may lie elsewhere at one side of a square than at the other, for a
# tolerance of 1e-3: one PSF is taken of all of it, and larger ones are cut up. What is too much on
# one half is too little on the other: next to the highlight this errs by a tenth of it.
CHANGE = 0.01
# Share of the tolerance by which mixing between angles may err, of the largest value of a
# highlight's light. Corners of aperture and square move most, and where they are far apart for the
# PSF's width it errs most: by 2e-5 with 16 angles in 90 degrees (double Gauss at f/2.8, pixels of
# 1.55 um) for squares of 3 um, by 4e-4 for squares of 6 um; and with the fourth power of the step.
MIXING = 0.5
# Share of the tolerance by which the light far from a lamp may err for want of samples.
FAR = 0.5
# Samples of a table along one of the bank's where points of light stand alone. Between samples of
# the bank a sharp PSF's kernels have detail that cubics miss, which lamps of many squares average
# out: within 2 pixels of a point at f/2.8 4e-3 of the light there.
FINE = 2
FIELDS_TRIED = 5  # with which it is found out how finely tables must be sampled
# A bundle of highlights has one kernel: so much of that share may PSFs differ by across it. Against
# the exact model, lamps of a desk before the demonstration camera err by 8.2e-4 of their light (RMS
# of 60 pixels; 3.9e-3 in the first level of the halo), with a kernel each by 7.9e-4 (3.7e-3), and
# with 1.0 in place of 0.25 by 1.2e-3 (5.0e-3).
BUNDLE = 0.25
DISPATCH_BYTES = 128 << 20  # of a dispatch's kernels; so much, as texels, every adapter holds
# All tables together. Scattered highlights need many, and are content with FEWEST angles.
TABLE_BYTES = 768 << 20
FEWEST = 8
# Squares that are cut up further for want of memory: 16,000 take 8 s by HIGHLIGHT_NS (a window
# of 64 um before pixels of 1.55 um).
MOST_CUT = 1 << 13
SMALLER = 0.75  # each time that squares are cut up further for want of memory
ALIKE = 0.1  # of the tolerance: what a highlight may differ by from a sum of others' spectra


class Share(NamedTuple):
    """Numbers of the colour channels and of the scene's spectra whose light is added at once."""

    channels: list[int]
    spectra: list[int]


@dataclass(frozen=True, eq=False)
class HighlightPlan:
    """Highlights that reach pixels, and the kernels that will bring their light there.

    Attributes
    ----------
    bank, sensor
    fields : tuple of int
        Fields of the bank at which tables are made.
    squares : Squares
        What the highlights are cut up into; N of them, in the spectra of the tables.
    kernels : Tables
        What makes the tables.
    sampling : Sampling
        Where these are sampled.
    bins : int
        Angles of tables in 90 degrees.
    owner : ndarray (N,) of int
        Bundle of each square.
    mixed : Mixture
        Tables of each bundle, and their shares.
    axis : ndarray (N, 2)
        Direction of the PSFs' x axis at each square.
    used : ndarray (T, 3) of int
        The tables: place of the field in the list, angle, number of the size.
    tables : ndarray (bundles, K) of int
        Number of each bundle's tables.
    opposite : ndarray (T,) of bool
        Which tables lie beyond the axis.
    shapes : ndarray (T, 2, 2)
        Sides of the square in each table, um.
    """

    bank: FieldBank
    sensor: Sensor
    fields: tuple[int, ...]
    squares: Squares
    kernels: Tables
    sampling: Sampling
    bins: int
    owner: np.ndarray
    mixed: Mixture
    axis: np.ndarray
    used: np.ndarray
    tables: np.ndarray
    opposite: np.ndarray
    shapes: np.ndarray

    @cached_property
    def position(self) -> np.ndarray:
        """Places (N, 2) of the squares, x and y, pixels."""
        sensor = self.sensor
        middle = np.array([sensor.cols, sensor.rows]) / 2
        return self.squares.real_um / sensor.pixel_pitch_um + middle

    def shares(self) -> list[Share]:
        """Return the channels and spectra whose light is added at once."""
        own = 16 * self.sampling.samples * self.tables.shape[1]
        spectra = self.squares.light.shape[1]
        return shares(len(self.sensor.channels), spectra, DISPATCH_BYTES // own)

    def groups(self) -> list[np.ndarray]:
        """Return bundles in lists whose kernels a dispatch binds."""
        largest = max(len(c) * -(-len(m) // 4) for c, m in self.shares())
        return groups(self.tables, 16 * largest * self.sampling.samples)

    def work(self) -> dict[str, float]:
        """Return the samples of all tables by wavelength, and the highlights' pixels."""
        planes = planes_of(self.sensor)
        pixels = math.pi * (self.kernels.reach_um / self.sensor.pixel_pitch_um) ** 2
        pixels = min(pixels, self.sensor.rows * self.sensor.cols)
        pixels *= len(planes.channels) / planes.period**2
        lines = len(self.bank.wavelengths_nm)
        return {
            "tables": float(len(self.used) * lines * self.kernels.side**2),
            "point sources": float(len(self.squares.light) * pixels),
        }


def plan_highlights(
    bank: FieldBank,
    sensor: Sensor,
    highlights: Highlights,
    spectra: np.ndarray,
    tolerance: float,
    *,
    wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
) -> HighlightPlan | None:
    """Return how the light of highlights will be summed; none where no pixel sees any of it.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    highlights : Highlights
        One or more.
    spectra : ndarray (M, K)
        Spectra of the scene.
    tolerance : float
        Tolerance of the planner.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.
    """
    half_um = np.array([sensor.cols, sensor.rows]) * sensor.pixel_pitch_um / 2
    # As far as light can come from; some highlights there still miss all pixels.
    reach_um = bank.psf.shape[-1] * bank.pitch_um + bank.lateral_um
    fields, places = bank.places(float(np.hypot(*half_um)) + reach_um)
    change = CHANGE / np.sqrt(1e-3 / tolerance)
    squares = squares_on_sensor(bank, sensor, highlights, reach_um, change=change)
    if not len(squares.light):
        return None
    some = np.unique(np.linspace(0, len(fields) - 1, FIELDS_TRIED).astype(int))
    tried = [bank.field(fields[number]) for number in some]
    while True:
        few, light = of_few_spectra(squares.light, ALIKE * tolerance)
        squares = replace(squares, light=light)
        sides = np.linalg.norm(squares.slopes, 2, axis=(1, 2)) * squares.size_um
        given = bank, sensor, few @ spectra, sides.max(), wavelengths_nm
        kernels = Tables(*given, fine=FINE if highlights.alone else 1)
        sampled = sampling(kernels, tried, FAR * tolerance, alone=highlights.alone)
        table_bytes = 16 * -(-len(few) // 4) * len(sensor.channels) * sampled.samples
        bins, turn = _angles(kernels, places, tried[::2], MIXING * tolerance)
        owner, bundles = bundled(bank, squares, BUNDLE * change, turn)
        mixed = mixture(places, bundles, bins, kernels.turns)
        enough = _held(mixed, table_bytes) or bins == FEWEST
        if enough or sides.max() <= sensor.pixel_pitch_um or len(light) > MOST_CUT:
            break
        # Smaller ones need fewer angles, and those that come of one highlight share tables.
        sizes = {"change": change, "most_um": squares.size_um.max() * SMALLER}
        squares = squares_on_sensor(bank, sensor, highlights, reach_um, **sizes)
    while bins > FEWEST and not _held(mixed, table_bytes):
        bins = max(FEWEST, bins // 2)
        mixed = mixture(places, bundles, bins, kernels.turns)
    _, _, cos, sin = places.blends(*squares.real_um.T)
    used, tables = distinct(mixed.keys)
    return HighlightPlan(
        bank=bank,
        sensor=sensor,
        fields=fields,
        squares=squares,
        kernels=kernels,
        sampling=sampled,
        bins=bins,
        owner=owner,
        mixed=mixed,
        axis=np.stack([cos, sin], axis=1),
        used=used,
        tables=tables,
        opposite=np.isin(used[:, 0], places.opposite),
        shapes=_mean_shapes(bundles, mixed, tables, len(used)),
    )


def _angles(
    kernels: Tables, places: Places, tried: list[FieldPsfs], allowed: float
) -> tuple[int, float]:
    """Return the angles of tables in 90 degrees, and how long a bundle's part of a ring may be.

    By what mixing between angles errs at some fields. The length is in radians.
    """
    # PSFs of lenses without an axis are not turned.
    errors = MixingErrors(0.0, 0.0)
    if isinstance(places, Heights):
        errors = mixing_errors(kernels, tried)
    bins = max(FEWEST, math.ceil(TRIED * (errors.cubic / allowed) ** 0.25))
    # Corners turn by 4 A per radian where straight lines over a step h err by 2 h^2 A.
    return bins, (np.pi / 2 / max(TRIED * math.sqrt(errors.linear / allowed), 1.0)) ** 2


def _held(mixed: Mixture, table_bytes: int) -> bool:
    """Return whether the memory for tables holds those of a mixture."""
    return len(distinct(mixed.keys)[0]) * table_bytes <= TABLE_BYTES


def _mean_shapes(bundles: Squares, mixed: Mixture, tables: np.ndarray, count: int) -> np.ndarray:
    """Return the shape (count, 2, 2) of the squares of each table.

    The map changes slowly: those that share a table share the mean of their shapes in it.
    """
    shapes = np.zeros((count, 2, 2))
    own = turned(bundles.slopes, mixed.axis) * bundles.size_um[:, None, None]
    np.add.at(shapes, tables, own[:, None])
    return shapes / np.bincount(tables.ravel())[:, None, None]


def shares(channels: int, spectra: int, most: int) -> list[Share]:
    """Return as few shares as there must be of all light, where a dispatch binds `most` tables.

    Each of one channel and four spectra; at least one table is bound.
    """
    fours = max(most // channels, 1)
    together = channels if most >= channels else max(most, 1)
    return [
        Share([*range(c, min(c + together, channels))], [*range(m, min(m + 4 * fours, spectra))])
        for c in range(0, channels, together)
        for m in range(0, spectra, 4 * fours)
    ]


def groups(tables: np.ndarray, table_bytes: int) -> list[np.ndarray]:
    """Cut bundles, in order of their tables (N, K), into lists whose kernels a dispatch binds.

    Nor are the tables that these are blended of more.
    """
    most = max(DISPATCH_BYTES // table_bytes, tables.shape[1])
    result: list[list[int]] = []
    used: set[int] = set()
    for number in np.argsort(tables[:, 0], kind="stable"):
        own = set(tables[number].tolist())
        if not result or len(used | own) > most or len(result[-1]) == most:
            result.append([])
            used = set()
        used |= own
        result[-1].append(int(number))
    return [np.array(one) for one in result]
