"""Host side of point_sources: a photograph's highlights, each with the kernels of its own place.

All sums are of what is not negative, or compact: light ends where the PSF does.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gpusim.gpu import Device, Kernel, Recording, Resident, Use
from gpusim.optics.convolve import packed_channels
from gpusim.optics.highlight_sampling import sampling
from gpusim.optics.highlight_squares import bundled, of_few_spectra, squares_on_sensor
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
from gpusim.parallel import each
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import FieldPsfs, Heights, half_turned
from gpusim.scene.highlights import Highlights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

Rect = tuple[int, int, int, int]  # first row and column, rows and columns

HIGHLIGHT = np.dtype(
    [
        ("pixel", "<i4", 2),
        ("place", "<f4", 2),
        ("axis", "<f4", 2),
        ("kernel", "<u4"),
        ("padding", "<u4"),
    ]
)
SQUARE = 16  # CFA cells along a side of the squares for which highlights are listed
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
NOT_HERE = 15  # in place of the channel of a site that has none of the tables
HIGHLIGHT_NS = 300.0  # for each highlight and pixel: lavapipe, 2 cores
PIECE_S = 0.25  # of the device's time in one go: as long as a person who interrupts it waits


class PointSources:
    """Highlights, and the light that they bring to the pixels.

    Parameters
    ----------
    device : Device or None
        None: to plan, and not to run.
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

    def __init__(
        self,
        device: Device | None,
        bank: FieldBank,
        sensor: Sensor,
        highlights: Highlights,
        spectra: np.ndarray,
        tolerance: float,
        wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
    ) -> None:
        self.device, self.bank, self.sensor = device, bank, sensor
        planes = planes_of(sensor)
        self.period, self.planes = planes.period, len(planes.channels)
        half_um = np.array([sensor.cols, sensor.rows]) * sensor.pixel_pitch_um / 2
        # As far as light can come from; some highlights there still miss all pixels.
        reach_um = bank.psf.shape[-1] * bank.pitch_um + bank.lateral_um
        self.fields, places = bank.places(float(np.hypot(*half_um)) + reach_um)
        finer = np.sqrt(1e-3 / tolerance)
        change = CHANGE / finer
        squares = squares_on_sensor(bank, sensor, highlights, reach_um, change)
        self.groups: list[np.ndarray] = []
        self.shares: list[Share] = []
        self.squares = squares
        if not len(squares.light):
            return
        channels, alone = len(sensor.channels), highlights.alone
        while True:
            few, light = of_few_spectra(squares.light, ALIKE * tolerance)
            self.squares = squares = replace(squares, light=light)
            sides = np.linalg.norm(squares.slopes, 2, axis=(1, 2)) * squares.size_um
            given = bank, sensor, few @ spectra, sides.max(), wavelengths_nm
            self.kernels = kernels = Tables(*given, fine=FINE if alone else 1)
            some = np.unique(np.linspace(0, len(self.fields) - 1, FIELDS_TRIED).astype(int))
            tried = [bank.field(self.fields[number]) for number in some]
            self.sampling = sampling(kernels, tried, FAR * tolerance, alone)
            self.table_bytes = 16 * -(-len(few) // 4) * channels * self.sampling.samples
            # PSFs of lenses without an axis are not turned.
            errors = MixingErrors(0.0, 0.0)
            if isinstance(places, Heights):
                errors = mixing_errors(kernels, tried[::2])
            allowed = MIXING * tolerance
            self.bins = max(FEWEST, math.ceil(TRIED * (errors.cubic / allowed) ** 0.25))
            # Corners turn by 4 A per radian where straight lines over a step h err by 2 h^2 A.
            turn = (np.pi / 2 / max(TRIED * math.sqrt(errors.linear / allowed), 1.0)) ** 2
            self.owner, bundles = bundled(bank, squares, BUNDLE * change, turn)
            mixed = mixture(places, bundles, self.bins, kernels.turns)
            enough = self._holds(mixed) or self.bins == FEWEST
            if enough or sides.max() <= sensor.pixel_pitch_um or len(light) > MOST_CUT:
                break
            # Smaller ones need fewer angles, and those that come of one highlight share tables.
            most_um = squares.size_um.max() * SMALLER
            squares = squares_on_sensor(bank, sensor, highlights, reach_um, change, most_um)
        while self.bins > FEWEST and not self._holds(mixed):
            self.bins = max(FEWEST, self.bins // 2)
            mixed = mixture(places, bundles, self.bins, kernels.turns)
        self.across, self.down = (
            -(-count // (self.period * SQUARE)) for count in (sensor.cols, sensor.rows)
        )
        self.mixed = mixed
        _, _, cos, sin = places.blends(*squares.real_um.T)
        self.axis = np.stack([cos, sin], axis=1)
        self.used, self.tables = distinct(mixed.keys)
        self.opposite = np.isin(self.used[:, 0], places.opposite)
        # The map changes slowly: those that share a table share the mean of their shapes in it.
        self.shapes = np.zeros((len(self.used), 2, 2))
        own = turned(bundles.slopes, mixed.axis) * bundles.size_um[:, None, None]
        np.add.at(self.shapes, self.tables, own[:, None])
        self.shapes /= np.bincount(self.tables.ravel())[:, None, None]
        self.position = squares.real_um / sensor.pixel_pitch_um
        self.position += np.array([sensor.cols, sensor.rows]) / 2
        own = 16 * self.sampling.samples * self.tables.shape[1]
        self.shares = shares(channels, len(few), DISPATCH_BYTES // own)
        self.kernel_of = {
            count: Kernel(
                "optics/point_sources",
                S=self.planes,
                PERIOD=self.period,
                C=count,
                NEAR=self.sampling.near,
                FAR=self.sampling.far,
            )
            for count in {len(one.channels) for one in self.shares}
        }
        largest = max(len(c) * -(-len(m) // 4) for c, m in self.shares)
        self.groups = groups(self.tables, 16 * largest * self.sampling.samples)

    def _holds(self, mixed: Mixture) -> bool:
        """Return whether the memory for tables holds those of a mixture."""
        return len(distinct(mixed.keys)[0]) * self.table_bytes <= TABLE_BYTES

    def work(self) -> dict[str, float]:
        """Return the samples of all tables by wavelength, and the highlights' pixels."""
        if not self.groups:
            return {"tables": 0.0, "point sources": 0.0}
        lines = len(self.bank.wavelengths_nm)
        pixels = math.pi * (self.kernels.reach_um / self.sensor.pixel_pitch_um) ** 2
        pixels = min(pixels, self.sensor.rows * self.sensor.cols)
        pixels *= self.planes / self.period**2
        return {
            "tables": float(len(self.used) * lines * self.kernels.side**2),
            "point sources": float(len(self.squares.light) * pixels),
        }

    def light(
        self, tiles: Sequence[Rect], progress: Callable[[int, int], None] | None = None
    ) -> list[np.ndarray]:
        """Return the electrons/s (S, rows, cols) that highlights bring to tiles of the sensor.

        Each the same, bit for bit, whatever the others: every pixel takes its highlights in one
        order.

        Parameters
        ----------
        tiles : sequence of (row0, col0, rows, cols)
            Rectangles of pixels, aligned to the CFA period.
        progress : callable, optional
            Called with (done, total) tables made and pieces of their sums.
        """
        cells = [tuple(-(-value // self.period) for value in tile) for tile in tiles]
        light = [np.zeros((self.planes, *tile[2:]), np.float32) for tile in cells]
        if not self.groups:
            return light
        reaching = self._reaches(cells)
        near = [np.flatnonzero(np.isin(self.owner, own) & reaching) for own in self.groups]
        near = [own for own in near if len(own)]
        work = []
        for own in near:
            starts, listed = self._lists(own)
            pieces = [self._pieces(starts, tile) for tile in cells]
            work.append((own, starts, listed, pieces))
        # One after another: a table that the last ones had is there.
        held = np.zeros(0, int)
        total = 0
        for own, _, _, pieces in work:
            needed = self._needed(own)
            total += len(np.setdiff1d(needed, held)) + sum(map(len, pieces))
            held = needed
        total *= len(self.shares)
        done = itertools.count(1)

        def advance() -> None:
            if progress is not None:
                progress(next(done), total)

        for share in self.shares:
            made: dict[int, np.ndarray] = {}
            for own, starts, listed, pieces in work:
                made = self._made(share, self._needed(own), made, advance)
                with self._on_device(share, own, starts, listed, made) as arrays:
                    for tile, found, rects in zip(cells, light, pieces, strict=True):
                        if rects:
                            self._add(share, arrays, tile, rects, found, advance)
        return light

    def _needed(self, own: np.ndarray) -> np.ndarray:
        """Return the numbers of the tables that squares need."""
        return np.unique(self.tables[np.unique(self.owner[own])])

    def _reaches(self, cells: Sequence[Rect]) -> np.ndarray:
        """Return which squares reach into one of some rectangles of CFA cells."""
        reach = self.kernels.reach_um / self.sensor.pixel_pitch_um / self.period + 1
        at = self.position / self.period
        found = np.zeros(len(at), bool)
        for row, col, rows, cols in cells:
            off = np.maximum(np.array([col, row]) - at, at - np.array([col + cols, row + rows]))
            found |= (off < reach).all(axis=1)
        return found

    def _lists(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reach = self.kernels.reach_um / (self.sensor.pixel_pitch_um * self.period)
        return lists(self.position[own] / self.period, reach, (self.across, self.down))

    def _pieces(self, starts: np.ndarray, tile: Rect) -> list[Rect]:
        """Cut a tile of CFA cells, by squares of cells, into parts of at most PIECE_S each.

        Row and column of the first square, rows and columns; those that no highlight reaches are
        left out.
        """
        row, col, rows, cols = tile
        counts = np.diff(starts.astype(np.int64)).reshape(self.down, self.across)
        most = PIECE_S / (1e-9 * HIGHLIGHT_NS * self.planes * SQUARE**2)
        top, left = row // SQUARE, col // SQUARE
        bottom, right = (row + rows - 1) // SQUARE + 1, (col + cols - 1) // SQUARE + 1
        todo, found = [(top, left, bottom - top, right - left)], []
        while todo:
            y, x, high, wide = part = todo.pop()
            count = counts[y : y + high, x : x + wide].sum()
            if not count:
                continue
            if count <= most or high == wide == 1:
                found.append(part)
            elif high >= wide:
                todo += [(y, x, high // 2, wide), (y + high // 2, x, high - high // 2, wide)]
            else:
                todo += [(y, x, high, wide // 2), (y, x + wide // 2, high, wide - wide // 2)]
        return found

    def _made(
        self,
        share: Share,
        needed: np.ndarray,
        before: dict[int, np.ndarray],
        advance: Callable[[], None],
    ) -> dict[int, np.ndarray]:
        """Return tables by number; those that were made before are taken over."""
        lacking = [number for number in needed.tolist() if number not in before]
        made = {number: before[number] for number in needed.tolist() if number in before}
        by_field: dict[int, tuple[FieldPsfs, np.ndarray]] = {}
        for number in lacking:
            of_field = self.fields[self.used[number, 0]]
            if of_field not in by_field:
                field = self.bank.field(of_field)
                by_field[of_field] = field, self.kernels.spectra(field)

        def one(number: int) -> np.ndarray:
            of_field = self.fields[self.used[number, 0]]
            # Beyond the axis everything is half a turn on: aperture and square are as they are.
            half = np.pi * self.opposite[number]
            angle = np.pi / 2 * self.used[number, 1] / self.bins + half
            weights = self.kernels.weights_at(of_field, angle)[
                np.ix_(share.channels, share.spectra)
            ]
            table = self.kernels.table(*by_field[of_field], weights, angle, self.shapes[number])
            table = half_turned(table) if half else table
            return np.moveaxis(in_fours(np.moveaxis(self.sampling.of(table), 1, -1)), -2, 1)

        tables = each(one, lacking, lambda _done, _total: advance())
        return made | dict(zip(lacking, tables, strict=True))

    def _blended(self, bundles: np.ndarray, made: dict[int, np.ndarray]) -> np.ndarray:
        """Return the kernels of bundles, sums of tables."""
        some = next(iter(made.values()))
        kernels = np.empty((len(bundles), *some.shape), np.float32)

        def one(place: int) -> None:
            bundle = bundles[place]
            tables = [made[number] for number in self.tables[bundle].tolist()]
            shares = self.mixed.shares[bundle].astype(np.float32)
            # Plane by plane: a product then stays in the processor's cache until it is added.
            for plane in np.ndindex(some.shape[:2]):
                total = kernels[place][plane]
                np.multiply(tables[0][plane], shares[0], out=total)
                for share, table in zip(shares[1:], tables[1:], strict=True):
                    total += share * table[plane]

        each(one, range(len(bundles)))
        return kernels

    @contextmanager
    def _on_device(
        self,
        share: Share,
        own: np.ndarray,
        starts: np.ndarray,
        near: np.ndarray,
        made: dict[int, np.ndarray],
    ) -> Iterator[dict[str, Resident]]:
        """Bring squares, their lists and their bundles' kernels onto the device for a while."""
        bundles, kernel = np.unique(self.owner[own], return_inverse=True)
        scale = self.sensor.pixel_pitch_um / self.kernels.pitch_um
        rows = np.zeros(len(own), HIGHLIGHT)
        position = self.position[own]
        rows["pixel"] = np.floor(position)
        rows["place"] = position - np.floor(position) - 0.5
        rows["axis"] = self.axis[own] * scale
        rows["kernel"] = kernel.reshape(-1)
        arrays = {
            "highlights": rows.view(np.uint32),
            "radiance": in_fours(self.squares.light[own][:, share.spectra]),
            "starts": starts,
            "near": near,
        }
        resident: dict[str, Resident] = {}
        try:
            for name, array in arrays.items():
                resident[name] = self.device.resident(f"point sources: {name}", array)
            kernels = self._blended(bundles, made)
            resident["kernels"] = self.device.resident(
                "point sources: kernels", kernels, Use.TEXELS
            )
            yield resident
        finally:
            for one in resident.values():
                one.destroy()

    def _add(
        self,
        share: Share,
        arrays: dict[str, Resident],
        tile: Rect,
        rects: list[Rect],
        light: np.ndarray,
        advance: Callable[[], None],
    ) -> None:
        """Add the light of squares on the device to that of a tile of CFA cells (S, rows, cols)."""
        row0, col0, rows, cols = tile
        local = [
            share.channels.index(one) if one in share.channels else NOT_HERE
            for one in planes_of(self.sensor).channels
        ]
        rec = Recording(self.device)
        rates = rec.buffer("rates", light.shape, np.float32)
        rec.upload(rates, light)
        for top, left, high, wide in rects:
            self.kernel_of[len(share.channels)].record(
                rec,
                groups=(wide, high, self.planes),
                params={
                    "first": (left, top),
                    "origin": (col0, row0),
                    "size": (cols, rows),
                    "across": self.across,
                    # Reaches from a table's middle to zeros, and no tap lies beyond its border.
                    "reach2": (self.kernels.support + 2) ** 2,
                    "near2": self.sampling.radius**2,
                    "step": self.sampling.step,
                    "fours": -(-len(share.spectra) // 4),
                    "site_channels": packed_channels(local),
                },
                **arrays,
                rates=rates,
            )
            rec.mark()
        label = rec.download(rates)
        result = rec.run(lambda done, total: advance() if done <= len(rects) else None)
        light[...] = result[label]


class Share(NamedTuple):
    """Numbers of the colour channels and of the scene's spectra whose light is added at once."""

    channels: list[int]
    spectra: list[int]


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


def in_fours(values: np.ndarray) -> np.ndarray:
    """Return values (..., M) as (..., ceil(M/4), 4), float32, filled up with zeros."""
    fill = -values.shape[-1] % 4
    padded = np.pad(values.astype(np.float32), [(0, 0)] * (values.ndim - 1) + [(0, fill)])
    return padded.reshape(*values.shape[:-1], -1, 4)


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


def lists(
    position: np.ndarray, reach: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """List the highlights within reach of each square of `SQUARE` x `SQUARE` CFA cells.

    Parameters
    ----------
    position : ndarray (N, 2)
        x, y of the highlights, CFA cells.
    reach : float
        Reach of their light, CFA cells.
    size : (int, int)
        Squares across and down the sensor.

    Returns
    -------
    starts : ndarray (squares + 1,), uint32
    near : ndarray, uint32
        Highlights of each square, in rising order, from its start to the next one's.
    """
    # A pixel's centre lies within its cell: half a cell more on each side would do.
    low = np.floor((position - reach - 1) / SQUARE).astype(int).clip(0, size)
    high = (np.floor((position + reach + 1) / SQUARE).astype(int) + 1).clip(0, size)
    squares = [
        np.add.outer(np.arange(y0, y1) * size[0], np.arange(x0, x1)).ravel()
        for (x0, y0), (x1, y1) in zip(low, high, strict=True)
    ]
    owners = np.repeat(np.arange(len(squares)), [len(one) for one in squares])
    flat = np.concatenate(squares)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(size[0] * size[1] + 1))
    return starts.astype(np.uint32), np.append(owners[order], 0).astype(np.uint32)
