"""The light on the photosites of a rectangle, tile by tile, as the memory allows."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.gpu import OutOfMemoryError, Recording, Resident, Result
from gpusim.gpu.pool import mebibytes
from gpusim.optics.nodes import Rates
from gpusim.plan.stage import stage_of
from gpusim.plan.tiles import Rect, aligned, halves, tiles_of
from gpusim.render.on_device import Progress

if TYPE_CHECKING:
    from gpusim.render.renderer import Renderer


class Lighting:
    """The way of the light to a rectangle, and what it cost.

    Parameters
    ----------
    renderer : Renderer
    rect : (row, col, rows, cols)
    seen : callable, optional
        Returns the lit pixels that a tile needs; by default those of what reads it out.
    """

    def __init__(
        self,
        renderer: Renderer,
        rect: Rect,
        seen: Callable[[Rect], Rect] | None = None,
    ) -> None:
        self.renderer, self.rect = renderer, rect
        self.on_device = renderer.on_device
        self.seen = seen or self.on_device.lit
        self.times_s: dict[str, float] = defaultdict(float)
        self.work = {"tiles": 0, "blocks": 0}
        self.notes: list[str] = []

    def render(
        self,
        tile_px: int | None,
        take: Callable[[Rect, Resident, Rect], None],
        progress: Callable[[int, int], None],
    ) -> None:
        """Render tile after tile; where the memory runs out, halve the tile and go on.

        Parameters
        ----------
        tile_px : int, optional
            Largest side of a tile.
        take : callable
            Called with each tile, its light (S, rows, cols) on the device, and the rectangle of
            whole periods that the light is of.
        progress : callable
            Called with (done, total).
        """
        renderer = self.renderer
        period = renderer.period
        self._check_memory()
        tiles = deque(tiles_of(self.rect, period, renderer.memory_bytes, tile_px, renderer.layers))
        wanted = {aligned(self.seen(tile), period) for tile in tiles}
        renderer.kept = {tile: one for tile, one in renderer.kept.items() if tile in wanted}
        done, left = 0, sum(map(self._steps, tiles))

        def advance() -> None:
            nonlocal done, left
            done, left = done + 1, left - 1
            progress(done, done + left)

        while tiles:
            tile = tiles.popleft()
            try:
                self._tile(tile, take, advance)
            except OutOfMemoryError as error:
                parts = halves(tile, period)
                if not parts:
                    raise self._too_little(error.value) from error
                self.on_device.drop()
                self.on_device.tight = True
                tiles.extendleft(reversed(parts))
                left = sum(map(self._steps, tiles))
                # The last such note stands for those of the halves before it.
                self.notes = [
                    f"GPU memory ran out: tiles of at most {parts[0][3]} x {parts[0][2]} pixels"
                ]

    def _steps(self, tile: Rect) -> int:
        renderer = self.renderer
        whole = aligned(self.seen(tile), renderer.period)
        return 1 + (0 if whole in renderer.kept else sum(1 for _ in self.on_device.lines(whole)))

    def _check_memory(self) -> None:
        pool = self.renderer.device.pool
        held = self.on_device.held_bytes
        if self.on_device.least_bytes() > pool.budget - pool.in_use + held:
            others = pool.in_use - held
            raise self._too_little(f"{mebibytes(pool.budget)}, {mebibytes(others)} of it in use")

    def _too_little(self, found: object) -> UserError:
        self.on_device.drop()
        others = self.renderer.device.pool.in_use
        return UserError(
            "The GPU memory does not hold the smallest tile: the kernels around one block, the "
            "block, and the scene that it sees.",
            field="memory",
            value=found,
            allowed=f"at least {mebibytes(self.on_device.least_bytes() + others)}: a larger "
            "--memory, another adapter, or a looser tolerance",
        )

    def _tile(
        self,
        tile: Rect,
        take: Callable[[Rect, Resident, Rect], None],
        advance: Callable[[], None],
    ) -> None:
        """Render one tile: each block that it needs, from source to sites; highlights; sensor."""
        renderer = self.renderer
        device, period = renderer.device, renderer.period
        whole = aligned(self.seen(tile), period)
        count = renderer.plan.scales[0].grid.sites
        sites = (count, whole[2] // period, whole[3] // period)
        rates = device.empty("rates", sites, np.float32)
        try:
            if whole in renderer.kept:
                rec = Recording(device)
                rec.upload(rates, renderer.kept[whole])
                rec.run()
            else:
                self._lit(rates, whole, advance)
                renderer.keep_light(whole, rates)
            take(tile, rates, whole)
            advance()
        finally:
            rates.destroy()
        self.work["tiles"] += 1

    def _lit(self, rates: Resident, whole: Rect, advance: Callable[[], None]) -> None:
        """Bring the light to the planes of the sites of a rectangle: blocks, highlights, halo."""
        renderer = self.renderer
        rec = Recording(renderer.device)
        if self.on_device.point_source_light is None:
            rec.clear(rates)
        else:
            rec.upload(rates, self.on_device.point_source_light.on(whole))
        rec.run()
        for number, line in self.on_device.lines(whole):
            parts = deque(self._parts(number, line))
            while parts:
                blocks = parts.popleft()
                try:
                    self._load(number, blocks)
                except OutOfMemoryError:
                    if len(blocks) == 1:
                        raise
                    parts.extendleft([blocks[len(blocks) // 2 :], blocks[: len(blocks) // 2]])
                else:
                    self._blocks(number, blocks, rates, whole)
            advance()
        if self.on_device.halo is not None:
            rec = Recording(renderer.device)
            self.on_device.halo.record(rec, rates, whole)
            self.run(rec)

    def _parts(self, number: int, line: list[tuple[int, int]]) -> Iterator[list[tuple[int, int]]]:
        """Cut a line of blocks into parts whose kernels fit the memory together."""
        convolve, source = self.on_device.convolutions[number], self.on_device.sources[number]
        while line:
            count = 1 if self.on_device.tight else len(line)
            while count > 1 and self.on_device.room() < (
                source.load_bytes(line[:count]) + convolve.load_bytes(line[:count])
            ):
                count = -(-count // 2)
            yield line[:count]
            line = line[count:]

    def _load(self, number: int, blocks: list[tuple[int, int]]) -> None:
        """Bring scene and kernels of blocks onto the device."""
        self.on_device.sources[number].load(blocks)
        if self.on_device.convolutions[number].missing_bytes(blocks):
            started = time.perf_counter()
            self.on_device.load(number, blocks)
            self.times_s["kernels"] += time.perf_counter() - started

    def _blocks(
        self, number: int, blocks: list[tuple[int, int]], rates: Resident, rect: Rect
    ) -> None:
        """Add blocks to the planes (S, rows, cols) of the sites of a rectangle."""
        renderer = self.renderer
        source = self.on_device.sources[number]
        rec = Recording(renderer.device)
        convolve = self.on_device.convolutions[number]
        scratch = convolve.scratch(rec, renderer.plan.basis.coefficients.shape[1])
        for block in blocks:
            source.record(rec, block, scratch.planes)
            convolve.record(rec, block, source.needed[block], scratch, Rates(rates, rect))
        self.run(rec)
        self.work["blocks"] += len(blocks)

    def run(self, rec: Recording) -> Result:
        """Run a recording, and count its seconds."""
        result = rec.run()
        for path, seconds in result.times_s.items():
            self.times_s[stage_of(path)] += seconds
        return result


def planes_on(renderer: Renderer, rect: Rect, progress: Progress | None = None) -> np.ndarray:
    """Return the electrons/s (S, rows, cols) of the planes of a rectangle of lit pixels.

    Whole periods of the filter pattern; without veiling glare. ``progress``: called with
    (what, done, total).
    """
    report = progress or (lambda what, done, total: None)
    period, (row, col, rows, cols) = renderer.period, aligned(rect, renderer.period)
    size = renderer.plan.scales[0].grid.sites, rows // period, cols // period
    found = np.empty(size, np.float32)

    def take(tile: Rect, rates: Resident, whole: Rect) -> None:
        top, left = (whole[0] - row) // period, (whole[1] - col) // period
        high, wide = whole[2] // period, whole[3] // period
        found[:, top : top + high, left : left + wide] = renderer.device.read(rates)

    lighting = Lighting(renderer, rect, lambda tile: tile)
    with renderer.device.pool.within(renderer.memory_bytes):
        renderer.hold(rect, None, report)
        lighting.render(None, take, lambda done, total: report("render", done, total))
    return found
