"""The exact model of a bank's core: the continuous chain to electrons/s, by pixel, in float64.

    N(x) = sum over scene spectra m of integral dp integral ds H_cm(x + p - s; s) a_m(s)

with p over the pixel's aperture, a_m(s) one where spectrum m lies and zero elsewhere (charts, with
exact outlines) or its coefficient (rasters), and

    H_cm(t; s) = sum_k sum_l R[c, m, l, k] K(s, l) h_l(t - (x_c(s, k) - x_ref(s)); s),

the PSF of the bank interpolated by splines in wavelength about its chief ray, by cubics in image
height, and *rotated* to the azimuth of each source point; of a lens without an axis it is bicubic
between the fields of a grid, and not rotated (`gpusim.reference.point_spread`). No sim grid, no PSF
nodes, no reduced basis, no transform of the image: nothing that the engine chooses.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from gpusim.reference.b_splines import values
from gpusim.reference.fields import Grid, Heights, lateral_um
from gpusim.reference.landing import Landings
from gpusim.reference.outlines import Outlines
from gpusim.reference.pixel_aperture import Box, boxes_of, points_in, side_um_of
from gpusim.reference.point_spread import spreads_of
from gpusim.reference.quadrature import Zone

# Zones of the sum over t: distances from the pixel, um, between which the PSF's inner and middle
# parts fall, and cells along one sample of the bank. In the inner part lie nearly all of its energy
# and detail. Farther out there are rings still, hardly wider than two samples: where a pixel is
# dark and all of its light comes from there, steps of two samples would miss 1e-4 of it at f/2.8.
# Beyond the middle part they miss 2e-8 RMS of pixels beside edges, a fiftieth as bright as the
# white (the lens of `validate kodak`, f/2.3), and 1e-6 of those of `demo`.
FALLS_UM = ((6.0, 10.0), (30.0, 40.0))
CELLS = (2, 1, 0.5)
SPLITS = (8, 2, 4)  # squares along a cell of each that an outline cuts
# Degrees of the splines between the bank's samples, and between the cells. A PSF at f/2.8 has
# detail of 0.4 cycles a sample. Cubic splines err there by a tenth: 4e-4 of the light in a dark dot
# of 3 pixels.
DEGREES = (5, 3, 3)
# Half an aperture away the PSF is another by some 1e-4, at edges as much of the signal: of that
# steps of a sample are enough, and beyond some um it is below 1e-6.
CHANGE_FALLS_UM, CHANGE_SPLIT, CHANGE_DEGREE = (3.0, 6.0), 2, 3
FINE_PITCH_UM = 0.5  # of banks; of coarser ones the zones are wider, by as much
MARGIN_UM = 4.0  # around the bank's PSFs, at least: as far as lateral colour moves them
# Nodes across an aperture, and across a square as large; and samples of the bank between two nodes
# next to a highlight: the defocused PSFs of an f/2 lens have fringes 1 um apart, and four nodes
# across pixels of 4 um were 3 % off there.
HIGHLIGHT_ORDER, NODE_SAMPLES = 4, 2
# The same across squares farther than so many um, of a bank with samples of FINE_PITCH_UM: what the
# aperture has averaged is smooth. Four nodes across it, too, were 3 % off behind an f/1.9 lens.
FAR_ORDER, FAR_UM = 2, 12.0


class ExactCore:
    """Exact model of one camera and scene; `gpusim.reference.wide` has that of the halo's levels.

    Parameters
    ----------
    bank : gpusim.psf.bank.Bank or gpusim.psf.plane_bank.PlaneBank
    sensor : gpusim.sensor.sensor.Sensor
    spectra : ndarray (M, K)
        Spectral radiance of each scene spectrum, W m^-2 sr^-1 nm^-1.
    wavelengths_nm : ndarray (K,)
        Wavelengths of the spectra and of the sensor's quantum efficiency.
    fields : Heights or Grid, optional
        In place of the bank's own.
    less : (bank, Heights or Grid), optional
        A bank of the same pitch and size, and its fields: what the first one brings more than it.
    landings : Landings, optional
        Those of another model with the same map.
    """

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
        self.bank = bank
        self.sensor = sensor
        self.fields = fields or (Grid(bank) if hasattr(bank, "field_x_deg") else Heights(bank))
        self.landings = landings or Landings(self.fields)
        self.spreads = spreads_of(sensor, spectra, wavelengths_nm, (bank, self.fields), less)
        self.spread = self.spreads[0][1]
        of_all = [self.fields, *([] if less is None else [less[1]])]
        self.margin_um = max(MARGIN_UM, *(lateral_um(one) for one in of_all))
        self.side_um = side_um_of(sensor)
        self.boxes = boxes_of(sensor)
        self.half_um = np.abs(np.array(self.boxes)[:, :4]).reshape(-1, 2, 2).max(axis=(0, 2))
        # Spectra that are multiples of one share its kernels: that spectrum, and the factor.
        self.alike: list[tuple[int, float]] = []
        for number, spectrum in enumerate(spectra):
            for other in range(number):
                factor = spectrum.max() / spectra[other].max() if spectra[other].any() else 0.0
                if np.allclose(spectrum, factor * spectra[other], rtol=1e-12, atol=0):
                    self.alike.append((other, factor))
                    break
            else:
                self.alike.append((number, 1.0))
        self.zones = self._zones(1)
        self.outlines: Outlines | None = None

    def _zones(self, divide: int, widest_um: float = math.inf) -> list[Zone]:
        """Return that of the change and the zones outwards, of cells divided so often each way.

        None of them is wider than `widest_um`.
        """
        reach = self.bank.psf.shape[-1] * self.bank.pitch_um / 2 + self.margin_um
        parts = tuple(zip(CELLS, SPLITS, DEGREES, (*FALLS_UM, None), strict=False))
        given = {"parts": parts, "divide": divide, "widest_um": widest_um}
        return _zones(self.bank.pitch_um, reach, tuple(self.boxes), **given)

    def _inside_um(self, centre: np.ndarray) -> float:
        """Return how far within the image circle's rim a pixel lies; beyond it, negative."""
        return float(self.fields.circle - np.hypot(*(centre - self.fields.centre)))

    def _reach_um(self) -> float:
        """Return how far light comes to a pixel, and more: to the corners of the outer zone."""
        return float(np.sqrt(2) * (self.zones[-1].line[-1] + self.zones[-1].step_um))

    def _lit(self, centre: np.ndarray, t: np.ndarray, step_um: float) -> np.ndarray | float:
        """Return how much of steps of the radius, at t (..., 2) off a pixel, the rim leaves.

        Steps, not points, for sums over cells would else err by half a cell's light at the rim.
        """
        if self._inside_um(centre) > self._reach_um():
            return 1.0
        radius = np.hypot(*np.moveaxis(centre - t - self.fields.centre, -1, 0))
        return np.clip(0.5 + (self.fields.circle - radius) / step_um, 0, 1)

    def chart(self, chart: Any, pixels: np.ndarray) -> np.ndarray:
        """Return the true electrons/s of pixels that look at a chart.

        Parameters
        ----------
        chart : gpusim.scene.chart.Chart
            Placed: in um on the ideal plane.
        pixels : ndarray (P, 2) of int
            Row and column.

        Returns
        -------
        ndarray (P,)
        """
        outlines = self.outlines
        if outlines is None or outlines.chart is not chart:
            outlines = self.outlines = Outlines(chart, self.fields, self.alike)
        out = np.zeros(len(pixels))
        for number, (row, col) in enumerate(pixels):
            centre, channel = self._position(row, col), self._channel(row, col)
            if self._inside_um(centre) < -self._reach_um():
                continue
            for zone in self.zones:
                whole, cut = outlines.shares(zone, centre)
                spectra = sorted(whole.keys() | cut.keys())
                all_rings = self._rings(zone, channel, spectra, centre)
                of_cells = self._lit(centre, zone.cells, zone.step_um)
                for spectrum, rings in zip(spectra, all_rings, strict=True):
                    if spectrum in whole:
                        out[number] += np.sum(zone.in_cells(rings) * whole[spectrum] * of_cells)
                    if spectrum in cut:
                        places, areas = cut[spectrum]
                        lit = self._lit(centre, places, zone.step_um / zone.split)
                        out[number] += np.sum(zone.at(rings, places) * areas * lit)
        return out

    def _rings(
        self, zone: Zone, channel: int, spectra: Sequence[int], centre: np.ndarray
    ) -> list[list[np.ndarray]]:
        """Return of each spectrum a ring around a pixel, or how it changes with the source."""
        source = centre - zone.t

        def around(source: np.ndarray) -> np.ndarray:
            return sum(
                sign * spread.around(zone, channel, spectra, source)
                for sign, spread in self.spreads
            )

        here = around(source)
        found = [here]
        if zone.change:
            found = [(around(source + way) - here) / way.sum() for way in np.eye(2) * self.half_um]
        return [[zone.ring(one) for one in of_spectrum] for of_spectrum in zip(*found, strict=True)]

    def raster(self, raster: Any, pixels: np.ndarray) -> np.ndarray:
        """Return the true electrons/s of pixels that look at a raster.

        Parameters
        ----------
        raster : gpusim.scene.raster.PlacedRaster
            Its cubic-spline coefficients define the continuous radiance.
        pixels : ndarray (P, 2) of int

        Returns
        -------
        ndarray (P,)
        """
        rows, cols = raster.planes.shape[1:]
        planes = range(len(raster.planes))
        most = np.array([cols - 1, rows - 1])
        # No cell is wider than a sample; at the border, where the radiance goes on as it is, it has
        # a bend, and half of that is wanted.
        sample_um = raster.pitch_um
        divide = math.ceil(self.bank.pitch_um / sample_um)
        out = np.zeros(len(pixels))
        for number, (row, col) in enumerate(pixels):
            centre, channel = self._position(row, col), self._channel(row, col)
            if self._inside_um(centre) < -self._reach_um():
                continue
            zones = self._zones(divide, sample_um)
            places = [self._samples(raster, centre - zone.cells) for zone in zones]
            if (places[-1] < 0).any() or (places[-1] > most).any():
                zones = self._zones(2 * divide, sample_um / 2)
                places = [self._samples(raster, centre - zone.cells) for zone in zones]
            places = [np.clip(at, 0, most)[..., ::-1] for at in places]  # y before x
            ends = np.array([[at.min(axis=(0, 1, 2)), at.max(axis=(0, 1, 2))] for at in places])
            first = np.maximum(ends.min(axis=(0, 1)).astype(int) - 1, 0)
            last = np.minimum(ends.max(axis=(0, 1)).astype(int) + 3, [rows, cols])
            splines = raster.spline_in(*(range(*pair) for pair in zip(first, last, strict=True)))
            for zone, at in zip(zones, places, strict=True):
                y, x = np.moveaxis(at - first, -1, 0)
                areas = zone.step_um**2 * self._lit(centre, zone.cells, zone.step_um)
                all_rings = self._rings(zone, channel, planes, centre)
                all_radiance = np.moveaxis(values(splines, y, x), -1, 0)
                for radiance, rings in zip(all_radiance, all_rings, strict=True):
                    # Smooth times smooth: the sum over middles is the integral.
                    out[number] += np.sum(zone.in_middles(rings) * radiance * areas)
        return out + self.highlights(raster.highlights, pixels)

    def _samples(self, raster: Any, real: np.ndarray) -> np.ndarray:
        """Return where real points (..., 2) lie on a raster, x and y in samples."""
        corner = np.array([raster.x0_um, raster.y0_um])
        return (self.fields.ideal(real) - corner) / raster.pitch_um - 0.5

    def highlights(self, highlights: Any, pixels: np.ndarray) -> np.ndarray:
        """Return the true electrons/s of pixels by a photograph's highlights alone.

        Each pixel aperture sees each square through the spline of each wavelength's PSF, integrated
        over both by Gauss-Legendre quadrature. A spline swings below zero where the PSF is cut off;
        what no PSF does is left out: no highlight takes light away.

        Parameters
        ----------
        highlights : gpusim.scene.highlights.Highlights
        pixels : ndarray (P, 2) of int

        Returns
        -------
        ndarray (P,)
        """
        out = np.zeros(len(pixels))
        if not len(highlights.centre_um):
            return out
        fine = math.ceil(self.side_um / (NODE_SAMPLES * self.bank.pitch_um))
        order = max(HIGHLIGHT_ORDER, fine)
        squares = [self._squares(highlights, nodes) for nodes in (order, FAR_ORDER)]
        seen, of_seen = points_in(self.boxes, self.side_um, order)
        middles = squares[0][0].mean(axis=1)
        far_um = highlights.size_um + FAR_UM * max(1.0, self.bank.pitch_um / FINE_PITCH_UM)
        # To the corners of the PSFs' window, and as far as lateral colour.
        reach = self.bank.psf.shape[-1] * self.bank.pitch_um / np.sqrt(2) + self.margin_um
        for number, (row, col) in enumerate(pixels):
            centre = self._position(row, col)
            far = np.hypot(*(middles - centre).T) > far_um
            for (sources, weights), chosen in zip(squares, (~far, far), strict=True):
                own = np.flatnonzero(chosen)
                at = sources[own] - centre
                near = np.hypot(at[..., 0], at[..., 1]) < reach + 2 * self.half_um.max()
                if not near.any():
                    continue
                owners, source, weight = own[np.nonzero(near)[0]], centre + at[near], weights[own]
                excess, channel = highlights.excess[owners], self._channel(row, col)
                t = (centre + seen)[:, None] - source
                for sign, spread in self.spreads:
                    light = of_seen @ spread.at(channel, excess, t, source)
                    each = np.bincount(owners, light * weight[near])
                    out[number] += sign * np.maximum(each, 0.0).sum() * self.side_um**2
        return out

    def _squares(self, highlights: Any, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points of squares on the real plane (N, I, 2), with their areas (N, I)."""
        line, share = np.polynomial.legendre.leggauss(order)
        # A square may be larger than the PSF: it has the nodes for each part.
        cuts = int(np.ceil(highlights.size_um / self.side_um))
        cell = highlights.size_um / cuts
        corner = (np.arange(cuts) - (cuts - 1) / 2) * cell
        nodes = (corner[:, None] + line / 2 * cell).ravel()
        return self.landings.of(highlights, nodes, np.tile(share / 2 * cell, cuts))

    def _position(self, row: int, col: int) -> np.ndarray:
        pitch = self.sensor.pixel_pitch_um
        return (
            np.array([col + 0.5 - self.sensor.cols / 2, row + 0.5 - self.sensor.rows / 2]) * pitch
        )

    def _channel(self, row: int, col: int) -> int:
        pattern = self.sensor.cfa.pattern
        name = pattern[row % len(pattern)][col % len(pattern[0])]
        return list(self.sensor.channels).index(name)


@lru_cache(maxsize=8)  # judging a bank makes a model for each of its heights
def _zones(
    pitch_um: float,
    reach_um: float,
    boxes: tuple[Box, ...],
    *,
    parts: tuple[tuple[float, int, int, tuple[float, float] | None], ...],
    divide: int,
    widest_um: float,
) -> list[Zone]:
    """Return the zones for PSFs of a pitch that reach so far: see `ExactCore._zones`.

    `parts`: cells along a sample, squares along a cell, degree, and where the zone falls.
    """
    wide = max(1.0, pitch_um / FINE_PITCH_UM)
    step, start, end = pitch_um / divide, *(wide * at for at in CHANGE_FALLS_UM)
    rises = (-1.0, 0.0)
    given = {"rises": rises, "falls": (start, end), "boxes": boxes, "change": True}
    zones = [Zone(step, CHANGE_SPLIT, CHANGE_DEGREE, **given)]
    for cells, split, degree, fall in parts:
        last = fall is None or 2 * wide * fall[1] >= reach_um
        falls = (reach_um, reach_um) if last else (wide * fall[0], wide * fall[1])
        side_um = step / cells if step / cells <= widest_um else step
        zones.append(Zone(side_um, split, degree, rises=rises, falls=falls, boxes=boxes))
        rises = falls
        if last:
            break
    return zones
