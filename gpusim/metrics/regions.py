"""Slanted edges of a picture, found: regions that `gpusim.metrics.sfr` can measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, gaussian_filter, label

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane
from gpusim.metrics.sfr import Sfr, measure_sfr

SMOOTH_PX = 1.5  # before the gradient is taken
STRONG = 0.15  # of the strongest gradient: fainter ones are no edges of a chart
SLANTS_DEG = (1.5, 43.5)  # from rows or columns
LONG_PX = 24  # of an edge that is measured
STRAIGHT_PX = 1.0  # RMS of its ridge about a line
MIDDLE = 0.8  # of its length: at its ends other edges meet it
MARGINS_PX = (40, 28, 20, 14)  # beside it, the widest that holds no other edge
FLAT = 0.06  # of the step: how far either side may rise or fall
MOST = 40  # edges, the longest first


@dataclass(frozen=True)
class Region:
    """A rectangle (x, y, width, height) of pixels, and what its edge says in the plane searched."""

    box: tuple[int, int, int, int]
    found: Sfr


def find_regions(plane: Plane, progress: Callable[[int, int], None] | None = None) -> list[Region]:
    """Return regions with a slanted edge, those of the longest edges first.

    Parameters
    ----------
    plane : Plane
        With a filter array, the plane of the most frequent filter, filled in between its
        photosites.
    progress : callable, optional
        Called with (done, total) ridges.
    """
    values = filled(plane)
    smooth = gaussian_filter(values, SMOOTH_PX)
    down, across = np.gradient(smooth)
    size = np.hypot(down, across)
    strong = size > STRONG * np.quantile(size, 0.9995)
    ridges = []
    # An edge nearer to the vertical has its gradient nearer to the horizontal.
    steep = np.abs(across) > np.abs(down)
    for turned, own, weight in ((False, strong & steep, size), (True, (strong & ~steep).T, size.T)):
        marked, _ = label(own, np.ones((3, 3)))
        for number, box in enumerate(find_objects(marked), start=1):
            if box[0].stop - box[0].start < LONG_PX:
                continue
            ridge = _ridge(np.where(marked[box] == number, weight[box], 0.0))
            if ridge is not None:
                first, last, line = ridge
                ends = sorted(line(at) + box[1].start for at in (first, last))
                ridges.append(((first + box[0].start, last + box[0].start), ends, turned))
    ridges.sort(key=lambda one: one[0][0] - one[0][1])
    found: list[Region] = []
    for number, ridge in enumerate(ridges, start=1):
        region = _region(plane, *ridge)
        if region is not None:
            found.append(region)
        if progress is not None:
            progress(number, len(ridges))
        if len(found) == MOST:  # a measurement takes half a second: shorter ones need none
            break
    return found


def filled(plane: Plane) -> np.ndarray:
    """Return the values with other photosites replaced by the mean of their neighbours."""
    values = np.nan_to_num(np.asarray(plane.values, np.float64))
    if plane.sites is None:
        return values
    shape = values.shape
    tiles = [-(-n // p) for n, p in zip(shape, plane.sites.shape, strict=True)]
    own = np.tile(plane.sites, tiles)[: shape[0], : shape[1]].astype(np.float64)
    total, count = (gaussian_filter(one, 1.0) for one in (values * own, own))
    return total / np.maximum(count, 1e-6)


def _ridge(weight: np.ndarray) -> tuple[float, float, np.polynomial.Polynomial] | None:
    """Return the first and last row of the middle of a straight ridge, and its line; or None."""
    total = weight.sum(axis=1)
    rows = np.flatnonzero(total > 0)
    if rows.size < LONG_PX:
        return None
    cut = round((1 - MIDDLE) / 2 * (rows[-1] - rows[0]))
    rows = rows[(rows >= rows[0] + cut) & (rows <= rows[-1] - cut)]
    place = weight[rows] @ np.arange(weight.shape[1]) / total[rows]
    line = np.polynomial.Polynomial.fit(rows, place, 1)
    angle = np.degrees(np.arctan(abs(line.deriv()(0.0))))
    straight = np.sqrt(np.mean((place - line(rows)) ** 2)) < STRAIGHT_PX
    if not (straight and SLANTS_DEG[0] <= angle <= SLANTS_DEG[1]):
        return None
    return float(rows[0]), float(rows[-1]), line


def _region(
    plane: Plane, rows: tuple[float, float], cols: list[float], turned: bool
) -> Region | None:
    """Return the widest region about an edge that holds it alone; None where none does."""
    shape = plane.values.shape[::-1] if turned else plane.values.shape
    top, height = int(rows[0]), int(rows[1] - rows[0]) + 1
    for margin in MARGINS_PX:
        left = max(int(cols[0]) - margin, 0)
        width = min(int(cols[1]) + margin, shape[1] - 1) - left + 1
        box = (top, left, height, width) if turned else (left, top, width, height)
        try:
            one = measure_sfr(plane.values, box, sites=plane.sites, clip=plane.clip)
        except UserError:
            continue
        outer = np.abs(one.distance_px) > max(0.5 * one.distance_px[-1], one.rise_px)
        away = np.abs(one.esf[outer] - (one.distance_px[outer] > 0))
        if np.quantile(away, 0.95) < FLAT + 3 * one.noise / np.sqrt(height):
            return Region(box, one)
    return None
