"""What lies on the device while frames are rendered: scene, kernels, halo and highlights."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from gpusim.gpu import Device, OutOfMemoryError
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.optics.grid import SimGrid
from gpusim.optics.halo import Halo
from gpusim.optics.methods import Convolution, convolution
from gpusim.optics.paint import Paint
from gpusim.optics.point_sources import PointSources
from gpusim.optics.warp import Warp
from gpusim.plan import Plan
from gpusim.plan.tiles import (
    RESERVE_BYTES,
    SMALLEST_PX,
    Rect,
    strip_bytes,
    tile_bytes,
    tiles_of,
)
from gpusim.psf.field_bank import FieldBank
from gpusim.render.highlights import PointSourceLight
from gpusim.render.reading import lit_for
from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.scene import Scene
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import rects_of
from gpusim.sensor.sensor import Sensor

Progress = Callable[[str, int, int], None]


class OnDevice:
    """What lies on the device for frames of one plan, as far as the memory goes.

    Parameters
    ----------
    device : Device
    sensor : Sensor
    memory_bytes : int
        Budget of device memory.

    Attributes
    ----------
    plan : Plan
    sources : list of Paint or Warp
        The scene, for each scale of the plan.
    convolutions : list of Convolution
        With the kernels, for each scale.
    halo : Halo or None
    point_sources : PointSources or None
        What brings the light of highlights, where there are any.
    point_source_light : PointSourceLight or None
        That light, once it is worked out: it lies on the host.
    tight : bool
        The adapter has less than the budget: kernels of one block at a time.
    """

    plan: Plan

    def __init__(self, device: Device, sensor: Sensor, memory_bytes: int) -> None:
        self.device, self.sensor, self.memory_bytes = device, sensor, memory_bytes
        self.sources: list[Paint | Warp] = []
        self.convolutions: list[Convolution] = []
        self.halo: Halo | None = None
        self.point_sources: PointSources | None = None
        self.point_source_light: PointSourceLight | None = None
        self.tight = False

    def place(
        self, scene: Scene, core: FieldBank, plan: Plan, distorted: bool
    ) -> Chart | PlacedRaster:
        """Place the scene on the sensor, for each scale; return it as the finest one has it.

        Parameters
        ----------
        scene : Scene
        core : FieldBank
            The bank, within the window of its PSFs.
        plan : Plan
        distorted : bool
            Distort the scene though the lens may have no distortion: for tests.
        """
        self.plan, sensor = plan, self.sensor
        half_um = tuple(side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows))
        chief_ray = chief_ray_map(core, distorted)
        first = None
        for scale in plan.scales:
            if isinstance(scene.source, Chart):
                stage, placed = Paint, scene.source.placed(half_um[1])
            else:
                stage, placed = Warp, scene.source.placed(*half_um, scale.pitch_um)
            first = placed if first is None else first
            source = stage(self.device, placed, plan.basis.coefficients, scale, chief_ray)
            self.sources.append(source)
        if plan.highlights is not None:
            self.point_sources = PointSources(self.device, plan.highlights)
        self.convolve(plan)
        return first

    def convolve(self, plan: Plan) -> None:
        """Make ready the convolutions of a plan, in place of those of the one before."""
        for convolve in self.convolutions:
            convolve.release()
        self.plan, self.convolutions = plan, []
        response_um, sites = self.sensor.response_um, list(planes_of(self.sensor).channels)
        for scale, source in zip(plan.scales, self.sources, strict=True):
            convolve = convolution(self.device, scale, source.needed, response_um, sites)
            self.convolutions.append(convolve)

    def release(self) -> None:
        """Give the device's memory back."""
        for part in (*self.sources, *self.convolutions):
            part.release()
        if self.halo is not None:
            self.halo.release()

    @property
    def made(self) -> int:
        """PSF nodes of which kernels were made until now."""
        return sum(convolve.made for convolve in self.convolutions)

    @property
    def held_bytes(self) -> int:
        """Device memory of the kernels."""
        return sum(convolve.held_bytes for convolve in self.convolutions)

    @property
    def grid(self) -> SimGrid:
        """The finest sim grid."""
        return self.plan.scales[0].grid

    def lines(self, rect: Rect) -> Iterator[tuple[int, list[tuple[int, int]]]]:
        """Yield the blocks that a rectangle of lit pixels needs, where there is light, by line.

        A line is a row of cells between PSF nodes. In the order in which they are added up: with
        the number of their scale.
        """
        for number, (scale, source) in enumerate(zip(self.plan.scales, self.sources, strict=True)):
            grid = scale.grid
            blocks = [block for block in grid.blocks_for(*rect) if source.needed[block]]
            for _, line in groupby(blocks, key=lambda block: grid.cell_of(block)[1]):
                yield number, list(line)

    def working_bytes(self) -> int:
        """Return the device memory that is taken for a while, beside tile, scene and kernels."""
        planes = self.plan.basis.coefficients.shape[1]
        scratch = max(convolve.scratch_bytes(planes) for convolve in self.convolutions)
        strip = strip_bytes(self.sensor.frame.read, self.memory_bytes, self._around)
        return max(scratch, strip) + RESERVE_BYTES

    def room(self) -> int:
        """Return the device memory that scene and kernels may take, those of now dropped."""
        pool = self.device.pool
        return pool.budget - pool.in_use + self.held_bytes - self.working_bytes()

    def load(
        self,
        number: int,
        blocks: list[tuple[int, int]],
        progress: Callable[[], None] | None = None,
    ) -> None:
        """Make the kernels of blocks; drop others, first of other scales, as far as need be."""
        convolve = self.convolutions[number]
        if self.tight:
            self.drop(number, blocks)
        lacking = convolve.missing_bytes(blocks) - (self.room() - self.held_bytes)
        for other in self.convolutions:
            if other is not convolve:
                lacking -= other.shed(lacking)
        convolve.shed(lacking, blocks)
        try:
            convolve.load(blocks, progress)
        except OutOfMemoryError:  # the adapter has less than the budget
            self.drop(number, blocks)
            convolve.load(blocks, progress)

    def drop(self, number: int = 0, blocks: Sequence[tuple[int, int]] = ()) -> None:
        """Drop all kernels, but for those of some blocks."""
        for other, convolve in enumerate(self.convolutions):
            convolve.shed(convolve.held_bytes, blocks if other == number else ())

    def least_bytes(self) -> int:
        """Return the device memory that the smallest tile takes, beside what is in use now."""
        planes = self.plan.basis.coefficients.shape[1]
        kernels = max(convolve.block_bytes(planes) for convolve in self.convolutions)
        lines = self.lines(self.lit(self.sensor.frame.read))
        source = max((self.sources[n].load_bytes(line[:1]) for n, line in lines), default=0)
        side = SMALLEST_PX + 2 * self._around
        tile = tile_bytes((0, 0, side, side), self.grid.period, self.grid.layers)
        return kernels + source + tile + self.working_bytes()

    def lit(self, rect: Rect) -> Rect:
        """Return the lit pixels that a rectangle needs: see `lit_for`."""
        return lit_for(rect, self.sensor, self.plan.runs)

    @property
    def _around(self) -> int:
        """Pixels whose light a tile or a strip needs on each side, at most."""
        pixel = self.sensor.rows - 1, 0, 1, 1
        _, seen = rects_of(pixel, self.sensor, self.plan.runs)
        return pixel[0] - seen[0]

    def hold_halo(self, rect: Rect, made: Callable[[Rect], Halo]) -> None:
        """Bring the halo of a rectangle of lit pixels onto the device; `made` makes it."""
        if not self.plan.halo or (self.halo is not None and self.halo.covers(rect)):
            return
        if self.halo is not None:
            self.halo.release()
            self.halo = None
        self.halo = made(rect)

    def hold_point_sources(self, rect: Rect, report: Progress) -> None:
        """Work out what highlights bring to a rectangle of lit pixels, and keep it on the host."""
        if self.point_source_light is not None and self.point_source_light.covers(rect):
            return
        self.point_source_light = None
        tiles = tiles_of(rect, self.grid.period, self.memory_bytes, None, self.grid.layers)
        light = self.point_sources.light(
            tiles, lambda done, total: report("point sources", done, total)
        )
        self.point_source_light = PointSourceLight(rect, self.grid.period, tiles, light)

    def hold_scene(self, rect: Rect) -> None:
        """Make ready the scene around a rectangle of lit pixels."""
        for source, scale in zip(self.sources, self.plan.scales, strict=True):
            source.prepare([b for b in scale.grid.blocks_for(*rect) if source.needed[b]])

    def hold_kernels(self, rect: Rect, tile_px: int | None, report: Progress) -> None:
        """Bring scene and kernels of a rectangle onto the device, if there is room for all."""
        wanted: list[list[tuple[int, int]]] = [[] for _ in self.convolutions]
        largest = 0
        for number, line in self.lines(self.lit(rect)):
            wanted[number] += line
            largest = max(largest, self.sources[number].load_bytes(line))
        pairs = list(zip(self.convolutions, wanted, strict=True))
        needed = sum(convolve.load_bytes(blocks) for convolve, blocks in pairs)
        period, layers = self.grid.period, self.grid.layers
        tiles = tiles_of(rect, period, self.memory_bytes, tile_px, layers)
        planes = max(tile_bytes(self.lit(tile), period, layers) for tile in tiles)
        if not self.tight and needed + largest + planes <= self.room():
            total = sum(len(c.nodes_of(blocks) - c.nodes.keys()) for c, blocks in pairs)
            done = iter(range(1, total + 1))
            try:
                for number, (_, blocks) in enumerate(pairs):
                    self.load(number, blocks, lambda: report("kernels", next(done), total))
            except OutOfMemoryError:  # the adapter has less: they are made where they are needed
                self.drop()
