"""Host side of point_sources: a photograph's highlights, each with the kernels of its own place.

All sums are of what is not negative, or compact: light ends where the PSF does.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from gpusim.gpu import Device, Kernel, Recording, Resident, Use
from gpusim.optics.convolve import packed_channels
from gpusim.optics.highlight_plan import HighlightPlan, Share
from gpusim.parallel import each
from gpusim.psf.places import FieldPsfs, half_turned
from gpusim.sensor.planes import planes_of

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
NOT_HERE = 15  # in place of the channel of a site that has none of the tables
HIGHLIGHT_NS = 300.0  # for each highlight and pixel: lavapipe, 2 cores
PIECE_S = 0.25  # of the device's time in one go: as long as a person who interrupts it waits


class PointSources:
    """The light that highlights bring to the pixels, by the kernels that are planned for them."""

    def __init__(self, device: Device, planned: HighlightPlan) -> None:
        self.device, self.planned = device, planned
        self.bank, self.sensor = planned.bank, planned.sensor
        planes = planes_of(self.sensor)
        self.period, self.planes = planes.period, len(planes.channels)
        self.shares, self.groups = planned.shares(), planned.groups()
        self.across, self.down = (
            -(-count // (self.period * SQUARE)) for count in (self.sensor.cols, self.sensor.rows)
        )
        self.kernel_of = {
            count: Kernel(
                "optics/point_sources",
                S=self.planes,
                PERIOD=self.period,
                C=count,
                NEAR=planned.sampling.near,
                FAR=planned.sampling.far,
            )
            for count in {len(one.channels) for one in self.shares}
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
        reaching = self._reaches(cells)
        near = [np.flatnonzero(np.isin(self.planned.owner, own) & reaching) for own in self.groups]
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
                            self._add(share, arrays, tile, rects, found, advance=advance)
        return light

    def _needed(self, own: np.ndarray) -> np.ndarray:
        """Return the numbers of the tables that squares need."""
        return np.unique(self.planned.tables[np.unique(self.planned.owner[own])])

    def _reaches(self, cells: Sequence[Rect]) -> np.ndarray:
        """Return which squares reach into one of some rectangles of CFA cells."""
        reach = self.planned.kernels.reach_um / self.sensor.pixel_pitch_um / self.period + 1
        at = self.planned.position / self.period
        found = np.zeros(len(at), bool)
        for row, col, rows, cols in cells:
            off = np.maximum(np.array([col, row]) - at, at - np.array([col + cols, row + rows]))
            found |= (off < reach).all(axis=1)
        return found

    def _lists(self, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reach = self.planned.kernels.reach_um / (self.sensor.pixel_pitch_um * self.period)
        return lists(self.planned.position[own] / self.period, reach, (self.across, self.down))

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
            of_field = self.planned.fields[self.planned.used[number, 0]]
            if of_field not in by_field:
                field = self.bank.field(of_field)
                by_field[of_field] = field, self.planned.kernels.spectra(field)

        def one(number: int) -> np.ndarray:
            of_field = self.planned.fields[self.planned.used[number, 0]]
            # Beyond the axis everything is half a turn on: aperture and square are as they are.
            half = np.pi * self.planned.opposite[number]
            angle = np.pi / 2 * self.planned.used[number, 1] / self.planned.bins + half
            weights = self.planned.kernels.weights_at(of_field, angle)[
                np.ix_(share.channels, share.spectra)
            ]
            table = self.planned.kernels.table(
                *by_field[of_field], weights, angle, self.planned.shapes[number]
            )
            table = half_turned(table) if half else table
            return np.moveaxis(in_fours(np.moveaxis(self.planned.sampling.of(table), 1, -1)), -2, 1)

        tables = each(one, lacking, lambda _done, _total: advance())
        return made | dict(zip(lacking, tables, strict=True))

    def _blended(self, bundles: np.ndarray, made: dict[int, np.ndarray]) -> np.ndarray:
        """Return the kernels of bundles, sums of tables."""
        some = next(iter(made.values()))
        kernels = np.empty((len(bundles), *some.shape), np.float32)

        def one(place: int) -> None:
            bundle = bundles[place]
            tables = [made[number] for number in self.planned.tables[bundle].tolist()]
            shares = self.planned.mixed.shares[bundle].astype(np.float32)
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
        bundles, kernel = np.unique(self.planned.owner[own], return_inverse=True)
        scale = self.sensor.pixel_pitch_um / self.planned.kernels.pitch_um
        rows = np.zeros(len(own), HIGHLIGHT)
        position = self.planned.position[own]
        rows["pixel"] = np.floor(position)
        rows["place"] = position - np.floor(position) - 0.5
        rows["axis"] = self.planned.axis[own] * scale
        rows["kernel"] = kernel.reshape(-1)
        arrays = {
            "highlights": rows.view(np.uint32),
            "radiance": in_fours(self.planned.squares.light[own][:, share.spectra]),
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
        *,
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
                    "reach2": (self.planned.kernels.support + 2) ** 2,
                    "near2": self.planned.sampling.radius**2,
                    "step": self.planned.sampling.step,
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


def in_fours(values: np.ndarray) -> np.ndarray:
    """Return values (..., M) as (..., ceil(M/4), 4), float32, filled up with zeros."""
    fill = -values.shape[-1] % 4
    padded = np.pad(values.astype(np.float32), [(0, 0)] * (values.ndim - 1) + [(0, fill)])
    return padded.reshape(*values.shape[:-1], -1, 4)


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
