"""Space-variant convolution of one frame: FFTs of rows and columns, inverse FFT, block by block.

Scatter: every source sample is spread by the PSF that belongs to *it*, interpolated bilinearly
between the four PSF nodes of its cell. The weights separate in x and y, so two row spectra and four
column spectra serve the four nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording, Use
from gpusim.gpu.pool import size_class
from gpusim.optics.grid import SimGrid
from gpusim.optics.kernel_spectra import kernel_spectra
from gpusim.optics.nodes import NodeStore, Outputs, Rates, Scale, folds_of, outputs_of
from gpusim.sensor.aperture import Response

# First radix for a line of so many samples, for shaders/common/line_fft: length = FIRST_RADIX 8^k.
FIRST_RADIX = {16: 2, 32: 4, 64: 8, 128: 2, 256: 4, 512: 8, 1024: 2}


class Scratch:
    """What one block needs on the device; the next block of the same scale uses it again.

    `lines` of spectra for each row of the source: as many as planes, unless given.
    """

    def __init__(
        self, rec: Recording, name: str, grid: SimGrid, planes: int, lines: int | None = None
    ) -> None:
        self.planes, self.spectra, self.lines, self.folded = (
            rec.buffer(f"{label} {name}", shape, np.float32)
            for label, shape in self.shapes(grid, planes, lines).items()
        )

    @staticmethod
    def shapes(grid: SimGrid, planes: int, lines: int | None = None) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array, of floats."""
        pairs = -(-grid.sites // 2)
        lines = lines or planes
        # Squares of 16 x 17 numbers: see shaders/optics/fft_columns.
        slots = (
            grid.length // 256 * 2 * lines * 16 * 17 + pairs * grid.length // 16 // grid.stride * 17
        )
        return {
            "planes": (planes, grid.block[1], grid.block[0]),
            "spectra": (lines, grid.block[1], grid.length, 2),
            "lines": (grid.length // 16, slots, 8, 4),
            "folded": (pairs, grid.window, grid.length // 2, 2, 2),
        }

    @classmethod
    def nbytes(cls, grid: SimGrid, planes: int, lines: int | None = None) -> int:
        """Return the device memory that the arrays take."""
        return sum(size_class(4 * math.prod(s)) for s in cls.shapes(grid, planes, lines).values())


def packed_channels(of_site: list[int]) -> list[int]:
    """Return the kernel of each site, four bits a site, as optics/fft_columns reads them."""
    words = [0, 0, 0, 0]
    for site, kernel in enumerate(of_site):
        words[site // 8] |= kernel << (4 * (site % 8))
    return words


def spectra_bytes(grid: SimGrid, outputs: Outputs) -> int:
    """Return the bytes of the spectra of one plane's kernels."""
    return len(outputs.places) * grid.length // 2 * grid.length * 8


def block_transform(grid: SimGrid) -> dict[str, int]:
    """Return the overrides of a transform of a block's rows."""
    return {
        "T": grid.length,
        "LANES": grid.length // 8,
        "FIRST_RADIX": FIRST_RADIX[grid.length],
        "BX": grid.block[0],
        "BY": grid.block[1],
    }


def fft_columns_passes(
    grid: SimGrid, outputs: Outputs, nodes: int
) -> list[tuple[Kernel, dict[str, object]]]:
    """Return a block's dispatches of optics/fft_columns: kernels, and params of sizes.

    Parameters
    ----------
    grid : SimGrid
    outputs : Outputs
    nodes : int
        Four PSF nodes, or one or two lines of modes.
    """
    pairs, times, channels = -(-grid.sites // 2), grid.length // 256, len(outputs.places)
    length, stride = {"TIMES": times}, {"D": grid.stride}
    sizes = {
        "first": 0,
        "channels": channels,
        "pairs": (0, pairs),
        "site_slots": pairs * grid.length // 16 // grid.stride * 17,
        "height": grid.block[1],
        "times": times,
        "period": grid.period,
        "site_step": outputs.step,
        "site_channels": packed_channels(outputs.of_site),
    }
    fours: list[dict[str, object]] = [{}]
    if channels > 4:  # each has a site of its own
        fours = [
            {"first": first, "pairs": (first // 2, min(first // 2 + 2, pairs))}
            for first in range(0, channels, 4)
        ]
    products = Kernel("optics/fft_columns", PHASE=1, C=min(channels, 4), NODES=nodes, **stride)
    return [
        (Kernel("optics/fft_columns", PHASE=0, NODES=nodes, **length), sizes),
        *((products, sizes | four) for four in fours),
        (Kernel("optics/fft_columns", PHASE=2, **length, **stride), sizes),
    ]


class Transforms:
    """What the methods with transforms share: column products and the inverse, block by block.

    Parameters
    ----------
    device : Device
    scale : Scale
    outputs : Outputs
    nodes : int
        Four PSF nodes, or one or two lines of modes: see shaders/optics/fft_columns.
    """

    use = Use.TEXELS  # of kernels, of which there are most numbers to load

    def __init__(self, device: Device, scale: Scale, outputs: Outputs, nodes: int) -> None:
        self.grid = grid = scale.grid
        self.fft_columns = fft_columns_passes(grid, outputs, nodes)
        self.inverse_fft = Kernel(
            "optics/inverse_fft",
            T=grid.length,
            D=grid.stride,
            M=grid.window,
            LANES=grid.length // 8,
            SITE_RADIX=FIRST_RADIX[grid.window],
            S=grid.sites,
        )
        turns = np.exp(-2j * np.pi * np.arange(grid.length) / grid.length)
        self.twiddle = device.resident("twiddle", turns.astype(np.complex64).view(np.float32))

    def record_inverse(
        self,
        rec: Recording,
        block: tuple[int, int],
        scratch: Scratch,
        rates: Rates,
        *,
        columns: dict[str, object],
        kernels: Sequence[Array],
    ) -> None:
        """Multiply the spectra in the scratch with four kernels, and add the block to the rates.

        `columns` are the params of shaders/optics/fft_columns, but for the sizes; of a block that
        is `mirrored` there, `block` is the one whose mirror image it is.
        """
        grid = self.grid
        names = ("kernels_00", "kernels_10", "kernels_01", "kernels_11")
        for kernel, sizes in self.fft_columns:
            kernel.record(
                rec,
                groups=(grid.length // 16, 1, 1),
                params={**columns, **sizes},
                twiddle=self.twiddle,
                spectra=scratch.spectra,
                **dict(zip(names, kernels, strict=True)),
                lines=scratch.lines,
                folded=scratch.folded,
            )
        row0, col0, rows, cols = rates.cells(grid.period)
        origin, step = [], []
        for at, before, side, mirrored in zip(
            grid.window_origin(block),
            (col0, row0),
            (grid.cols, grid.rows),
            columns["mirrored"],
            strict=True,
        ):
            origin.append((side // grid.period - 1 - at if mirrored else at) - before)
            step.append(-1 if mirrored else 1)
        self.inverse_fft.record(
            rec,
            groups=(-(-grid.seen[1] // grid.stride), -(-grid.sites // 4), 1),
            params={"origin": origin, "step": step, "size": (cols, rows), "seen": grid.seen},
            twiddle=self.twiddle,
            folded=scratch.folded,
            rates=rates.planes,
        )


class Convolve(Transforms, NodeStore):
    """Channel kernels of one scale, and the passes that use them: see `KernelStore`.

    Parameters
    ----------
    device : Device
    scale : Scale
    needed : dict
        Coefficient planes that each block needs.
    aperture_um : float or Response
        Side of the square pixel aperture, or any other's response.
    site_channels : list of int
        Colour channel of each CFA site, row by row.
    """

    def __init__(
        self,
        device: Device,
        scale: Scale,
        needed: dict[tuple[int, int], int],
        aperture_um: float | Response,
        site_channels: list[int],
    ) -> None:
        grid = scale.grid
        self.outputs = outputs_of(grid, site_channels, scale.kernels.splines.shape[2])
        folds = folds_of(grid, scale.kernels.mirrored, aperture_um, self.outputs.step)
        NodeStore.__init__(self, device, scale, needed, folds)
        Transforms.__init__(self, device, scale, self.outputs, 4)
        self.fft_rows = Kernel("optics/fft_rows", **block_transform(grid))
        self.aperture = aperture_um / scale.pitch_um  # sim samples
        self.half_size = grid.half_size
        self.plane_bytes = spectra_bytes(grid, self.outputs)

    def made_of(self, kernels: np.ndarray) -> np.ndarray:
        """Return the spectra of a node's kernels."""
        given = self.grid.length, self.aperture, self.scale.sigma, self.outputs.places
        return kernel_spectra(kernels, *given, ringing=self.scale.kernels.ringing)

    def scratch(self, rec: Recording, planes: int) -> Scratch:
        """Declare what one block needs on the device."""
        return Scratch(rec, self.scale.name, self.grid, planes)

    def scratch_bytes(self, planes: int) -> int:
        """Return the device memory that `scratch` takes."""
        return Scratch.nbytes(self.grid, planes)

    def release(self) -> None:
        """Give the device's memory back."""
        super().release()
        self.twiddle.destroy()

    def record(
        self,
        rec: Recording,
        block: tuple[int, int],
        needed: int,
        scratch: Scratch,
        rates: Rates,
    ) -> None:
        """Add one block to the planes of the CFA sites; its kernels are loaded.

        Parameters
        ----------
        rec : Recording
        block : (int, int)
        needed : int
            Planes that are not zero in the block.
        scratch : Scratch
            Its planes hold the block's source.
        rates : Rates
            What electrons/s are added to.
        """
        grid = self.grid
        block, mirrored = grid.folded(block, self.folds)
        (first_x, step_x), (first_y, step_y) = grid.node_weights(block)
        self.fft_rows.record(
            rec,
            groups=(-(-grid.block[1] // 2), needed, 1),
            params={"first_s": first_x, "step_s": step_x, "mirrored": mirrored},
            twiddle=self.twiddle,
            planes=scratch.planes,
            spectra=scratch.spectra,
        )
        x, y = grid.cell_of(block)
        self.record_inverse(
            rec,
            block,
            scratch,
            rates,
            columns={"first_s": first_y, "step_s": step_y, "planes": needed, "mirrored": mirrored},
            kernels=[self.nodes[x + dx, y + dy] for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1))],
        )
