"""The planes that the optics make of a filter pattern, and which of them each pixel takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.sensor.sensor import Sensor

# After so many pixels, both ways, the convolution repeats itself without loss: powers of two up to
# the longest stride of its transforms.
PERIODS = (1, 2, 4)


@dataclass(frozen=True)
class Planes:
    """A plane for each site of a pattern that repeats after 1, 2 or 4 pixels both ways.

    Other patterns, such as 6 x 6 or 3 x 2, have a plane for each channel, of all pixels.

    Attributes
    ----------
    period : int
        Pixels from a sample of a plane to the next, both ways.
    channels : tuple of int
        For each plane: its place among the sensor's channels.
    sites : ndarray (rows, cols, 2) of int
        By row and column of a pixel, modulo the array's: its plane, and its site in the sensor's
        pattern.
    """

    period: int
    channels: tuple[int, ...]
    sites: np.ndarray

    @property
    def layers(self) -> int:
        """Planes of each site of the period."""
        return len(self.channels) // self.period**2


def planes_of(sensor: Sensor) -> Planes:
    """Return the planes of a sensor."""
    py, px = sensor.period
    of_site = [sensor.channels.index(name) for name in sensor.site_channels()]
    side = math.lcm(py, px)
    shape = (side, side) if side in PERIODS else (py, px)
    row, col = np.indices(shape)
    site = row % py * px + col % px
    if side in PERIODS:
        plane = row * side + col
        channels = tuple(of_site[one] for one in site.ravel())
        return Planes(side, channels, np.stack([plane, site], axis=-1))
    plane = np.array(of_site)[site]
    return Planes(1, tuple(range(len(sensor.channels))), np.stack([plane, site], axis=-1))
