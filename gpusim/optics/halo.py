"""Host side of the halo stage: light far from its chief ray, convolved on coarse grids.

Each level of a bank's halo (``gpusim.psf.halo``) is a bank of its own with wide, smooth PSFs. It
is rendered like any other before a *coarse sensor*: the real one with fewer, wider spaced pixels,
each with the aperture and the quantum efficiency of a real one. The light of all levels is brought
to the finest of these grids, and from there to the photosites by cubic B-splines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gpusim.gpu import Array, Device, Kernel, Recording
from gpusim.optics.convolve import packed_channels
from gpusim.psf.bank import Bank
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.planes import PERIODS, planes_of
from gpusim.sensor.sensor import Sensor

Rect = tuple[int, int, int, int]

# Pixels of the coarse sensor are so many samples of its level apart where the level holds little
# light, all of it smooth; and so many where rays land there. The sim grid has two samples a pixel.
SMOOTH_STEP, STRUCTURED_STEP = 4.0, 2.0
# In a photograph, levels beyond the first: they have few pixels, and shadows between lamps have all
# of their light from them. With two samples they were 2 to 4 % off there, with one half of that.
WIDE_STEP = 1.0
# Diffraction leaves 0.8 % beyond a core of 64 um at f/2.8. With 1.6 %, a corner of the phone camera
# has rays there, and the level was 13 % off where it was taken as smooth.
LITTLE = 0.01
# Coarse pixels around the sensor: two for the spline, the rest for its coefficients.
FADED = 8
MARGIN = 2 + FADED
# A spline's coefficients from its samples, z^|k| sqrt(3) with z = sqrt(3) - 2 (Unser 1999, eq. 13):
# beyond FADED samples 3e-5 is left.
_Z = math.sqrt(3) - 2
PREFILTER = math.sqrt(3) * _Z ** np.abs(np.arange(-FADED, FADED + 1))
PREFILTER /= PREFILTER.sum()


@dataclass(frozen=True)
class CoarseGrid:
    """The coarse sensor of one level.

    Attributes
    ----------
    sensor : Sensor
    step : float
        Coarse pixels per real one.
    offset : (float, float)
        x, y of the first real pixel's centre, in coarse pixels from the first one's centre.
    """

    sensor: Sensor
    step: float
    offset: tuple[float, float]

    def around(self, rect: Rect) -> Rect:
        """Return the coarse pixels whose coefficients a rectangle of real ones needs."""
        ends = []
        for first, count, offset, size in (
            (rect[0], rect[2], self.offset[1], self.sensor.rows),
            (rect[1], rect[3], self.offset[0], self.sensor.cols),
        ):
            low = math.floor(first * self.step + offset) - 1
            high = math.floor((first + count - 1) * self.step + offset) + 3
            ends.append((max(low, 0), min(high, size)))
        (top, bottom), (left, right) = ends
        return top, left, bottom - top, right - left

    def grown(self, rect: Rect) -> Rect:
        """Return a rectangle of coarse pixels with what its coefficients are made of around it."""
        row, col, rows, cols = rect
        top, left = max(row - FADED, 0), max(col - FADED, 0)
        bottom = min(row + rows + FADED, self.sensor.rows)
        right = min(col + cols + FADED, self.sensor.cols)
        return top, left, bottom - top, right - left


def coarse_grid(level: Bank, sensor: Sensor, edges: bool = True, first: bool = True) -> CoarseGrid:
    """Return the coarse sensor for a level of a halo.

    ``edges``: the scene is a chart, of outlines. In a photograph a bright spot may stand anywhere,
    and lights the shadows around it by the level's finest detail. ``first``: the level is the
    narrowest.
    """
    share = float(level.psf.sum(axis=(-2, -1), dtype=float).max())
    if edges:
        step = SMOOTH_STEP if share < LITTLE else STRUCTURED_STEP
    else:
        step = STRUCTURED_STEP if first else WIDE_STEP
    pitch = max(step * level.pitch_um, sensor.pixel_pitch_um)
    rows, cols = (
        math.ceil(count * sensor.pixel_pitch_um / pitch) + 2 * MARGIN
        for count in (sensor.rows, sensor.cols)
    )
    # A row of channels: as many planes, of all pixels. Those whose count is a period of the
    # convolution's own would be taken for a filter pattern: one more, a channel twice, is none.
    names = list(sensor.channels)
    if len(names) in PERIODS[1:]:
        names.append(names[0])
    ratio = sensor.pixel_pitch_um / pitch
    coarse = sensor.unchecked(
        rows=rows,
        cols=cols,
        pixel_pitch_um=pitch,
        fill_factor=sensor.fill_factor * ratio**2,
        aperture=None,
        scan_motion_px=None,
        cfa=ColourFilterArray(pattern=[names]),
        veiling_glare=0.0,
        optical_black=None,
        overscan=None,
        smear=None,
        bloom=False,
        parallel_cti=None,
        serial_cti=None,
        crosstalk=None,
        defects=None,
        masks=None,
    )
    offset = tuple(
        (few - 1) / 2 - ratio * (count - 1) / 2
        for few, count in ((cols, sensor.cols), (rows, sensor.rows))
    )
    return CoarseGrid(coarse, ratio, offset)


def coefficients(samples: np.ndarray, grown: Rect, wanted: Rect) -> np.ndarray:
    """Return the B-spline coefficients (C, rows, cols) of a rectangle.

    Sums of neighbours in a fixed order: the same bits for every rectangle.

    Parameters
    ----------
    samples : ndarray (C, rows, cols)
        Samples of the rectangle `grown`. Beyond it, at the border of the coarse sensor, the values
        stay.
    grown, wanted : Rect
    """
    result = samples.astype(np.float64)
    for axis in (0, 1):
        first, count = wanted[axis], wanted[2 + axis]
        at = np.arange(first, first + count)
        total = 0.0
        for shift, weight in zip(range(-FADED, FADED + 1), PREFILTER, strict=True):
            place = np.clip(at + shift - grown[axis], 0, grown[2 + axis] - 1)
            total = total + weight * np.take(result, place, axis=1 + axis)
        result = total
    return result


def interpolated(
    splines: np.ndarray, first: tuple[int, int], y: np.ndarray, x: np.ndarray
) -> np.ndarray:
    """Return splines (C, rows, cols), whose first sample has a number, on a grid of points."""
    result = splines
    for axis, places in enumerate((y, x)):
        cell = np.floor(places)
        t, e = places - cell, 1 - (places - cell)
        weights = (e**3, 4 + 3 * t * t * (t - 2), 4 + 3 * e * e * (e - 2), t**3)
        total = 0.0
        for tap, weight in enumerate(weights):
            number = np.clip(
                cell.astype(int) - 1 + tap - first[axis], 0, result.shape[1 + axis] - 1
            )
            shape = [1, -1, 1] if axis == 0 else [1, 1, -1]
            total = total + (weight / 6).reshape(shape) * np.take(result, number, axis=1 + axis)
        result = total
    return result


class Halo:
    """The halo of a rectangle of the sensor, on the device.

    Parameters
    ----------
    device : Device
    sensor : Sensor
    grids : list of CoarseGrid
        Grids of the levels, the finest first.
    light : list of ndarray (C, rows, cols)
        Electrons/s on the coarse pixels of each level that `needed` names.
    rect : Rect
        Rectangle of lit pixels.
    """

    def __init__(
        self,
        device: Device,
        sensor: Sensor,
        grids: list[CoarseGrid],
        light: list[np.ndarray],
        rect: Rect,
    ) -> None:
        planes = planes_of(sensor)
        self.period, self.planes = planes.period, len(planes.channels)
        self.site_channels = packed_channels(planes.channels)
        self.rect, self.grid = rect, grids[0]
        wants = wanted(grids, rect)
        total = light[0].astype(np.float64)
        row, col, rows, cols = self.grid.grown(wants[0])
        for grid, samples, want in zip(grids[1:], light[1:], wants[1:], strict=True):
            splines = coefficients(samples, grid.grown(want), want)
            ratio = grid.step / self.grid.step
            y, x = (
                (np.arange(start, start + count) - own) * ratio + other
                for start, count, own, other in (
                    (row, rows, self.grid.offset[1], grid.offset[1]),
                    (col, cols, self.grid.offset[0], grid.offset[0]),
                )
            )
            total += interpolated(splines, want[:2], y, x)
        self.wanted = wants[0]
        splines = coefficients(total, (row, col, rows, cols), self.wanted)
        self.coefficients = device.resident("halo", splines.astype(np.float32))
        self.kernel = Kernel("optics/halo", S=self.planes, PERIOD=self.period)

    def covers(self, rect: Rect) -> bool:
        """Return whether the halo of a rectangle is there."""
        return all(
            own <= first and first + count <= own + more
            for own, more, first, count in zip(
                self.rect[:2], self.rect[2:], rect[:2], rect[2:], strict=True
            )
        )

    def release(self) -> None:
        """Give the device's memory back."""
        self.coefficients.destroy()

    def record(self, rec: Recording, rates: Array, rect: Rect) -> None:
        """Add the halo to the planes (S, rows, cols) of the CFA sites of a rectangle, electrons/s.

        Parameters
        ----------
        rec : Recording
        rates : buffer (S, rows, cols)
        rect : (row0, col0, rows, cols)
            Rectangle of pixels, aligned to the CFA period.
        """
        row0, col0, rows, cols = (-(-value // self.period) for value in rect)
        top, left, given_rows, given_cols = self.wanted
        self.kernel.record(
            rec,
            (-(-cols // 16), -(-rows // 16), self.planes),
            {
                "origin": (col0, row0),
                "size": (cols, rows),
                "first": (left, top),
                "given": (given_cols, given_rows),
                "step": self.grid.step,
                "pad": 0.0,
                "offset": self.grid.offset,
                "site_channels": self.site_channels,
            },
            coefficients=self.coefficients,
            rates=rates,
        )


def wanted(grids: list[CoarseGrid], rect: Rect) -> list[Rect]:
    """Return the coarse pixels of each level whose coefficients a rectangle of real ones needs."""
    found = [grids[0].around(rect)]
    row, col, rows, cols = grids[0].grown(found[0])
    for grid in grids[1:]:
        ratio = grid.step / grids[0].step
        ends = []
        for start, count, own, other, size in (
            (row, rows, grids[0].offset[1], grid.offset[1], grid.sensor.rows),
            (col, cols, grids[0].offset[0], grid.offset[0], grid.sensor.cols),
        ):
            low = math.floor((start - own) * ratio + other) - 1
            high = math.floor((start + count - 1 - own) * ratio + other) + 3
            ends.append((min(max(low, 0), size - 1), min(max(high, 1), size)))
        (top, bottom), (left, right) = ends
        found.append((top, left, bottom - top, right - left))
    return found


def needed(grids: list[CoarseGrid], rect: Rect) -> list[Rect]:
    """Return the coarse pixels of each level whose light a rectangle of real ones needs."""
    return [grid.grown(want) for grid, want in zip(grids, wanted(grids, rect), strict=True)]
