"""The exact model of the halo: light far from its chief ray, where PSFs are wide and smooth.

    N(x) = A sum over cells of H(x - s; s) mean of a over the cell, times the cell's area

with A the pixel's aperture and H of one level of a bank's halo, averaged over the aperture: beside
a lamp pixels of 7.8 um have 5 % less than in their middle, where the level of 2 um begins. H hardly
changes over a cell, so the sum converges with the square of its side; outlines of charts count by
points within the cells. For a photograph the cells hold sums of its samples, each an even square,
taken where the middle of their light is. Its highlights come one by one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from gpusim.reference.fields import Grid, Heights
from gpusim.reference.landing import Landings
from gpusim.reference.point_spread import spreads_of

# Side of a cell in samples of the level, and points along it: where the level holds little light,
# and where rays land in it. Against cells of two samples with 4 x 4 points the demonstration's 64
# probes change by 4e-5 of their signal, RMS, in 0.6 of the time.
SMOOTH, STRUCTURED = (3.0, 3), (1.0, 3)
LITTLE = 0.01  # of the light
# The same of photographs at most: in cells of three samples, lamps brought 1.7 % too much to a
# shadow 50 um off, of which the level's light is 4 %.
SAMPLED = 1.5
# Cells of so many samples of a photograph or more are taken where their light is.
FEW_SAMPLES = 2.0
BEYOND = 1e5  # samples that a photograph goes on beyond its border
# Charts of more primitives near a pixel are painted once, unless that takes too many points.
FEW, LARGEST = 8, 4e6


class Wide:
    """Exact model of one level of a halo: see ``gpusim.reference.exact_model.ExactCore``."""

    def __init__(
        self,
        bank: Any,
        sensor: Any,
        spectra: np.ndarray,
        wavelengths_nm: np.ndarray,
        *,
        fields: Heights | Grid | None = None,
        less: tuple[Any, Heights | Grid] | None = None,
        landings: Landings | None = None,
    ) -> None:
        self.bank, self.sensor = bank, sensor
        self.fields = fields or (Grid(bank) if hasattr(bank, "field_x_deg") else Heights(bank))
        self.landings = landings or Landings(self.fields)
        aperture_um = sensor.pixel_pitch_um * np.sqrt(sensor.fill_factor)
        given = sensor, spectra, wavelengths_nm, (bank, self.fields), less
        self.spreads = spreads_of(*given, aperture_um=aperture_um)
        self.count = len(spectra)
        share = float(bank.psf.sum(axis=(-2, -1), dtype=float).max())
        step, points = SMOOTH if share < LITTLE else STRUCTURED
        self.reach_um = bank.psf.shape[-1] / 2 * bank.pitch_um
        self.step_um, self.t = self._cells(step)
        inner = ((np.arange(points) + 0.5) / points - 0.5) * self.step_um
        self.inner = np.stack(np.meshgrid(inner, inner), axis=-1).reshape(-1, 2)
        self.point_um = self.step_um / points
        self.of_samples = self._cells(min(step, SAMPLED))
        self.summed: tuple[Any, np.ndarray] | None = None
        self.area_um2 = sensor.pixel_pitch_um**2 * sensor.fill_factor

    def _cells(self, step: float) -> tuple[float, np.ndarray]:
        """Return the side of cells of so many samples, um, and their middles about a pixel."""
        step_um = step * self.bank.pitch_um
        count = int(np.ceil(self.reach_um / step_um))
        line = (np.arange(-count, count) + 0.5) * step_um
        t = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
        return step_um, t[np.hypot(*t.T) < self.reach_um]

    def at(self, placed: Any, pixels: np.ndarray) -> np.ndarray:
        """Return the true electrons/s (P,) that the level brings to pixels (P, 2) of a scene."""
        out = np.zeros(len(pixels))
        pitch = self.sensor.pixel_pitch_um
        pattern = self.sensor.cfa.pattern
        is_chart = hasattr(placed, "primitives")
        step_um, around = (self.step_um, self.t) if is_chart else self.of_samples
        for number, (row, col) in enumerate(pixels):
            middle = np.array([col + 0.5 - self.sensor.cols / 2, row + 0.5 - self.sensor.rows / 2])
            source = middle * pitch - around
            lit = np.hypot(*(source - self.fields.centre).T) <= self.fields.circle
            if not lit.any():
                continue
            name = pattern[row % len(pattern)][col % len(pattern[0])]
            channel = list(self.sensor.channels).index(name)
            source = source[lit]
            if is_chart:
                shares = self._shares(placed, source)
            else:
                shares, source = self._samples(placed, source, step_um)
            given = channel, shares, middle * pitch - source, source
            light = sum(sign * spread.wide(*given).sum() for sign, spread in self.spreads)
            out[number] = light * step_um**2 * self.area_um2
            if not is_chart:
                out[number] += self._highlights(placed.highlights, middle * pitch, channel)
        return out

    def _shares(self, chart: Any, source: np.ndarray) -> np.ndarray:
        """Return the mean coefficient (P, M) of each spectrum in cells about points (P, 2)."""
        ideal = self.fields.ideal(source[:, None] + self.inner)
        cell = np.arange(len(source))[:, None] * self.count + self._materials(chart, ideal)
        found = np.bincount(cell.ravel(), minlength=len(source) * self.count)
        return found.reshape(len(source), self.count) / len(self.inner)

    def _samples(
        self, raster: Any, source: np.ndarray, step_um: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return mean coefficients (P, M) in cells about points (P, 2), and middles of their light.

        The map stretches a cell along x and y alone: along a row of cells there are no gaps.
        """
        half = step_um / 2
        corner = np.array([raster.x0_um, raster.y0_um])
        ends = [
            [
                (self.fields.ideal(source + way * half * unit)[:, axis] - corner[axis])
                / raster.pitch_um
                for way in (-1, 1)
            ]
            for axis, unit in enumerate(np.eye(2))
        ]
        (left, right), (top, bottom) = ends
        sums = self._sums(raster)
        rows, cols = sums.shape[1] - 3, sums.shape[2] - 3
        box = [
            [map_coordinates(one, [_edge(y, rows), _edge(x, cols)], order=1) for one in sums]
            for y in (top, bottom)
            for x in (left, right)
        ]
        inside = np.array(box[3]) - box[2] - box[1] + box[0]
        *light, along_x, along_y = inside
        means = np.stack(light, axis=1) / ((right - left) * (bottom - top))[:, None]
        if np.median(right - left) < FEW_SAMPLES:
            return means, source
        total = sum(light)
        moved = [
            # Beyond the raster there are no samples to say where the light is.
            np.where(
                (total > 0) & (low >= 0) & (high <= most),
                along / np.where(total > 0, total, 1.0) - (low + high) / 2,
                0.0,
            )
            / (high - low)
            for along, low, high, most in (
                (along_x, left, right, cols),
                (along_y, top, bottom, rows),
            )
        ]
        return means, source + step_um * np.clip(np.stack(moved, axis=1), -0.5, 0.5)

    def _sums(self, raster: Any) -> np.ndarray:
        """Return sums over a raster from its corner to each edge (M + 2, rows + 3, cols + 3).

        The sums are those of its coefficients, and of their total times x and y. Beyond its border
        the raster goes on as at the border, as far as BEYOND: see `_edge`.
        """
        if self.summed is None or self.summed[0] is not raster:
            planes = np.pad(raster.planes.astype(np.float64), ((0, 0), (1, 1), (1, 1)), "edge")
            total = planes.sum(axis=0)
            x, y = (np.arange(count) - 0.5 for count in total.shape[::-1])
            planes = np.concatenate([planes, [total * x, total * y[:, None]]])
            planes[:, [0, -1]] *= BEYOND
            planes[:, :, [0, -1]] *= BEYOND
            for axis in (1, 2):  # from the corner of the first sample: what lies beyond is large
                before, rest = np.split(planes, [1], axis)
                planes = np.concatenate([-before, 0 * before, rest.cumsum(axis)], axis)
            self.summed = raster, planes
        return self.summed[1]

    def _highlights(self, highlights: Any, middle: np.ndarray, channel: int) -> float:
        """Return the electrons/s that a photograph's highlights bring to a pixel, one by one."""
        if not len(highlights.centre_um):
            return 0.0
        # As many points as the level has samples there.
        count = int(np.ceil(highlights.size_um / self.bank.pitch_um))
        line = ((np.arange(count) + 0.5) / count - 0.5) * highlights.size_um
        shares = np.full(count, highlights.size_um / count)
        real, areas = self.landings.of(highlights, line, shares)
        near = np.hypot(*np.moveaxis(middle - real, -1, 0)) < self.reach_um
        if not near.any():
            return 0.0
        light = highlights.excess[np.nonzero(near)[0]] * areas[near][:, None]
        given = channel, light, middle - real[near], real[near]
        found = sum(sign * spread.at(*given).sum() for sign, spread in self.spreads)
        return float(found * self.area_um2)

    def _materials(self, chart: Any, ideal: np.ndarray) -> np.ndarray:
        """Return the material at each of the points (P, I, 2)."""
        low, high = ideal.min(axis=(0, 1)), ideal.max(axis=(0, 1))
        at, reach = _discs(chart)
        reached = np.abs(at - (low + high) / 2) < reach[:, None] + (high - low) / 2
        near = np.flatnonzero(reached.all(axis=1))
        if len(near) > FEW and (painted := _painted(chart, self.point_um)) is not None:
            first, materials = painted
            at = np.round((ideal - first) / self.point_um).astype(int)
            at = np.clip(at, 0, np.array(materials.shape[::-1]) - 1)
            return materials[at[..., 1], at[..., 0]]
        found = np.full(ideal.shape[:2], chart.background)
        for shape in (chart.primitives[number] for number in near):
            found[shape.distance(ideal[..., 0], ideal[..., 1]) <= 0] = shape.material
        return found


@lru_cache(maxsize=8)
def _discs(chart: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return centres (N, 2) and radii (N,) of circles around a chart's primitives."""
    at = np.array([(p.cx, p.cy) for p in chart.primitives]).reshape(-1, 2)
    return at, np.array([p.reach for p in chart.primitives])


@lru_cache(maxsize=8)
def _painted(chart: Any, point_um: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the first point (2,) of a grid over a chart's primitives, and its materials there.

    On its border lies the background, as beyond. None where that takes too many points.
    """
    at, reach = _discs(chart)
    reach = reach[:, None]
    low = (at - reach).min(axis=0, initial=0.0) - point_um
    high = (at + reach).max(axis=0, initial=0.0) + point_um
    cols, rows = np.ceil((high - low) / point_um).astype(int) + 2
    if float(cols) * float(rows) >= LARGEST:
        return None
    materials = np.full((rows, cols), chart.background)
    for shape, place, radius in zip(chart.primitives, at, reach, strict=True):
        (left, top), (right, bottom) = (
            np.round((place + way * radius - low) / point_um).astype(int) + way for way in (-1, 1)
        )
        x = low[0] + point_um * np.arange(max(left, 0), right + 1)
        y = low[1] + point_um * np.arange(max(top, 0), bottom + 1)[:, None]
        part = materials[max(top, 0) : bottom + 1, max(left, 0) : right + 1]
        x, y = x[: part.shape[1]], y[: part.shape[0]]
        part[shape.distance(x, y) <= 0] = shape.material
    materials[[0, -1]] = materials[:, [0, -1]] = chart.background
    return low, materials


def _edge(at: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers of edges of samples at places in samples from the first one's edge.

    Edge 1 is where the first of `count` samples begins; edge 0 lies BEYOND it.
    """
    inside = np.clip(at, 0, count)
    return 1 + inside + np.clip(at - inside, -BEYOND, BEYOND) / BEYOND
