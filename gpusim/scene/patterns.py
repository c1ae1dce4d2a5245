"""Charts without outlines: waves, zone plates, dead leaves, points of light, drawn on samples.

The samples are those of a photograph: the scene is the cubic spline through them
(`gpusim.scene.raster`), in the exact model too. Such a spline has less of a wave than its samples:
those of waves are larger by as much (`Wave`). Lengths are in the file's unit; a pattern goes on
beyond the sensor by `OVERSCAN`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from gpusim.config.model import Strict
from gpusim.scene.chart_shapes import Angle, Count, Size
from gpusim.scene.fills import Fill

if TYPE_CHECKING:
    from gpusim.sensor.sensor import Sensor

OVERSCAN = 1.06  # what a barrel-distorting lens looks past
PER_PIXEL = 2.0  # samples, unless the file says how many
MOST_ROWS = 4096  # unless it does: 4096 x 5461 samples are 90 MB a plane
# Samples of the shortest period, unless the file says how many: the first image of a wave of 4 is
# 1/81 of it, of 3 it is 1/16. A file may go down to 3, and up to 8192 rows.
PER_PERIOD, LEAST_PERIOD = 4.0, 3.0
LIMIT_ROWS = 8192
BAND_ROWS = 256  # that are drawn at once
LAYERS = 200_000  # leaves at most
ROUNDING = 1e-9  # of a size: what counts as equal
TINY = 1e-30  # far below any sample's distance from the middle, squared


@dataclass(frozen=True)
class Frame:
    """The camera that a chart is laid out for, as far as it is known.

    Attributes
    ----------
    rows, aspect, half_height_um
        The sensor's rows, width over height, and half its height.
    principal_mm : float or None
        The lens's principal distance.
    object_mm : float or None
        From the entrance pupil to the plane of the object; None where that is at infinity.
    """

    rows: int = 1520
    aspect: float = 4 / 3
    half_height_um: float | None = None
    principal_mm: float | None = None
    object_mm: float | None = None

    @classmethod
    def of(cls, sensor: Sensor, principal_mm: float | None = None) -> Frame:
        """Return that of a sensor, behind a lens that looks to infinity."""
        half_um = sensor.rows * sensor.pixel_pitch_um / 2
        return cls(sensor.rows, sensor.cols / sensor.rows, half_um, principal_mm)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A pattern on samples.

    Attributes
    ----------
    planes : ndarray (M, rows, cols), float32
        Shares of the fills.
    materials : tuple of int
        Which fill each plane is.
    half_um : (float, float) or None
        Half the width and height that they cover.
    note : str
        How it was sampled.
    waves : bool
        Whether they are samples of waves: see `gpusim.scene.raster.Raster`.
    """

    planes: np.ndarray
    materials: tuple[int, ...]
    half_um: tuple[float, float] | None
    note: str
    waves: bool


class Pattern(Strict):
    """A pattern of two fills, the dark and the bright one."""

    pattern: str
    fills: tuple[Any, Any]
    samples: Annotated[int, Field(ge=16, le=LIMIT_ROWS, strict=True)] | None = None

    def share(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return the bright fill's share at points, in the file's unit, of samples so far apart."""
        raise NotImplementedError

    def least_period(self, half_w: float, half_h: float) -> float:
        """Return the shortest period in a field of that size; infinite where there is none."""
        return math.inf

    def drawn(
        self, fills: Sequence[Fill], materials: Sequence[int], scale: float, frame: Frame
    ) -> Drawn:
        """Return it on samples.

        Parameters
        ----------
        fills : sequence of Fill
            The background's, the dark and the bright one.
        materials : sequence of int
            Their numbers.
        scale : float
            Half-heights of the sensor in one of the file's unit.
        frame : Frame

        Raises
        ------
        ValueError
            Where a period is too short for the samples.
        """
        shortest = self.least_period(frame.aspect / scale, 1 / scale)
        rows = self.samples or _rows(frame.rows, shortest * scale / 2)
        step = 2 / rows / scale
        half_h = OVERSCAN / scale
        half_w = half_h * frame.aspect
        if shortest < (1 - ROUNDING) * LEAST_PERIOD * step:
            raise ValueError(
                f"a period of {shortest:.4g} is {shortest / step:.3g} samples of {step:.4g}; it "
                f"takes {LEAST_PERIOD:g}, or more samples"
            )
        count = [2 * math.ceil(half / step) for half in (half_h, half_w)]
        y, x = (step * (np.arange(n) + 0.5 - n / 2) for n in count)
        share = np.empty((count[0], count[1]), np.float32)
        for first in range(0, len(y), BAND_ROWS):
            band = slice(first, first + BAND_ROWS)
            share[band] = self.share(x[None], y[band, None], step)
        half_um = None
        if frame.half_height_um is not None:
            size = frame.half_height_um * scale * step / 2
            half_um = (count[1] * size, count[0] * size)
        pixel = rows / frame.rows
        note = f"drawn on {count[1]} x {count[0]} samples, {pixel:.3g} to a pixel"
        if shortest < math.inf:
            note += f"; its shortest period, {shortest * scale * frame.rows / 2:.4g} pixels, has "
            note += f"{shortest / step:.3g}: beside it lies an image of "
            note += f"{(shortest / step - 1) ** -4:.2g} of its amplitude, "
            note += f"{pixel * (1 - step / shortest):.3g} cycles a pixel"
        planes = np.stack([1 - share, share])
        return Drawn(planes, tuple(materials[1:]), half_um, note, isinstance(self, Wave))


def _rows(sensor: int, shortest: float) -> int:
    """Return on how many rows to draw a period, a share of the sensor's height, before a sensor."""
    rows = min(math.ceil(PER_PIXEL * sensor), MOST_ROWS)
    wanted = PER_PERIOD / max(shortest, PER_PERIOD / LIMIT_ROWS)
    return max(rows, math.ceil(wanted * (1 - ROUNDING)))


def spline_response(cycles: np.ndarray | float) -> np.ndarray:
    """Return the amplitude of waves, cycles a sample, in the cubic spline through their samples.

    sinc^4(f) over the sum of sinc^4(f + k), which is 1 - 2/3 sin^2(pi f) (Unser 1999, eq. 14 and
    24): the rest is images at f + k cycles, of (f / (f + k))^4 as much.
    """
    return np.sinc(cycles) ** 4 / (1 - 2 / 3 * np.sin(np.pi * cycles) ** 2)


class Wave(Pattern):
    """A wave between both fills, whose frequency may differ from place to place.

    Its samples are as much larger as the spline through them keeps less of its local frequency.
    That is exact for an even one, and where the frequency changes little over a few samples.
    """

    def turns(
        self, x: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | float, np.ndarray | float]:
        """Return the phase at points, cycles, and how it rises along x and y: the frequencies."""
        raise NotImplementedError

    def seen(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray | float:
        """Return how much of the wave there is at points."""
        return 1.0

    def share(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return 0.5 + 0.5 cos of the phase, over what the spline keeps of it."""
        cycles, *frequencies = self.turns(x, y)
        # Finer ones are not drawn, or lie beyond the sensor.
        across, down = (np.clip(step * f, -1 / LEAST_PERIOD, 1 / LEAST_PERIOD) for f in frequencies)
        kept = spline_response(across) * spline_response(down)
        return 0.5 + 0.5 * self.seen(x, y, step) * np.cos(2 * np.pi * cycles) / kept


class Sinusoid(Wave):
    """A wave: `period` along its normal, which points at `angle_deg`; its phase in the middle."""

    period: Size
    angle_deg: Angle = 0.0
    phase_deg: Angle = 0.0

    def turns(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, float, float]:
        """Return those along the normal."""
        angle = math.radians(self.angle_deg)
        across, down = math.cos(angle) / self.period, math.sin(angle) / self.period
        return x * across + y * down + self.phase_deg / 360, across, down

    def least_period(self, half_w: float, half_h: float) -> float:
        """Return its period."""
        return self.period


class Sweep(Wave):
    """A wave whose frequency rises exponentially from left to right: `periods` at both ends."""

    periods: tuple[Size, Size]
    width: Size

    def turns(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the integral of the frequency; beyond both ends it goes on at theirs."""
        low, high = (1 / period for period in self.periods)
        place = np.clip(x / self.width + 0.5, 0, 1)
        ratio = math.log(high / low)
        across = low * np.exp(place * ratio)
        cycles = self.width * low * (np.expm1(place * ratio) / ratio if ratio else place)
        beyond = x - np.clip(x, -self.width / 2, self.width / 2)
        return cycles + beyond * across, across, 0.0

    def least_period(self, half_w: float, half_h: float) -> float:
        """Return the shorter one."""
        return min(self.periods)


class ZonePlate(Wave):
    """Rings whose frequency rises with the radius: of `period` at `radius`."""

    period: Size
    radius: Size

    def turns(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return r^2 / (2 radius period)."""
        area = self.radius * self.period
        return (x**2 + y**2) / (2 * area), x / area, y / area

    def seen(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return 1, fading within two of the last rings; 0 beyond the radius."""
        rim = np.clip((self.radius - np.hypot(x, y)) / (2 * self.period), 0, 1)
        return np.sin(np.pi / 2 * rim) ** 2

    def least_period(self, half_w: float, half_h: float) -> float:
        """Return the period at the radius, or as far as the field goes."""
        seen = min(self.radius, math.hypot(half_w, half_h))
        return self.period * self.radius / seen


class SineStar(Wave):
    """A Siemens star of so many sinusoidal cycles, open within where they are too fine."""

    cycles: Annotated[int, Field(ge=2, le=720, strict=True)]
    diameter: Size
    inner_diameter: Size

    def turns(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return so many of the azimuth."""
        turn = self.cycles / (2 * np.pi)
        each = turn / np.maximum(x**2 + y**2, TINY)
        return turn * np.arctan2(y, x), -y * each, x * each

    def seen(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return 1 between both radii; both rims fade over 4 samples, as they are drawn."""
        radius = np.hypot(x, y)
        inner, outer = self.inner_diameter / 2, self.diameter / 2
        return np.clip((radius - inner) / (4 * step), 0, 1) * np.clip(
            (outer - radius) / (4 * step), 0, 1
        )

    def least_period(self, half_w: float, half_h: float) -> float:
        """Return the inner rim's."""
        return math.pi * self.inner_diameter / self.cycles


class DeadLeaves(Pattern):
    """Discs of random grey, one over another, radii with a density of r^-3 (Lee et al. 2001)."""

    radii: tuple[Size, Size]
    seed: Annotated[int, Field(ge=0, le=2**32 - 1, strict=True)] = 1

    def drawn(
        self, fills: Sequence[Fill], materials: Sequence[int], scale: float, frame: Frame
    ) -> Drawn:
        """Return it, front to back, until 1e-3 of the picture is left, which is grey."""
        if self.radii[0] >= self.radii[1]:
            raise ValueError("radii: the second is not above the first")
        self._leaves.clear()
        return super().drawn(fills, materials, scale, frame)

    _leaves: dict = {}  # noqa: RUF012 - pydantic makes a private one for each model

    def share(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return the leaves' greys in a band of the picture."""
        x, y = x.ravel(), y.ravel()
        places, radii, greys = self._made(float(x[-1]))
        open_, out = np.ones((y.size, x.size)), np.zeros((y.size, x.size))
        reach = radii + step
        near = (places[:, 1] + reach > y[0]) & (places[:, 1] - reach < y[-1])
        for (cx, cy), radius, grey in zip(places[near], radii[near], greys[near], strict=True):
            low, high = np.searchsorted(x, (cx - radius - step, cx + radius + step))
            top, bottom = np.searchsorted(y, (cy - radius - step, cy + radius + step))
            part = np.s_[top:bottom, low:high]
            off = np.hypot(x[None, low:high] - cx, y[top:bottom, None] - cy)
            covered = np.clip(0.5 + (radius - off) / step, 0, 1) * open_[part]
            out[part] += grey * covered
            open_[part] -= covered
        return out + 0.5 * open_

    def _made(self, half_w: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return places (N, 2), radii (N,) and greys (N,) of the leaves, the front one first."""
        if "made" not in self._leaves:
            rng = np.random.default_rng(self.seed)
            low, high = self.radii
            # In a square as wide as the field is, whose corners lie in it.
            side = 2 * (half_w + high)
            # Mean area of a leaf; so many leave exp(-7) = 1e-3 of the field open.
            area = 2 * np.pi * math.log(high / low) / (low**-2 - high**-2)
            count = min(int(7 * side**2 / area), LAYERS)
            places = side * (rng.random((count, 2)) - 0.5)
            # Density r^-3 between both: its integral turned around.
            radii = (low**-2 - rng.random(count) * (low**-2 - high**-2)) ** -0.5
            self._leaves["made"] = places, radii, rng.random(count)
        return self._leaves["made"]


class Points(Pattern):
    """Points of light on the dark fill, `pitch` apart; each is one sample of the bright fill."""

    count: tuple[Count, Count]
    pitch: tuple[Size, Size]

    def share(self, x: np.ndarray, y: np.ndarray, step: float) -> np.ndarray:
        """Return 1 at the sample that holds a point."""
        lit = []
        for line, count, pitch in zip((x.ravel(), y.ravel()), self.count, self.pitch, strict=True):
            number = line / pitch + (count - 1) / 2
            nearest = np.clip(np.round(number), 0, count - 1)
            # Half open: of two samples as near to a point one has it.
            off = (number - nearest) * pitch / step
            lit.append((off > -0.5 + 1e-6) & (off <= 0.5 + 1e-6))
        return (lit[1][:, None] & lit[0]).astype(np.float64)


PATTERNS: dict[str, type[Pattern]] = {
    "sinusoid": Sinusoid,
    "sweep": Sweep,
    "zone-plate": ZonePlate,
    "sine-star": SineStar,
    "dead-leaves": DeadLeaves,
    "points": Points,
}
