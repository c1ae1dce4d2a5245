"""Host side of the warp stage: a raster scene sampled on the sim grid through the chief-ray map."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.optics.convolve import Scale
from gpusim.scene.raster import PlacedRaster


class Warp:
    """A raster scene on the device.

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
        splines = np.tensordot(coefficients.T, raster.spline_coefficients(), axes=1)
        self.planes = [
            device.resident(f"warp plane {j}", np.ascontiguousarray(spline, np.float32))
            for j, spline in enumerate(splines)
        ]
        blocks = self.grid.blocks
        self.needed = {(x, y): len(splines) for y in range(blocks[1]) for x in range(blocks[0])}
        self.size = (splines.shape[2], splines.shape[1])
        self.scale = scale.pitch_um / raster.pitch_um
        self.centre = (-raster.x0_um / raster.pitch_um - 0.5, -raster.y0_um / raster.pitch_um - 0.5)
        self.kernel = Kernel("optics/warp", BX=self.grid.block[0], BY=self.grid.block[1])

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in self.planes:
            resident.destroy()

    def record(self, rec: Recording, block: tuple[int, int], planes: Array) -> None:
        """Sample one block of the sim grid into `planes` (J, BY, BX)."""
        grid = self.grid
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
                    "scale": self.scale,
                    "plane": number,
                },
                coefficients=coefficients,
                planes=planes,
            )
