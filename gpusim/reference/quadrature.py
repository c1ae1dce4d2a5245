"""Where the exact model sums: zones of cells around a pixel, and its PSF through the aperture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import correlate1d, map_coordinates, spline_filter

Taps = list[np.ndarray]

BLOCK = 8  # cells on a side of the blocks in which outlines are sought


class Zone:
    """One ring of the PSF, on a square lattice of its own.

    The PSF is cut into rings by windows that fall smoothly from one to zero, so that no sum ends
    anywhere. A ring is known at the middles of the cells; between them it is the spline through
    these. The pixel's aperture is made of rectangles along the lattice, so the ring through
    each, and its integrals over cells, are sums along one axis and then the other.

    Parameters
    ----------
    step_um : float
        Side of a cell.
    split : int
        Squares along a cell into which it is cut where an outline crosses it.
    degree : int
        Degree of the spline.
    rises, falls : (float, float)
        Distances from the middle between which the ring's window rises from 0 to 1, and falls
        from 1 to 0.
    boxes : sequence of (x0, x1, y0, y1, response)
        Ends of the aperture's rectangles, um from the pixel's middle, and what they count for.
    change : bool
        Whether its rings are the PSF's rates of change with the source's x and y, in place of the
        PSF itself.

    Attributes
    ----------
    line : ndarray (n,)
        Middles of the cells along an axis, um.
    t : ndarray (P, 2)
        Points where the ring must be known.
    cells : ndarray (B, BLOCK, BLOCK, 2)
        Middles of the cells that the ring reaches through the aperture, by block.
    """

    def __init__(
        self,
        step_um: float,
        split: int,
        degree: int,
        *,
        rises: tuple[float, float],
        falls: tuple[float, float],
        boxes: Sequence[tuple[float, float, float, float, float]],
        change: bool = False,
    ) -> None:
        self.step_um, self.split, self.degree = step_um, split, degree
        self.reach_um, self.change = falls[1], change
        edge = max(abs(end) for *ends, _ in boxes for end in ends)
        half = int(np.ceil((falls[1] + edge) / step_um)) + 1
        half = -(-2 * half // BLOCK) * BLOCK // 2
        self.line = (np.arange(-half, half) + 0.5) * step_um
        n = 2 * half
        t = np.stack(np.meshgrid(self.line, self.line), axis=-1)
        distance = np.hypot(t[..., 0], t[..., 1])
        window = (1 - _fall(distance, *rises)) * _fall(distance, *falls)
        self.used = np.flatnonzero(window)
        self.window = window.flat[self.used]
        self.t = t.reshape(-1, 2)[self.used]
        self.through = _all_taps(boxes, step_um, degree, False)
        self.over_cells = _all_taps(boxes, step_um, degree, True)
        # Blocks of cells that the ring reaches through the aperture.
        margin = edge * np.sqrt(2) + step_um
        reached = (distance < falls[1] + margin) & (distance > rises[0] - margin)
        number = np.arange(n * n).reshape(n // BLOCK, BLOCK, n // BLOCK, BLOCK).swapaxes(1, 2)
        number = number.reshape(-1, BLOCK, BLOCK)
        self.number = number[reached.flat[number].any(axis=(1, 2))]
        self.cells = t.reshape(-1, 2)[self.number]
        self.reached = reached.flat[self.number]

    def ring(self, spread: np.ndarray) -> np.ndarray:
        """Return the ring (n, n) of a PSF that is known at the points `t`, as a spline."""
        ring = np.zeros(len(self.line) ** 2)
        ring[self.used] = spread * self.window
        return spline_filter(ring.reshape(len(self.line), -1), order=self.degree)

    def in_cells(self, rings: list[np.ndarray]) -> np.ndarray:
        """Return the integrals over the cells of the ring through the aperture, by block.

        `rings`: the ring, or its two rates of change.
        """
        return self._aperture(rings, self.over_cells).flat[self.number]

    def in_middles(self, rings: list[np.ndarray]) -> np.ndarray:
        """Return the ring through the aperture at the middles of the cells, by block."""
        return self._aperture(rings, self.through).flat[self.number]

    def at(self, rings: list[np.ndarray], t: np.ndarray) -> np.ndarray:
        """Return the ring through the aperture at points (P, 2)."""
        smooth = spline_filter(self._aperture(rings, self.through), order=self.degree)
        x, y = ((t - self.line[0]) / self.step_um).T
        return map_coordinates(smooth, [y, x], order=self.degree, prefilter=False)

    def _aperture(self, rings: list[np.ndarray], taps: list[tuple[Taps, Taps]]) -> np.ndarray:
        """Return a ring through the pixel's aperture, of the source that belongs to each point.

        Light that lands p from the pixel's centre, t + p from its chief ray, comes from x - t. The
        ring holds there the PSF of x - t - p; its rates of change lead back.
        """
        powers = ((0, 1), (1, 0)) if self.change else ((0, 0),)
        total = 0.0
        for in_y, in_x in taps:
            for ring, (down, across) in zip(rings, powers, strict=True):
                one = correlate1d(ring, in_y[down], axis=0, mode="constant")
                total = total + correlate1d(one, in_x[across], axis=1, mode="constant")
        return total


def _all_taps(
    boxes: Sequence[tuple[float, float, float, float, float]],
    step_um: float,
    degree: int,
    over_cells: bool,
) -> list[tuple[Taps, Taps]]:
    """Return the taps of each rectangle, down and across, for the powers 0 and 1."""
    found = []
    for x0, x1, y0, y1, response in boxes:
        down, across = (
            [
                _taps(low / step_um, high / step_um, power, degree, over_cells)
                * step_um ** (power + 1 + over_cells)
                for power in (0, 1)
            ]
            for low, high in ((y0, y1), (x0, x1))
        )
        found.append(([response * one for one in down], across))
    return found


def _taps(low: float, high: float, power: int, degree: int, over_cells: bool) -> np.ndarray:
    """Return what the B-splines around a sample give to an aperture there, in samples.

    The integral over p, from low to high, of p^power times the B-spline at p or, over cells, times
    its integral over the cell about p.
    """
    width = high - low
    ends = (degree + 1) / 2
    reach = int(np.ceil(max(abs(low), abs(high)) + 0.5 + ends))
    spline = BSpline.basis_element(np.arange(-ends, ends + 1))
    integral = spline.antiderivative()
    # Gauss and Legendre's four points on short pieces: a derivative of the spline jumps, so the
    # sum errs by 1/64^4 of little, for apertures up to some thirty cells wide.
    nodes, weights = np.polynomial.legendre.leggauss(4)
    p = ((nodes + 1) / 2 + np.arange(64)[:, None]).ravel() / 64 * width + low
    share = np.tile(weights / 128 * width, 64) * p**power
    at = p[:, None] - np.arange(-reach, reach + 1)
    if over_cells:
        values = integral(np.clip(at + 0.5, -ends, ends)) - integral(np.clip(at - 0.5, -ends, ends))
    else:
        values = np.where(np.abs(at) < ends, spline(np.clip(at, -ends, ends)), 0.0)
    return share @ values


def _fall(distance: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return a raised cosine from 1 at `start` to 0 at `end`."""
    share = np.clip((distance - start) / max(end - start, 1e-9), 0, 1)
    return 0.5 * (1 + np.cos(np.pi * share))
