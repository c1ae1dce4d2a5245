"""Host side of the splat stage: a photograph's highlights, each with the kernels of its own place.

The kernels are tabulated in the frame of the PSFs, at the fields of the bank, and mixed as the
truth mixes these. Of a lens with an axis the pixel aperture and the highlight's square stand at an
angle in it, the azimuth modulo 90 degrees: tables are made at `bins` angles, and mixed linearly
between the nearest two. All sums are of what is not negative, or compact: light ends where the PSF
does.

Colours lie at the chief rays of the bank's wavelengths, each as much as the splines between these
give it (`gpusim.lens.lines`): what aperture and square blur follows the streak between the chief
rays as closely as cubics do.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.fft
from threadpoolctl import threadpool_limits

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.lens.field_bank import FieldBank
from gpusim.lens.places import FieldPsfs, Places, half_turned
from gpusim.optics.angular import AngularResponse, PlaceWeights
from gpusim.optics.convolve import packed_channels
from gpusim.optics.fold import spectral_weights
from gpusim.scene.highlights import Highlights
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.aperture import Response
from gpusim.sensor.planes import planes_of
from gpusim.sensor.sensor import Sensor

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
LARGEST = 2.0  # pixels along a side of a highlight, of which one PSF is taken; others are cut up
# Angles in 90 degrees at which tables are made, for a tolerance of 1e-3. Mixing between them errs
# by 1e-3 to 2e-3 of a highlight next to it, and by 4e-5 rms of its light elsewhere (double Gauss at
# f/2.8, squares of 1 to 2 pixels); with the square of the step.
BINS = 16
NODES = 2.0  # of the quadratures over aperture and square, per sample of the PSF
DISPATCH_BYTES = 96 << 20  # of the tables of a dispatch; every adapter binds 128 MiB
# Of all tables. Scattered highlights need many, and are content with FEWEST angles.
TABLE_BYTES = 512 << 20
FEWEST = 8
STEP_UM = 1e-3  # of differences of the chief-ray map, which is known to 1e-9 um
NEWTON_STEPS = 30
FOUND_UM = 1e-4  # how near to an ideal point its real one leads


def beta3(x: np.ndarray) -> np.ndarray:
    """Return the cubic B-spline (Unser 1999, eq. 6)."""
    outer, inner = np.maximum(2 - np.abs(x), 0.0), np.maximum(1 - np.abs(x), 0.0)
    return outer**3 / 6 - 2 / 3 * inner**3


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
    size_um : float
        Side on the ideal plane.
    slopes : ndarray (N, 2, 2)
        d(real)/d(ideal).
    light : ndarray (N, M)
        Coefficients of the scene's spectra times the area on the real plane, um^2.
    """

    real_um: np.ndarray
    size_um: float
    slopes: np.ndarray
    light: np.ndarray


def squares_on_sensor(
    bank: FieldBank, sensor: Sensor, highlights: Highlights, reach_um: float
) -> Squares:
    """Place highlights on the real plane; those that no pixel sees are left out."""
    pitch = sensor.pixel_pitch_um
    cuts = math.ceil(highlights.size_um / (LARGEST * pitch))
    size = highlights.size_um / cuts
    line = (np.arange(cuts) - (cuts - 1) / 2) * size
    inner = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    ideal = (highlights.centre_um[:, None] + inner).reshape(-1, 2)
    excess = np.repeat(highlights.excess, len(inner), axis=0)
    real, slopes, lit = real_points(bank, ideal)
    half = np.array([sensor.cols, sensor.rows]) * pitch / 2
    seen = lit & np.all(np.abs(real) < half + reach_um, axis=1)
    light = excess * (size**2 * np.abs(np.linalg.det(slopes)))[:, None]
    return Squares(real[seen], size, slopes[seen], light[seen])


class Tables:
    """Kernels of squares, by field of the bank, angle and shape of the square.

    Parameters
    ----------
    bank : FieldBank
    sensor : Sensor
    spectra : ndarray (M, 61)
    largest_um : float
        Side of the squares on the real plane, where it is largest.
    """

    def __init__(
        self, bank: FieldBank, sensor: Sensor, spectra: np.ndarray, largest_um: float
    ) -> None:
        self.bank = bank
        self.aperture_um = sensor.response_um
        self.weights = np.einsum("clw,mw->cml", spectral_weights(bank, sensor), spectra)
        self.elsewhere = None
        if sensor.eqe_map is not None:
            response = AngularResponse(bank, sensor)
            even = spectral_weights(bank, sensor, np.ones((1, 1, WAVELENGTHS_NM.size)))[0]
            self.elsewhere = PlaceWeights(response, even, spectra, 0.0)
        # From the middle of aperture and square to their corners, and lateral colour.
        aperture_um = self.aperture_um
        if isinstance(aperture_um, Response):
            aperture_um = 2 * aperture_um.reach
        corner = (aperture_um + largest_um) / np.sqrt(2) + bank.lateral_um
        self.taps = math.ceil(corner / bank.pitch_um + 2)
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

        Samples of beta3 have the transform (2 + cos) / 3 in each direction. It is divided out
        twice: once the PSF's samples become spline coefficients, and once what is tabulated does.
        """
        n = field.psf.shape[-1]
        before = self.side // 2 - n // 2
        psf = field.psf.astype(np.float64) / self.bank.pitch_um**2
        padded = np.pad(psf, ((0, 0), *[(before, self.side - n - before)] * 2))
        line = (2 + np.cos(2 * np.pi * scipy.fft.fftfreq(self.side))) / 3
        return scipy.fft.rfft2(padded) / (line[:, None] * line[: self.side // 2 + 1]) ** 2

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
        boxes = scipy.fft.rfft2(self._boxes(field.shift_um / self.bank.pitch_um, angle, square))
        mixed = np.tensordot(weights * field.relative_illumination, spectra * boxes, axes=1)
        table = scipy.fft.irfft2(mixed, s=(self.side, self.side))
        at = np.arange(self.side) - self.side // 2
        # Beyond lies rounding; and where the PSF is cut off, its spline swings below zero.
        table[..., np.hypot(at, at[:, None]) > self.support] = 0.0
        return np.maximum(table, 0.0)

    def _boxes(self, shifts: np.ndarray, angle: float, square: np.ndarray) -> np.ndarray:
        """Return beta3 averaged over aperture and square, (L, side, side), middle at [0, 0].

        In the frame of the PSFs. Each wavelength has its lateral colour.
        """
        # Columns are the PSFs' x and y axis.
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        parts, both = [], (square,)
        if isinstance(self.aperture_um, Response):
            places, shares = self.aperture_um.points(self.bank.pitch_um)
            parts.append((places @ turn, shares))
        else:
            both = (self.aperture_um * np.eye(2), square)
        for sides in both:
            order = max(4, math.ceil(NODES * np.linalg.norm(sides, 2) / self.bank.pitch_um))
            nodes, weights = np.polynomial.legendre.leggauss(order)
            plane = np.stack(np.meshgrid(nodes, nodes), axis=-1).reshape(-1, 2) / 2
            parts.append((plane @ turn @ sides.T, np.outer(weights, weights).ravel() / 4))
        (aperture, share), (shape, of_shape) = parts
        offsets = (aperture[:, None] + shape).reshape(-1, 2) / self.bank.pitch_um
        shares = np.outer(share, of_shape).ravel()
        taps = np.arange(-self.taps, self.taps + 1)
        boxes = np.zeros((len(shifts), self.side, self.side))
        for box, (x, y) in zip(boxes, shifts, strict=True):
            across = beta3(taps[:, None] + offsets[:, 0] - x)
            down = beta3(taps[:, None] + offsets[:, 1] - y) * shares
            box[np.ix_(taps, taps)] = down @ across.T
        return boxes


class Splat:
    """Highlights on the device.

    Parameters
    ----------
    device : Device
    bank : FieldBank
    sensor : Sensor
    highlights : Highlights
        One or more.
    spectra : ndarray (M, 61)
        Of the scene.
    tolerance : float
        Of the planner.
    """

    def __init__(
        self,
        device: Device,
        bank: FieldBank,
        sensor: Sensor,
        highlights: Highlights,
        spectra: np.ndarray,
        tolerance: float,
    ) -> None:
        planes = planes_of(sensor)
        self.period, self.planes = planes.period, len(planes.channels)
        half_um = np.array([sensor.cols, sensor.rows]) * sensor.pixel_pitch_um / 2
        # As far as light can come from; some highlights there still miss all pixels.
        reach_um = bank.psf.shape[-1] * bank.pitch_um + bank.lateral_um
        squares = squares_on_sensor(bank, sensor, highlights, reach_um)
        self.groups: list[dict[str, Array]] = []
        if not len(squares.light):
            return
        fields, places = bank.places(float(np.hypot(*half_um)) + reach_um)
        sides = np.linalg.norm(squares.slopes, 2, axis=(1, 2)) * squares.size_um
        kernels = Tables(bank, sensor, spectra, sides.max())
        channels = sensor.channels
        self.site_channels = packed_channels(planes.channels)
        self.fours = -(-len(spectra) // 4)
        # Reaches from a table's middle to zeros, and no tap lies beyond its border.
        self.reach2 = (kernels.support + 2) ** 2
        self.across, self.down = (
            -(-count // (self.period * SQUARE)) for count in (sensor.cols, sensor.rows)
        )
        table_bytes = 16 * self.fours * len(channels) * kernels.side**2
        self.bins = max(FEWEST, math.ceil(BINS * np.sqrt(1e-3 / tolerance)))
        mixed = mixture(places, squares, self.bins, kernels.turns)
        while self.bins > FEWEST and len(distinct(mixed.keys)[0]) * table_bytes > TABLE_BYTES:
            self.bins = max(FEWEST, self.bins // 2)
            mixed = mixture(places, squares, self.bins, kernels.turns)
        self.mixed = mixed.shares.shape[1]
        self.kernel = Kernel(
            "optics/splat",
            S=self.planes,
            PERIOD=self.period,
            C=len(channels),
            N=kernels.side,
        )
        used, tables = distinct(mixed.keys)
        opposite = np.isin(used[:, 0], places.opposite)
        # The map changes slowly: those that share a table share the mean of their shapes in it.
        shapes = np.zeros((len(used), 2, 2))
        own = turned(squares.slopes, mixed.axis) * squares.size_um
        np.add.at(shapes, tables, own[:, None])
        shapes /= np.bincount(tables.ravel())[:, None, None]

        def made(chosen: np.ndarray) -> np.ndarray:
            of_field = fields[used[chosen[0], 0]]
            field = bank.field(of_field)
            spectra = kernels.spectra(field)
            result = []
            for number in chosen:
                angle = np.pi / 2 * used[number, 1] / self.bins
                # Beyond the axis everything is half a turn on: aperture and square are as they are.
                half = np.pi * opposite[number]
                weights = kernels.weights_at(of_field, angle + half)
                table = kernels.table(field, spectra, weights, angle + half, shapes[number])
                table = half_turned(table) if half else table
                result.append(np.moveaxis(in_fours(np.moveaxis(table, 1, -1)), -2, 1))
            return np.stack(result)

        for chosen in groups(tables, table_bytes):
            needed, local = np.unique(tables[chosen], return_inverse=True)
            by_field = np.split(needed, np.flatnonzero(np.diff(used[needed, 0])) + 1)
            # SciPy and NumPy let go of the interpreter in their loops.
            with threadpool_limits(1), ThreadPoolExecutor(os.cpu_count()) as pool:
                stacked = np.concatenate(list(pool.map(made, by_field)))
            rows = np.zeros(len(chosen), HIGHLIGHT)
            position = squares.real_um[chosen] / sensor.pixel_pitch_um
            position += np.array([sensor.cols, sensor.rows]) / 2
            rows["pixel"] = np.floor(position)
            rows["place"] = position - np.floor(position) - 0.5
            rows["axis"] = mixed.axis[chosen] * sensor.pixel_pitch_um / bank.pitch_um
            parts = np.zeros(mixed.shares[chosen].shape, PART)
            parts["table"] = local.reshape(parts.shape)
            parts["share"] = mixed.shares[chosen]
            reach = kernels.reach_um / (sensor.pixel_pitch_um * self.period)
            starts, near = lists(position / self.period, reach, (self.across, self.down))
            arrays = {
                "highlights": rows.view(np.uint32),
                "parts": parts.view(np.uint32),
                "radiance": in_fours(squares.light[chosen]),
                "starts": starts,
                "near": near,
                "tables": stacked,
            }
            self.groups.append(
                {name: device.resident(f"splat {name}", one) for name, one in arrays.items()}
            )

    def release(self) -> None:
        """Give the device's memory back."""
        for group in self.groups:
            for resident in group.values():
                resident.destroy()

    def record(self, rec: Recording, rates: Array, rect: tuple[int, int, int, int]) -> None:
        """Add the highlights' light to the planes of the CFA sites.

        Parameters
        ----------
        rec : Recording
        rates : buffer (S, rows, cols)
            Of the rectangle; electrons/s are added to it.
        rect : (row0, col0, rows, cols)
            Rectangle of pixels, aligned to the CFA period.
        """
        row0, col0, rows, cols = (-(-value // self.period) for value in rect)
        first = (col0 // SQUARE, row0 // SQUARE)
        last = ((col0 + cols - 1) // SQUARE, (row0 + rows - 1) // SQUARE)
        for group in self.groups:
            self.kernel.record(
                rec,
                groups=(last[0] - first[0] + 1, last[1] - first[1] + 1, self.planes),
                params={
                    "first": first,
                    "origin": (col0, row0),
                    "size": (cols, rows),
                    "across": self.across,
                    "reach2": self.reach2,
                    "fours": self.fours,
                    "mixed": self.mixed,
                    "site_channels": self.site_channels,
                },
                **group,
                rates=rates,
            )


def in_fours(values: np.ndarray) -> np.ndarray:
    """Return values (..., M) as (..., ceil(M/4), 4), float32, filled up with zeros."""
    fill = -values.shape[-1] % 4
    padded = np.pad(values.astype(np.float32), [(0, 0)] * (values.ndim - 1) + [(0, fill)])
    return padded.reshape(*values.shape[:-1], -1, 4)


class Mixture(NamedTuple):
    """How the kernels of squares are made.

    Attributes
    ----------
    keys : ndarray (N, K, 2) of int
        Tables, by place of their field in the list and by angle.
    shares : ndarray (N, K)
        Of the tables; sum 1.
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
    for own, (x, y) in zip(axis, squares.real_um, strict=True):
        blend = places.at(x, y)
        angle = np.arctan2(blend.sin, blend.cos) / (np.pi / 2) % float(turns) * bins
        before = int(angle)
        two = ((before % around, 1 - (angle - before)), ((before + 1) % around, angle - before))
        found.append(
            [
                ((field, bin_), weight * share)
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
    """Return the keys (T, 2) that occur among (N, K, 2), in order, and where each is (N, K)."""
    used, where = np.unique(keys.reshape(-1, 2), axis=0, return_inverse=True)
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
        Of their light, CFA cells.
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
