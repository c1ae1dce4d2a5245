"""An image blurred with a PSF that changes over it, on the image's own grid.

The operator of the chain without spectra and photosites: every sample is spread by the PSF that
belongs to it, interpolated bilinearly between PSF nodes. Blocks are convolved with transforms of
160 samples, overlap-add; one invocation of the shaders holds a whole line.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.fft

from gpusim.errors import UserError
from gpusim.gpu import Array, Device, Kernel, Recording, Use, default_device
from gpusim.gpu.pool import MAX_BINDING_BYTES

LENGTH = 160  # of the transforms of shaders/common/line_160
HALF = LENGTH // 2 + 1
SMALLEST = LENGTH // 2  # side of a block: its window overlaps the next one's, and no further
WIDEST = LENGTH - SMALLEST + 1  # PSF that fits a window beside the smallest block


class Blur:
    """PSFs on the device, ready to blur images of one shape.

    The shaders hold a line of 160 samples in each invocation. A new side of the blocks is compiled
    anew, which takes seconds the first time on a machine.

    Parameters
    ----------
    psfs : ndarray (GY, GX, C, K, K)
        PSF of each node and channel, as it lands; K odd, its centre in the middle. Node (i, j) lies
        at the edges of samples (i * spacing, j * spacing).
    shape : (int, int)
        Rows and columns of the images; at most (G - 1) * spacing.
    spacing : int
        Samples from node to node; a multiple of 4.
    device : Device, optional

    Raises
    ------
    UserError
        For PSFs that are even, not finite, wider than 81 samples or fewer than 2 x 2 nodes, for a
        spacing that is no multiple of 4, and for images that the nodes do not cover.
    """

    def __init__(
        self,
        psfs: np.ndarray,
        shape: tuple[int, int],
        spacing: int,
        device: Device | None = None,
    ) -> None:
        psfs = np.asarray(psfs)
        _check_psfs(psfs)
        nodes, size = psfs.shape[:2], psfs.shape[-1]
        _check(
            "spacing",
            spacing,
            spacing > 0 and spacing % 4 == 0,
            "a multiple of 4, which the blocks of the transforms are",
        )
        covered = tuple((count - 1) * spacing for count in nodes)
        _check(
            "shape",
            shape,
            all(1 <= side <= most for side, most in zip(shape, covered, strict=True)),
            f"1 x 1 to {covered[0]} x {covered[1]}, which the nodes cover",
        )
        self.device = device or default_device()
        self.shape, self.channels = tuple(shape), psfs.shape[2]
        # The centre at a multiple of 4, so that windows begin where four samples do.
        self.margin = -(-(size // 2) // 4) * 4
        largest = LENGTH - self.margin - size // 2
        sides = [side for side in range(SMALLEST, largest + 1, 4) if spacing % side == 0]
        _check(
            "spacing",
            spacing,
            bool(sides),
            f"a multiple of a multiple of 4 from {SMALLEST} to {largest}, the side of a block",
        )
        self.side = sides[-1]
        self.per_cell = spacing // self.side
        down, across = (count * self.per_cell for count in (nodes[0] - 1, nodes[1] - 1))
        self.blocks = (down, across)
        self.rows = 2 * -(-(self.margin + size // 2 + 1) // 2)
        self.blur_fft, self.overlap_add = (
            Kernel(f"optics/{name}", SIDE=self.side) for name in ("blur_fft", "overlap_add")
        )
        straight = straight_through(str(self.device.report()["driver"]))
        keep = straight and self.per_cell == 1
        self.blur_product = Kernel(
            "optics/blur_product", SIDE=self.side, ROWS=self.rows, STRAIGHT=straight, KEEP=keep
        )
        # As many channels at once as a binding holds the spectra and the PSFs of. With the copies
        # and the columns, half as large, that is less than six times what the larger takes.
        largest = 8 * HALF * max(2 * down * across * self.side, math.prod(nodes) * self.rows)
        at_once = max(1, min(MAX_BINDING_BYTES, self.device.pool.budget // 8) // largest)
        starts = range(0, self.channels, at_once)
        self.turns = [range(first, min(first + at_once, self.channels)) for first in starts]
        self.psfs = [
            self.device.resident(
                f"psfs {turn.start}", self._transformed(psfs[:, :, turn]), Use.TEXELS
            )
            for turn in self.turns
        ]

    def _transformed(self, psfs: np.ndarray) -> np.ndarray:
        """Return PSFs (C, GY, GX, ROWS/2, 81, 2) transformed along x, as float32 (..., 2)."""
        psfs, size = np.moveaxis(psfs, 2, 0), psfs.shape[-1]
        first = self.margin - size // 2
        placed = np.zeros((*psfs.shape[:3], self.rows, LENGTH))
        placed[..., first : first + size, first : first + size] = psfs
        lines = scipy.fft.rfft(placed, workers=2) / LENGTH**2
        pairs = lines.reshape(*psfs.shape[:3], self.rows // 2, 2, HALF).swapaxes(-1, -2)
        return np.ascontiguousarray(pairs, np.complex64).view(np.float32)

    @staticmethod
    def _to_texels(rec: Recording, label: str, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """Declare what one step writes, and the texels that the next one reads."""
        return (
            rec.buffer(label, shape, np.float32),
            rec.buffer(f"{label} texels", shape, np.float32, Use.TEXELS),
        )

    def release(self) -> None:
        """Give the device's memory back."""
        for resident in self.psfs:
            resident.destroy()

    def __call__(self, image: np.ndarray) -> np.ndarray:
        """Blur an image.

        Parameters
        ----------
        image : ndarray (C, rows, cols)
            Black beyond its borders.

        Returns
        -------
        ndarray (C, rows, cols), float32
            In the image's unit.

        Raises
        ------
        UserError
            For an image of another shape, or one with a NaN or an infinity.
        """
        image = np.asarray(image, np.float32)
        expected = (self.channels, *self.shape)
        _check("image", image.shape, image.shape == expected, f"{expected}")
        # Both are NaN where one number is.
        finite = np.isfinite([image.min(), image.max()]).all()
        _check("image", "NaN or infinity", bool(finite), "finite numbers")
        down, across = self.blocks
        count = down * across
        covered = (down * self.side, across * self.side)
        frame = tuple(side + LENGTH - self.side for side in covered)  # windows overlap
        missing = [(0, side - given) for side, given in zip(covered, self.shape, strict=True)]
        padded = np.pad(image, [(0, 0), *missing]) if covered != self.shape else image
        rec = Recording(self.device)
        sources = []  # all at first: what is recorded after an upload is submitted apart
        for turn in self.turns:
            label, shape = f"source {turn.start}", (len(turn), *covered)
            sources.append(rec.buffer(label, shape, np.float32, Use.TEXELS))
            rec.upload(sources[-1], padded[turn.start : turn.stop])
        most, pairs = len(self.turns[0]), frame[0] // 2
        spectra, rows = self._to_texels(rec, "spectra", (most * count, self.side, HALF, 2, 2))
        columns, mixed = self._to_texels(rec, "columns", (most * across, pairs, HALF, 2, 2))
        blurred = rec.buffer("blurred", (self.channels, *frame), np.float32)
        blocks = {"across": across, "per_cell": self.per_cell}
        for turn, source, psfs in zip(self.turns, sources, self.psfs, strict=True):
            lines = len(turn) * count * self.side
            self.blur_fft.record(
                rec,
                self.blur_fft.cover(lines),
                {"lines": lines, "stride": covered[1] // 4, **blocks},
                image=source,
                spectra=spectra,
            )
            rec.copy(spectra, rows)
            lines = len(turn) * across * HALF
            self.blur_product.record(
                rec,
                self.blur_product.cover(lines),
                {"lines": lines, "down": down, **blocks},
                spectra=rows,
                psfs=psfs,
                columns=columns,
            )
            rec.copy(columns, mixed)
            lines, first = len(turn) * pairs, turn.start * pairs * frame[1] // 2
            self.overlap_add.record(
                rec,
                self.overlap_add.cover(lines),
                {"lines": lines, "rows": frame[0], "across": across, "first": first},
                columns=mixed,
                image=blurred,
            )
        label = rec.download(blurred)
        result = rec.run()[label]
        rows, cols = (slice(self.margin, self.margin + side) for side in self.shape)
        return result[:, rows, cols]


def blur(
    image: np.ndarray, psfs: np.ndarray, spacing: int, device: Device | None = None
) -> np.ndarray:
    """Blur one image: see `Blur`, which keeps the PSFs for the next."""
    made = Blur(psfs, np.shape(image)[1:], spacing, device)
    try:
        return made(image)
    finally:
        made.release()


def straight_through(driver: str) -> bool:
    """Return whether the middle step's nodes are better not in a loop, with the driver so called.

    Only with lavapipe of Mesa 22: see shaders/optics/blur_product.wgsl for the times.
    """
    return driver.startswith("Mesa 22.")


def _check_psfs(psfs: np.ndarray) -> None:
    _check(
        "psfs",
        psfs.shape,
        psfs.ndim == 5 and min(psfs.shape[:2]) >= 2 and min(psfs.shape) > 0,
        "(GY, GX, C, K, K), 2 x 2 nodes or more",
    )
    rows, cols = psfs.shape[-2:]
    _check(
        "psfs",
        f"{rows} x {cols} samples",
        rows == cols and rows % 2 == 1 and rows <= WIDEST,
        f"odd and square, at most {WIDEST} x {WIDEST}",
    )
    _check("psfs", "NaN or infinity", bool(np.isfinite(psfs).all()), "finite numbers")


def _check(field: str, value: object, valid: bool, allowed: str) -> None:
    if not valid:
        raise UserError(f"The {field} cannot be used.", field=field, value=value, allowed=allowed)
