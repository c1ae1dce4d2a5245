"""Shading of a picture of an even field: how light, and its colour, fall off from the middle.

The picture is read in blocks, so that noise and texture average out. Shading is a block's mean over
that of the middle block; colour shading is the same of red over green and of blue over green.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane

BLOCKS = (15, 21)  # rows and columns: odd, so that one lies in the middle
LEAST_PX = 4  # sides of a block: two photosites of a colour each way


@dataclass(frozen=True, eq=False)
class Shading:
    """Shading of one channel.

    Attributes
    ----------
    channel : str
    middle : float
        Mean of the middle block, in the picture's unit.
    relative : ndarray (15, 21)
        Means of the blocks over that.
    u : float
        Standard uncertainty of a block's value, by the pixels' spread in the middle block.
    clipped : bool
        Some pixels are black or saturated.
    """

    channel: str
    middle: float
    relative: np.ndarray
    u: float
    clipped: bool

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Return the corner blocks: upper left, upper right, lower left, lower right."""
        return tuple(float(self.relative[at]) for at in ((0, 0), (0, -1), (-1, 0), (-1, -1)))

    @property
    def unevenness(self) -> float:
        """Return (highest - lowest) / highest."""
        return float(1 - self.relative.min() / self.relative.max())


def measure_shading(plane: Plane, channel: str) -> Shading:
    """Measure a channel of a picture of an even field.

    Raises
    ------
    UserError
        The picture is too small, or dark in its middle.
    """
    rows, cols = plane.values.shape
    if min(rows // BLOCKS[0], cols // BLOCKS[1]) < LEAST_PX:
        raise UserError(
            "The picture is too small for a map of shading.",
            field="PICTURE",
            value=f"{cols} x {rows}",
            allowed=f"{LEAST_PX * BLOCKS[1]} x {LEAST_PX * BLOCKS[0]} pixels or more",
        )
    values = plane.values.astype(np.float64)
    own = np.ones(values.shape)
    if plane.sites is not None:
        tiles = [-(-n // p) for n, p in zip(values.shape, plane.sites.shape, strict=True)]
        own = np.tile(plane.sites, tiles)[:rows, :cols].astype(np.float64)
    # Edges of blocks by whole pixels; blocks differ by one pixel at most.
    starts = [
        np.arange(count) * size // count for count, size in zip(BLOCKS, (rows, cols), strict=True)
    ]

    def blocks(of: np.ndarray) -> np.ndarray:
        return np.add.reduceat(np.add.reduceat(of, starts[0], axis=0), starts[1], axis=1)

    seen = own > 0
    count = blocks(own)
    mean = blocks(np.where(seen, values, 0)) / count
    square = blocks(np.where(seen, values, 0) ** 2) / count
    at = BLOCKS[0] // 2, BLOCKS[1] // 2
    middle = float(mean[at])
    if not middle > 0:
        raise UserError(
            "The picture is dark in its middle.",
            field="PICTURE",
            value=f"{middle:g} in {channel}",
            allowed="a picture of an even bright field",
        )
    # A block and the middle one: two means.
    spread = max(float(square[at]) - middle**2, 0.0) ** 0.5
    u = spread * (2 / float(count[at])) ** 0.5 / middle
    low, high = plane.clip
    clipped = bool(np.any((values <= low) & seen) or np.any((values >= high) & seen))
    return Shading(channel, middle, mean / middle, u, clipped)
