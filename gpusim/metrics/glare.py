"""Veiling glare from black spots in a bright field: the integral method of ISO 9358:1994.

The veiling glare index is the illuminance in the middle of a black spot's image over that of the
bright field around it. Spots are found by themselves; each is read where it lies farthest from its
rim, the field in a ring about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import (
    binary_dilation,
    distance_transform_edt,
    find_objects,
    label,
    uniform_filter,
)

from gpusim.errors import UserError
from gpusim.metrics.figure import Figure
from gpusim.metrics.picture import Plane

SMOOTH = 3  # cells of the filter pattern: a hot pixel makes no spot
LEAST_CELLS = 5  # from a spot's rim to its middle
MIDDLE = 0.5  # of that: what lies deeper is the middle
RING = 1.0, 2.0  # depths beyond the rim, between which the field is read


@dataclass(frozen=True)
class Spot:
    """A black spot in one channel.

    Attributes
    ----------
    number : int
    place_px : (float, float)
        Its middle, columns and rows.
    radius_px : float
        From its rim to its middle.
    dark, field : Figure
        Mean in its middle and around it, in the picture's unit.
    """

    number: int
    place_px: tuple[float, float]
    radius_px: float
    dark: Figure
    field: Figure

    @property
    def index(self) -> Figure:
        """Veiling glare index, a share."""
        return self.dark.over(self.field)


def measure_glare(plane: Plane, channel: str) -> tuple[Spot, ...]:
    """Measure the veiling glare in every black spot of a channel, those higher up first.

    Raises
    ------
    UserError
        There is no black spot that ends within the picture.
    """
    cells, shape = _cells(plane)
    smooth = uniform_filter(cells, SMOOTH)
    dark = smooth < (smooth.min() + np.median(smooth)) / 2
    numbered, _ = label(dark)
    spots: list[Spot] = []
    for number, box in enumerate(find_objects(numbered), start=1):
        rows, cols = box
        ends = rows.start > 0 and cols.start > 0
        if not ends or rows.stop == dark.shape[0] or cols.stop == dark.shape[1]:
            continue
        own = numbered == number
        inside = distance_transform_edt(own)
        depth = float(inside.max())
        if depth < LEAST_CELLS:
            continue
        outside = distance_transform_edt(~own)
        ring = (outside > RING[0] * depth) & (outside < RING[1] * depth)
        ring &= ~binary_dilation(dark, iterations=int(depth))
        if not ring.any():
            continue
        at = np.argwhere(inside > MIDDLE * depth).mean(axis=0)
        place = float((at[1] + 0.5) * shape[1]), float((at[0] + 0.5) * shape[0])
        figures = (_mean(cells[one]) for one in (inside > MIDDLE * depth, ring))
        spots.append(Spot(len(spots) + 1, place, depth * max(shape), *figures))
    if not spots:
        raise UserError(
            "No black spot is found in the picture.",
            field="PICTURE",
            value=channel,
            allowed=f"black spots on a bright field, {2 * LEAST_CELLS * max(shape)} pixels wide or "
            "more, with as much field around them; such as the chart glare-spots",
        )
    return tuple(spots)


def _cells(plane: Plane) -> tuple[np.ndarray, tuple[int, int]]:
    """Return the channel's mean in each filter pattern, and the pattern's rows and columns."""
    if plane.sites is None:
        return plane.values.astype(np.float64), (1, 1)
    high, wide = plane.sites.shape
    rows, cols = (n // p * p for n, p in zip(plane.values.shape, (high, wide), strict=True))
    cells = plane.values[:rows, :cols].reshape(rows // high, high, cols // wide, wide)
    own = plane.sites[None, :, None, :]
    return (cells * own).sum(axis=(1, 3), dtype=np.float64) / plane.sites.sum(), (high, wide)


def _mean(values: np.ndarray) -> Figure:
    spread = float(values.std(ddof=1)) if values.size > 1 else 0.0
    return Figure(float(values.mean()), spread / values.size**0.5)
