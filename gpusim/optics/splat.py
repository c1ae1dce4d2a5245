"""Host side of the splat stage: a photograph's highlights, each with the kernels of its own place.

The kernels are tabulated in the frame of the PSFs, at the fields of the bank, and mixed as the
truth mixes these. Behind a lens with an axis, the aperture of the pixel and the highlight's square
stand at an angle in it, the azimuth modulo 90 degrees: tables are made at `bins` angles, and mixed
linearly between the nearest two. All sums are of what is not negative, or compact: light ends where
the PSF does.

Colours lie at the chief rays of the bank's wavelengths, each as much as the splines between these
give it (`gpusim.psf.lines`): what aperture and square blur follows the streak between the chief
rays as closely as cubics do.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.fft
import scipy.linalg
from threadpoolctl import threadpool_limits

from gpusim.gpu import Device, Kernel, Recording, Resident
from gpusim.optics.angular import AngularResponse, PlaceWeights
from gpusim.optics.convolve import packed_channels
from gpusim.optics.fold import spectral_weights
from gpusim.psf.field_bank import FieldBank
from gpusim.psf.places import FieldPsfs, Heights, Places, half_turned
from gpusim.scene.highlights import Highlights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.aperture import Response
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

Rect = tuple[int, int, int, int]  # first row and column, rows and columns

HIGHLIGHT = np.dtype(
    [
        ("pixel", "<i4", 2),
        ("place", "<f4", 2),
        ("axis", "<f4", 2),
        ("padding", "<u4", 2),
    ]
)
PART = np.dtype([("table", "<u4"), ("share", "<f4")])
SQUARE = 16  # CFA cells along a side of the squares for which highlights are listed
# Share of the PSF's light that may lie elsewhere at one side of a square than at the other, for a
# tolerance of 1e-3: one PSF is taken of all of it, and larger ones are cut up. What is too much on
# one half is too little on the other: next to the highlight this errs by a tenth of it.
CHANGE = 0.01
# Share of the tolerance by which mixing between angles may err, of the largest value of a
# highlight's light. Corners of aperture and square move most, and where they are far apart for the
# PSF's width it errs most: by 6e-4 with 16 angles in 90 degrees (double Gauss at f/2.8, pixels of
# 1.55 um) for squares of 3 um, by 5e-3 for squares of 6 um; and with the square of the step.
MIXING = 0.5
TRIED = 16  # angles with which that is found out
# Parts of the spline's spectrum that its samples fold onto their own frequencies, as multiples of
# the samples' rate. What is left out is below SLIGHT, and weak in PSFs, which are sampled finely
# enough.
ALIASES = (0, -1, 1, -2, 2)
SLIGHT = 1e-5
DISPATCH_BYTES = 128 << 20  # of the tables of a dispatch: every adapter binds as much
# All tables together. Scattered highlights need many, and are content with FEWEST angles.
TABLE_BYTES = 512 << 20
FEWEST = 8
# Squares that are cut up further for want of memory: 16,000 take 8 s by SPLAT_NS (a window of 64 um
# before pixels of 1.55 um).
MOST_CUT = 1 << 13
SMALLER = 0.75  # each time that squares are cut up further for want of memory
ALIKE = 0.1  # of the tolerance: what a highlight may differ by from a sum of others' spectra
NOT_HERE = 15  # in place of the channel of a site that has none of the tables
SPLAT_NS = 300.0  # for each highlight and pixel: lavapipe, 2 cores
PIECE_S = 0.25  # of the device's time in one go: as long as a person who interrupts it waits
STEP_UM = 1e-3  # of differences of the chief-ray map, which is known to 1e-9 um
NEWTON_STEPS = 30
SMALL = 1e-7  # an angle whose sine is the angle
FOUND_UM = 1e-4  # how near to an ideal point its real one leads


def real_points(bank: FieldBank, ideal_um: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where ideal points (N, 2) land, the map's slopes there, and which do, by Newton steps.

    Returns
    -------
    real_um : ndarray (N, 2)
    slopes : ndarray (N, 2, 2)
        d(real)/d(ideal).
    lit : ndarray (N,) of bool
    """

    def to_ideal(real: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u, v, inside = bank.ideal_points(*real.T)
        return np.stack([u, v], axis=1), inside

    def slopes_at(real: np.ndarray) -> np.ndarray:
        columns = [
            (to_ideal(real + d)[0] - to_ideal(real - d)[0]) / (2 * STEP_UM)
            for d in STEP_UM * np.eye(2)
        ]
        return np.linalg.pinv(np.stack(columns, axis=2))

    centre = np.array(bank.centre_um)
    off = ideal_um - centre
    # From the inner side of the circle's rim, beyond which the map of some banks has no slope.
    rim = 0.99 * bank.rectilinear_circle_um / np.maximum(np.hypot(*off.T), 1e-9)
    real = centre + off * np.minimum(rim, 1.0)[:, None]
    for _ in range(NEWTON_STEPS):
        lack = ideal_um - to_ideal(real)[0]
        if np.abs(lack).max(initial=0.0) < FOUND_UM**2:
            break
        real = real + np.einsum("nij,nj->ni", slopes_at(real), lack)
    found, inside = to_ideal(real)
    lit = inside & (np.abs(found - ideal_um).max(axis=1) < FOUND_UM)
    return real, slopes_at(real), lit


@dataclass(frozen=True, eq=False)
class Squares:
    """Highlights on the real image plane, cut up into squares that share one PSF each.

    Attributes
    ----------
    real_um : ndarray (N, 2)
        Centres; x, y from the axis.
    size_um : ndarray (N,)
        Sides on the ideal plane.
    slopes : ndarray (N, 2, 2)
        d(real)/d(ideal).
    light : ndarray (N, M)
        Coefficients of the scene's spectra times the area on the real plane, um^2.
    """

    real_um: np.ndarray
    size_um: np.ndarray
    slopes: np.ndarray
    light: np.ndarray


def largest_um(bank: FieldBank, change: float, real_um: np.ndarray) -> np.ndarray:
    """Return the sides (N,) of squares across which so much of a PSF changes, at points (N, 2).

    By the PSFs of the fields around each, at the reference wavelength: half of the sum of their
    differences' sizes over how far they are apart; and of each PSF turned by a quarter of a turn,
    over the quarter of a circle. In a halo it changes twenty times as fast near the rim as half-way
    to it. For a lens without an axis the answer is that of the place where it changes fastest.
    """

    def psf(number: int) -> np.ndarray:
        found = bank.field(number).psf[bank.reference].astype(np.float64)
        return found / found.sum()

    fields, places = bank.places(bank.image_circle_um)
    steps = {
        (one, other): np.abs(psf(fields[one]) - psf(fields[other])).sum() / 2 / apart_um
        for one, other, apart_um in places.neighbours
    }
    most = np.full(len(real_um), max(steps.values(), default=0.0))
    if isinstance(places, Heights):
        # At a field: its own turn, and the change to the fields next to it.
        rates = np.zeros(len(places.radius_um))
        for number, radius_um in enumerate(places.radius_um[1:], start=1):
            found = psf(fields[number])[1:, 1:]  # about the middle
            rates[number] = np.abs(found - np.rot90(found)).sum() / 2 / (np.pi / 2 * radius_um)
        for pair, step in steps.items():
            rates[list(pair)] = np.maximum(rates[list(pair)], step)
        before = np.searchsorted(places.radius_um, np.hypot(*real_um.T), "right") - 1
        after = np.minimum(before + 1, len(rates) - 1)
        most = np.maximum(rates[before], rates[after])
    return change / np.maximum(most, np.finfo(float).tiny)


def squares_on_sensor(
    bank: FieldBank,
    sensor: Sensor,
    highlights: Highlights,
    reach_um: float,
    change: float = math.inf,
    most_um: float = math.inf,
) -> Squares:
    """Place highlights on the real plane; those that no pixel sees are left out.

    They are cut up into squares across which at most the share `change` of a PSF changes, and that
    are `most_um` wide at most.
    """
    pitch = sensor.pixel_pitch_um
    cuts = np.ones(len(highlights), int)
    if change < math.inf:
        of_psf = largest_um(bank, change, real_points(bank, highlights.centre_um)[0])
        most = np.minimum(of_psf, most_um)
        cuts = np.maximum(np.ceil(highlights.size_um / most), 1).astype(int)
    ideal, size, excess = [], [], []
    for count in np.unique(cuts):
        own = np.flatnonzero(cuts == count)
        side = highlights.size_um / count
        line = (np.arange(count) - (count - 1) / 2) * side
        inner = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        ideal.append((highlights.centre_um[own, None] + inner).reshape(-1, 2))
        size.append(np.full(len(ideal[-1]), side))
        excess.append(np.repeat(highlights.excess[own], len(inner), axis=0))
    sizes = np.concatenate(size)
    real, slopes, lit = real_points(bank, np.concatenate(ideal))
    half = np.array([sensor.cols, sensor.rows]) * pitch / 2
    seen = lit & np.all(np.abs(real) < half + reach_um, axis=1)
    light = np.concatenate(excess) * (sizes**2 * np.abs(np.linalg.det(slopes)))[:, None]
    return Squares(real[seen], sizes[seen], slopes[seen], light[seen])


class Tables:
    """Kernels of squares, by field of the bank, angle and shape of the square.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    spectra : ndarray (M, K)
    largest_um : float
        Side of the squares on the real plane, where it is largest.
    wavelengths_nm : ndarray (K,)
        Samples of the spectra.
    """

    def __init__(
        self,
        bank: FieldBank,
        sensor: Sensor,
        spectra: np.ndarray,
        largest_um: float,
        wavelengths_nm: np.ndarray = WAVELENGTHS_NM,
    ) -> None:
        self.bank = bank
        self.largest_um = largest_um
        self.aperture_um = sensor.response_um
        per_radiance = spectral_weights(bank, sensor, wavelengths_nm=wavelengths_nm)
        self.weights = np.einsum("clw,mw->cml", per_radiance, spectra)
        self.elsewhere = None
        if sensor.eqe_map is not None:
            response = AngularResponse(bank, sensor, wavelengths_nm)
            alike = np.ones((1, 1, wavelengths_nm.size))
            even = spectral_weights(bank, sensor, alike, wavelengths_nm)[0]
            self.elsewhere = PlaceWeights(response, even, spectra, 0.0)
        aperture_um = self.aperture_um
        if isinstance(aperture_um, Response):
            aperture_um = 2 * aperture_um.reach
        # From the middle of aperture and square to their corners, and lateral colour.
        corner = (aperture_um + largest_um) / np.sqrt(2) + bank.lateral_um
        n = bank.psf.shape[-1]
        at = np.arange(n) - n // 2
        psf_lit = bank.psf.reshape(-1, n, n).any(axis=0)
        self.support = np.hypot(at, at[:, None])[psf_lit].max() + 2 + corner / bank.pitch_um
        self.side = scipy.fft.next_fast_len(2 * math.ceil(self.support + 5), real=True)
        self.side += self.side % 2

    @property
    def reach_um(self) -> float:
        """Distance beyond which a square gives no light."""
        return self.support * self.bank.pitch_um

    def spectra(self, field: FieldPsfs) -> np.ndarray:
        """Return the spectra (L, side, side / 2 + 1) of a field's PSFs, as density per um^2.

        Samples of the cubic B-spline have the transform (2 + cos) / 3 in each direction. It is
        divided out twice: once the PSF's samples become spline coefficients, and once what is
        tabulated does.
        """
        n, side = field.psf.shape[-1], self.side
        before = side // 2 - n // 2
        psf = field.psf.astype(np.float64) / self.bank.pitch_um**2
        padded = np.pad(psf, ((0, 0), *[(before, side - n - before)] * 2))
        line = (2 + np.cos(2 * np.pi * scipy.fft.fftfreq(side))) / 3
        return scipy.fft.rfft2(padded) / (line[:, None] * line[: side // 2 + 1]) ** 2

    @property
    def turns(self) -> int:
        """Quarters of a turn after which kernels are the same again."""
        turning = self.elsewhere is not None and self.elsewhere.response.turning
        return 4 if turning or isinstance(self.aperture_um, Response) else 1

    def weights_at(self, number: int, angle: float) -> np.ndarray:
        """Return electrons/s (C, M, L) of the scene's spectra at a field of the bank."""
        if self.elsewhere is None:
            return self.weights
        return self.elsewhere.of_field_at(number, angle).swapaxes(0, 1)

    def table(
        self,
        field: FieldPsfs,
        spectra: np.ndarray,
        weights: np.ndarray,
        angle: float,
        square: np.ndarray,
    ) -> np.ndarray:
        """Return spline coefficients (C, M, side, side) of a field's kernels at one angle.

        Electrons/s per um^2 of the square on the real plane and unit of the scene's spectra.

        Parameters
        ----------
        field : FieldPsfs
        spectra : ndarray
            As `spectra` returns them.
        weights : ndarray (C, M, L)
            As `weights_at` returns them.
        angle : float
            Azimuth, radians: that of the PSFs' x axis.
        square : ndarray (2, 2)
            Its sides in the frame of the PSFs at azimuth 0, um: d(real)/d(ideal) times the side.
        """
        shifts, pitch_um = field.shift_um / self.bank.pitch_um, self.bank.pitch_um
        spread = spectra * boxes(self.side, pitch_um, self.aperture_um, shifts, angle, square)
        mixed = np.tensordot(weights * field.relative_illumination, spread, axes=1)
        table = scipy.fft.irfft2(mixed, s=(self.side, self.side))
        at = np.arange(self.side) - self.side // 2
        # Beyond lies rounding; and where the PSF is cut off, its spline swings below zero.
        table[..., np.hypot(at, at[:, None]) > self.support] = 0.0
        return np.maximum(table, 0.0)


def boxes(
    side: int,
    pitch_um: float,
    aperture_um: float | Response,
    shifts: np.ndarray,
    angle: float,
    square: np.ndarray,
) -> np.ndarray:
    """Return spectra of the cubic B-spline averaged over aperture and square.

    (L, side, side / 2 + 1), in the frame of the PSFs, whose samples are the pitch apart; each
    wavelength (L, 2) lies where lateral colour moves it, samples. What is known in between, the
    transform of samples folds onto their own frequencies: sinc^4 of the spline, with a sinc for
    each side of aperture and square. ``angle`` and ``square``: see `Tables.table`.
    """
    fy, fx = scipy.fft.fftfreq(side), scipy.fft.rfftfreq(side)
    # Columns are the PSFs' x and y axis.
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    result = np.zeros((len(shifts), side, len(fx)), np.complex128)
    for down, across in itertools.product(ALIASES, ALIASES):
        y, x = fy + down, fx + across
        of_y, of_x = np.sinc(y) ** 4, np.sinc(x) ** 4
        if of_y.max() * of_x.max() < SLIGHT:
            continue
        one = _turned_box(turn @ square.T / pitch_um, x, y)
        if isinstance(aperture_um, Response):
            aperture = aperture_um / pitch_um
            one = one * aperture.spectrum(
                turn[0, 0] * x + turn[0, 1] * y[:, None],
                turn[1, 0] * x + turn[1, 1] * y[:, None],
            )
        else:
            one *= _turned_box(aperture_um / pitch_um * turn, x, y)
        one *= of_x
        one *= of_y[:, None]
        for found, (moved_x, moved_y) in zip(result, shifts, strict=True):
            found += np.exp(-2j * np.pi * (across * moved_x + down * moved_y)) * one
    for found, (moved_x, moved_y) in zip(result, shifts, strict=True):
        found *= np.exp(-2j * np.pi * moved_x * fx)
        if moved_y:
            found *= np.exp(-2j * np.pi * moved_y * fy)[:, None]
    return result


def _turned_box(sides: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the spectrum (Y, X) of an even parallelogram at frequencies x (X,) and y (Y,).

    `sides` (2, 2): its sides as rows; sinc of each one's product with the frequency.
    """
    found = 1.0
    for of_x, of_y in np.pi * sides:
        a, b = of_x * x, (of_y * y)[:, None]
        # sin(a + b) from those of its parts: two lines instead of a plane of them.
        sine = np.sin(a) * np.cos(b)
        sine += np.cos(a) * np.sin(b)
        total = a + b
        small = np.abs(total) < SMALL
        total[small] = 1.0
        sine /= total
        sine[small] = 1.0
        found = found * sine
    return found


class Splat:
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
        channels = len(sensor.channels)
        while True:
            few, light = of_few_spectra(squares.light, ALIKE * tolerance)
            self.squares = squares = replace(squares, light=light)
            sides = np.linalg.norm(squares.slopes, 2, axis=(1, 2)) * squares.size_um
            given = bank, sensor, few @ spectra, sides.max(), wavelengths_nm
            self.kernels = kernels = Tables(*given)
            self.table_bytes = 16 * -(-len(few) // 4) * channels * kernels.side**2
            seen = {0, len(self.fields) // 2, len(self.fields) - 1}
            error = mixing_error(kernels, [bank.field(self.fields[n]) for n in sorted(seen)])
            asked = TRIED * math.sqrt(error / (MIXING * tolerance))
            self.bins = max(FEWEST, math.ceil(asked))
            mixed = mixture(places, squares, self.bins, kernels.turns)
            enough = self._holds(mixed) or self.bins == FEWEST
            if enough or sides.max() <= sensor.pixel_pitch_um or len(light) > MOST_CUT:
                break
            # Smaller ones need fewer angles, and those that come of one highlight share tables.
            most_um = squares.size_um.max() * SMALLER
            squares = squares_on_sensor(bank, sensor, highlights, reach_um, change, most_um)
        while self.bins > FEWEST and not self._holds(mixed):
            self.bins = max(FEWEST, self.bins // 2)
            mixed = mixture(places, squares, self.bins, kernels.turns)
        self.across, self.down = (
            -(-count // (self.period * SQUARE)) for count in (sensor.cols, sensor.rows)
        )
        self.mixed = mixed
        self.used, self.tables = distinct(mixed.keys)
        self.opposite = np.isin(self.used[:, 0], places.opposite)
        # The map changes slowly: those that share a table share the mean of their shapes in it.
        self.shapes = np.zeros((len(self.used), 2, 2))
        own = turned(squares.slopes, mixed.axis) * squares.size_um[:, None, None]
        np.add.at(self.shapes, self.tables, own[:, None])
        self.shapes /= np.bincount(self.tables.ravel())[:, None, None]
        self.position = squares.real_um / sensor.pixel_pitch_um
        self.position += np.array([sensor.cols, sensor.rows]) / 2
        own = 16 * kernels.side**2 * self.tables.shape[1]
        self.shares = shares(channels, len(few), DISPATCH_BYTES // own)
        self.kernel_of = {
            count: Kernel(
                "optics/splat", S=self.planes, PERIOD=self.period, C=count, N=kernels.side
            )
            for count in {len(one.channels) for one in self.shares}
        }
        largest = max(len(c) * -(-len(m) // 4) for c, m in self.shares)
        self.groups = groups(self.tables, 16 * largest * kernels.side**2)

    def _holds(self, mixed: Mixture) -> bool:
        """Return whether the memory for tables holds those of a mixture."""
        return len(distinct(mixed.keys)[0]) * self.table_bytes <= TABLE_BYTES

    def work(self) -> dict[str, float]:
        """Return the samples of all tables by wavelength, and the highlights' pixels."""
        if not self.groups:
            return {"tables": 0.0, "splat": 0.0}
        lines = len(self.bank.wavelengths_nm)
        pixels = math.pi * (self.kernels.reach_um / self.sensor.pixel_pitch_um) ** 2
        pixels = min(pixels, self.sensor.rows * self.sensor.cols)
        pixels *= self.planes / self.period**2
        return {
            "tables": float(len(self.used) * lines * self.kernels.side**2),
            "splat": float(len(self.squares.light) * pixels),
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
        near = [own[self._reaches(own, cells)] for own in self.groups]
        near = [own for own in near if len(own)]
        work = []
        for own in near:
            starts, listed = self._lists(own)
            pieces = [self._pieces(starts, tile) for tile in cells]
            work.append((own, starts, listed, pieces))
        # One after another: a table that the last ones had is there.
        held: list[int] = []
        total = 0
        for own, _, _, pieces in work:
            fresh = np.setdiff1d(self.tables[own], held)
            total += len(fresh) + sum(map(len, pieces))
            held = np.unique(self.tables[own])
        total *= len(self.shares)
        done = itertools.count(1)

        def advance() -> None:
            if progress is not None:
                progress(next(done), total)

        for share in self.shares:
            made: dict[int, np.ndarray] = {}
            for own, starts, listed, pieces in work:
                made = self._made(share, np.unique(self.tables[own]), made, advance)
                with self._on_device(share, own, starts, listed, made) as arrays:
                    for tile, found, rects in zip(cells, light, pieces, strict=True):
                        if rects:
                            self._add(share, arrays, tile, rects, found, advance)
        return light

    def _reaches(self, own: np.ndarray, cells: Sequence[Rect]) -> np.ndarray:
        """Return which squares reach into one of some rectangles of CFA cells."""
        reach = self.kernels.reach_um / self.sensor.pixel_pitch_um / self.period + 1
        at = self.position[own] / self.period
        found = np.zeros(len(own), bool)
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
        most = PIECE_S / (1e-9 * SPLAT_NS * self.planes * SQUARE**2)
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
            return np.moveaxis(in_fours(np.moveaxis(table, 1, -1)), -2, 1)

        # SciPy and NumPy let go of the interpreter in their loops.
        pool = ThreadPoolExecutor(os.cpu_count())
        try:
            with threadpool_limits(1):
                for number, table in zip(lacking, pool.map(one, lacking), strict=True):
                    made[number] = table
                    advance()
        finally:
            pool.shutdown(cancel_futures=True)
        return made

    @contextmanager
    def _on_device(
        self,
        share: Share,
        own: np.ndarray,
        starts: np.ndarray,
        near: np.ndarray,
        made: dict[int, np.ndarray],
    ) -> Iterator[dict[str, Resident]]:
        """Bring squares, their lists and their tables onto the device for a while."""
        needed, local = np.unique(self.tables[own], return_inverse=True)
        scale = self.sensor.pixel_pitch_um / self.bank.pitch_um
        rows = np.zeros(len(own), HIGHLIGHT)
        position = self.position[own]
        rows["pixel"] = np.floor(position)
        rows["place"] = position - np.floor(position) - 0.5
        rows["axis"] = self.mixed.axis[own] * scale
        parts = np.zeros(self.mixed.shares[own].shape, PART)
        parts["table"] = local.reshape(parts.shape)
        parts["share"] = self.mixed.shares[own]
        arrays = {
            "highlights": rows.view(np.uint32),
            "parts": parts.view(np.uint32),
            "radiance": in_fours(self.squares.light[own][:, share.spectra]),
            "starts": starts,
            "near": near,
            "tables": np.stack([made[number] for number in needed.tolist()]),
        }
        resident: dict[str, Resident] = {}
        try:
            for name, array in arrays.items():
                resident[name] = self.device.resident(f"splat {name}", array)
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
                    "fours": -(-len(share.spectra) // 4),
                    "mixed": self.mixed.shares.shape[1],
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


def of_few_spectra(light: np.ndarray, alike: float) -> tuple[np.ndarray, np.ndarray]:
    """Return spectra (R, M) of some highlights, and all light (N, M) as sums of them, (N, R).

    Lamps of a scene of 16 bands may have three colours: then there are tables of three spectra and
    not of sixteen. The spectra are those that differ most from the ones before them (a QR
    decomposition with column pivoting; Golub and Van Loan 2013, algorithm 5.4.1), so that tables
    hold no negative light. All of them come back as they are where no fewer will do.
    """
    total = light.sum(axis=1, keepdims=True)
    lit = np.flatnonzero(total[:, 0] > 0)
    if not len(lit):
        return np.eye(light.shape[1]), light
    colours = light[lit] / total[lit]
    lengths = np.linalg.norm(colours, axis=1)
    _, triangle, order = scipy.linalg.qr(colours.T, mode="economic", pivoting=True)
    rank = int(np.sum(np.abs(np.diag(triangle)) > alike * lengths.min()))
    if rank >= light.shape[1]:
        return np.eye(light.shape[1]), light
    few = colours[np.sort(order[:rank])]
    return few, np.linalg.lstsq(few.T, light.T, rcond=None)[0].T


def mixing_error(kernels: Tables, fields: Sequence[FieldPsfs]) -> float:
    """Return by how much mixing half-way between two of TRIED angles errs, of the largest value.

    For the largest squares, in the light of the reference wavelength, at the worst of some fields.
    """
    bank = kernels.bank
    line = slice(bank.reference, bank.reference + 1)
    square = kernels.largest_um * np.eye(2)
    half = np.pi / 4 / TRIED
    errors = []
    for field in fields:
        one = FieldPsfs(field.psf[line], field.shift_um[line], field.relative_illumination[line])
        spectra = kernels.spectra(one)
        before, between, after = (
            kernels.table(one, spectra, np.ones((1, 1, 1)), angle, square)
            for angle in (np.pi / 8 - half, np.pi / 8, np.pi / 8 + half)
        )
        largest = max(float(between.max()), np.finfo(float).tiny)
        errors.append(float(np.abs((before + after) / 2 - between).max()) / largest)
    return max(errors)


class Mixture(NamedTuple):
    """How the kernels of squares are made.

    Attributes
    ----------
    keys : ndarray (N, K, 3) of int
        Tables, by place of their field in the list, by angle, and by the number of the size.
    shares : ndarray (N, K)
        Shares of the tables; sum 1.
    axis : ndarray (N, 2)
        Direction of the PSFs' x axis.
    """

    keys: np.ndarray
    shares: np.ndarray
    axis: np.ndarray


def mixture(places: Places, squares: Squares, bins: int, turns: int = 1) -> Mixture:
    """Mix fields as the truth does, and, linearly, angles where PSFs are turned.

    Tables are the same again after `turns` quarters of a turn.
    """
    around = turns * bins
    found, axis = [], np.empty((len(squares.real_um), 2))
    sizes = np.unique(squares.size_um, return_inverse=True)[1].tolist()
    for own, (x, y), size in zip(axis, squares.real_um, sizes, strict=True):
        blend = places.at(x, y)
        angle = np.arctan2(blend.sin, blend.cos) / (np.pi / 2) % float(turns) * bins
        before = int(angle)
        two = ((before % around, 1 - (angle - before)), ((before + 1) % around, angle - before))
        found.append(
            [
                ((field, bin_, size), weight * share)
                for field, weight in zip(blend.fields, blend.weights, strict=True)
                for bin_, share in two
                if weight * share != 0
            ]
        )
        own[:] = blend.cos, blend.sin
    most = max(len(parts) for parts in found)
    # Those that need fewer take nothing of the first once more.
    keys = [[key for key, _ in parts] + [parts[0][0]] * (most - len(parts)) for parts in found]
    shares = [[share for _, share in parts] + [0.0] * (most - len(parts)) for parts in found]
    return Mixture(np.array(keys), np.array(shares), axis)


def turned(slopes: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return slopes (N, 2, 2) in the frames whose x axis is `axis` (N, 2)."""
    frame = np.stack([axis, np.stack([-axis[:, 1], axis[:, 0]], axis=1)], axis=1)
    return frame @ slopes @ frame.swapaxes(1, 2)


def distinct(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the keys (T, 3) that occur among (N, K, 3), in order, and where each is (N, K)."""
    used, where = np.unique(keys.reshape(-1, 3), axis=0, return_inverse=True)
    return used, where.reshape(keys.shape[:2])


def groups(tables: np.ndarray, table_bytes: int) -> list[np.ndarray]:
    """Cut squares, in order of their tables (N, K), into lists whose tables one dispatch binds."""
    most = max(DISPATCH_BYTES // table_bytes, tables.shape[1])
    result: list[list[int]] = []
    used: set[int] = set()
    for number in np.argsort(tables[:, 0], kind="stable"):
        own = set(tables[number].tolist())
        if not result or len(used | own) > most:
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
