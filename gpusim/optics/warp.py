"""Host side of the warp stage: a raster scene sampled on the sim grid through the chief-ray map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, Resident
from gpusim.gpu.pool import size_class
from gpusim.optics.chief_ray import ChiefRayMap, outline
from gpusim.optics.convolve import Scale
from gpusim.scene.raster import PlacedRaster

# Raster samples around what a block's outline sees: the spline's reach (2), rounding to f32, and
# what the map bulges between the points of the outline.
MARGIN = 4


class Warp:
    """A raster scene, of which the device holds what the blocks at hand see.

    Parameters
    ----------
    device : Device
    raster : PlacedRaster
        Its pitch is not finer than the sim grid's.
    coefficients : ndarray (M, J)
        Of the scene's spectra in the reduced basis.
    scale : Scale
    chief_ray : ChiefRayMap
    """

    def __init__(
        self,
        device: Device,
        raster: PlacedRaster,
        coefficients: np.ndarray,
        scale: Scale,
        chief_ray: ChiefRayMap,
    ) -> None:
        self.grid, self.pitch_um, self.chief_ray = scale.grid, scale.pitch_um, chief_ray
        self.device = device
        of_spectra = raster.spline_coefficients()
        shape = (coefficients.shape[1], *of_spectra.shape[1:])
        self.splines = np.empty(shape, np.float32)
        for row in range(shape[1]):  # in float64 all together are twice as large as the rest
            np.matmul(
                coefficients.T, of_spectra[:, row], out=self.splines[:, row], casting="same_kind"
            )
        blocks = self.grid.blocks
        self.needed = {(x, y): shape[0] for y in range(blocks[1]) for x in range(blocks[0])}
        self.size = (shape[2], shape[1])
        self.scale = scale.pitch_um / raster.pitch_um
        self.centre = (-raster.x0_um / raster.pitch_um - 0.5, -raster.y0_um / raster.pitch_um - 0.5)
        self.terms = device.resident("warp terms", chief_ray.terms(scale.pitch_um))
        self.kernel = Kernel(
            "optics/warp", BX=self.grid.block[0], BY=self.grid.block[1], DEGREE=chief_ray.degree
        )
        self.planes: list[Resident] = []
        self.loaded = (range(0), range(0))

    def prepare(self, blocks: Sequence[tuple[int, int]]) -> None:
        """Do nothing: a raster has no lists by block."""

    def seen(self, blocks: Sequence[tuple[int, int]]) -> tuple[range, range]:
        """Return the columns and rows of the raster that blocks see."""
        corners = [np.array(self.grid.block_origin(block)) - self.grid.centre for block in blocks]
        outlines = [
            outline(self.chief_ray, corner, self.grid.block, self.pitch_um) for corner in corners
        ]
        at = np.array(self.centre) + self.scale * np.concatenate(outlines)
        low, high = (np.clip(end, 0, np.array(self.size) - 1) for end in (at.min(0), at.max(0)))
        return tuple(
            range(max(int(first) - MARGIN, 0), min(int(last) + 1 + MARGIN, size))
            for first, last, size in zip(low, high, self.size, strict=True)
        )

    def load_bytes(self, blocks: Sequence[tuple[int, int]]) -> int:
        """Return the device memory that `load` takes."""
        cols, rows = self.seen(blocks)
        return len(self.splines) * size_class(4 * len(cols) * len(rows))

    def load(self, blocks: Sequence[tuple[int, int]]) -> None:
        """Bring what blocks see onto the device, in place of what was there."""
        seen = self.seen(blocks)
        if seen != self.loaded:
            self._drop()
            (left, *_, right), (top, *_, bottom) = seen
            for j, spline in enumerate(self.splines):
                part = np.ascontiguousarray(spline[top : bottom + 1, left : right + 1])
                self.planes.append(self.device.resident(f"warp plane {j}", part))
            self.loaded = seen

    def release(self) -> None:
        """Give the device's memory back."""
        self._drop()
        self.terms.destroy()

    def _drop(self) -> None:
        for resident in self.planes:
            resident.destroy()
        self.planes, self.loaded = [], (range(0), range(0))

    def record(self, rec: Recording, block: tuple[int, int], planes: Array) -> None:
        """Sample one block of the sim grid into `planes` (J, BY, BX), after `load`."""
        grid = self.grid
        cols, rows = self.loaded
        corner = np.array(grid.block_origin(block)) + 0.5
        for number, coefficients in enumerate(self.planes):
            self.kernel.record(
                rec,
                groups=(-(-grid.block[0] // 16), -(-grid.block[1] // 16), 1),
                params={
                    **self.chief_ray.params(self.pitch_um),
                    "origin": corner - grid.centre,
                    "centre": self.centre,
                    "size": self.size,
                    "first": (cols.start, rows.start),
                    "cols": len(cols),
                    "scale": self.scale,
                    "plane": number,
                },
                coefficients=coefficients,
                terms=self.terms,
                planes=planes,
            )
