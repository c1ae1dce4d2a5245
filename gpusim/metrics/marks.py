"""Marks of a chart: corners of a checkerboard and middles of dots, to hundredths of a pixel.

A corner of a checkerboard is the saddle of the picture there: where two edges cross, the picture is
the same when it is turned by half a turn, whatever blurs it, and so the saddle lies on the corner.
It is that of the quadratic function that fits the pixels best under a Gaussian weight about the
corner, sought until the weight and the saddle have the same middle. A filter array's photosites
enter at their own places.

A dot's place is the centroid of how far it departs from what surrounds it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import find_objects, gaussian_filter, label, maximum_filter
from scipy.spatial import cKDTree

from gpusim.metrics.picture import Plane
from gpusim.metrics.regions import filled

# Before the second derivatives are taken: the blur of a sharp camera and its pixels is 0.5 to 1 px,
# and at 1.5 noise of 2 % of the step makes no saddle of a fifth of a corner's.
SMOOTH_PX = 1.5
STRONG = 0.2  # of the strongest saddles: fainter ones are no corners
STRONGEST = 20  # saddles, whose median is the measure
RING_PX = 5.0  # on which a corner has four quarters, light and dark by turns
UNEVEN = 0.3  # of a corner's contrast: how far opposite quarters may differ
# Standard deviation of the weight: wider ones let the edges' bend move the corner (0.02 px at 1/8,
# under a distortion of 24 %), narrower ones the noise.
WINDOW_OF_PITCH = 1 / 10
WINDOWS_PX = (1.5, 5.0)
CUT = 4.0  # standard deviations, where the weight ends: at 3 its rim moves corners by 3e-4 px
ROUNDS = 30
STILL_PX = 1e-5  # a round that moves the corner less is the last
FARTHEST_PX = 2.0  # from where it was first seen
# How far a dot departs from its surroundings, over the picture's range. Dots are faint beside
# brighter things, such as the patches of a chart of many parts.
DEPTHS = (0.25, 0.12, 0.06)
LEAST_DOT_PX = 12  # pixels of a dot
FULLEST = 0.5  # of the distance of dots: their radius, at most
ROUND = 0.6  # least ratio of a dot's axes


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks of one channel.

    Attributes
    ----------
    x, y : ndarray (N,)
        Pixels from the upper left corner of the picture; the middle of its first pixel is at 0.5.
    width_px : ndarray (N,)
        Standard deviation of the weight under which a corner was found; zeros of dots.
    kind : str
        ``corners`` or ``dots``.
    """

    x: np.ndarray
    y: np.ndarray
    width_px: np.ndarray
    kind: str


def find_marks(plane: Plane) -> Marks:
    """Return the marks of a chart, corners or dots, of which there are more."""
    values = filled(plane)
    corners = _corners(plane, values)
    dots = _dots(values)
    return corners if len(corners.x) >= len(dots.x) else dots


def again(marks: Marks, plane: Plane) -> Marks:
    """Return the same marks in another channel, each sought from where it was; NaN where none is.

    Parameters
    ----------
    marks : Marks
    plane : Plane
    """
    if marks.kind == "corners":
        return _refined(plane, marks.x, marks.y, marks.width_px)
    own = _dots(filled(plane))
    if not own.x.size:
        nothing = np.full_like(marks.x, np.nan)
        return Marks(nothing, nothing, marks.width_px, marks.kind)
    far, at = cKDTree(np.stack([own.x, own.y], 1)).query(np.stack([marks.x, marks.y], 1))
    seen = far < FARTHEST_PX
    x, y = (np.where(seen, one[at], np.nan) for one in (own.x, own.y))
    return Marks(x, y, marks.width_px, marks.kind)


def _corners(plane: Plane, values: np.ndarray) -> Marks:
    """Return the corners of a checkerboard."""
    yy, xx, xy = (
        gaussian_filter(values, SMOOTH_PX, order=order) for order in ((2, 0), (0, 2), (1, 1))
    )
    saddle = xy**2 - xx * yy
    margin = int(RING_PX) + 1
    inner = np.s_[margin:-margin, margin:-margin]
    peak = np.zeros(saddle.shape, bool)
    peak[inner] = (saddle == maximum_filter(saddle, 2 * margin - 1))[inner]
    row, col = np.nonzero(peak & (saddle > 0))
    if not row.size:
        return _none("corners")
    height = saddle[row, col]
    keep = height > STRONG * np.median(np.sort(height)[-STRONGEST:])
    row, col = row[keep], col[keep]
    crossed = _crossed(gaussian_filter(values, 1.0), row, col)
    places = np.stack([col[crossed], row[crossed]], 1) + 0.5
    if len(places) < 3:
        return _none("corners")
    # At the picture's sides a corner has two neighbours at least.
    near = cKDTree(places).query(places, k=3)[0][:, -1]
    found = _refined(plane, *places.T, np.clip(WINDOW_OF_PITCH * near, *WINDOWS_PX))
    seen = np.isfinite(found.x)
    return Marks(found.x[seen], found.y[seen], found.width_px[seen], "corners")


def _crossed(values: np.ndarray, row: np.ndarray, col: np.ndarray) -> np.ndarray:
    """Return which places have four quarters about them, opposite ones alike."""
    turn = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    rows = np.rint(row[:, None] + RING_PX * np.sin(turn)).astype(int)
    cols = np.rint(col[:, None] + RING_PX * np.cos(turn)).astype(int)
    ring = values[rows, cols]
    swing = np.ptp(ring, axis=1)
    ring = ring - ring.mean(axis=1, keepdims=True)
    changes = np.count_nonzero(np.diff(np.sign(ring), axis=1, append=np.sign(ring[:, :1])), axis=1)
    opposite = np.abs(ring - np.roll(ring, 16, axis=1)).mean(axis=1)
    return (changes == 4) & (opposite < UNEVEN * swing)


def _refined(plane: Plane, x: np.ndarray, y: np.ndarray, width: np.ndarray) -> Marks:
    """Return the saddles near some places; not a number where there is none."""
    rows = [_saddle(plane, *one) for one in zip(x, y, width, strict=True)]
    found = np.array(rows, np.float64).reshape(-1, 2)
    return Marks(found[:, 0], found[:, 1], width, "corners")


def _saddle(plane: Plane, x: float, y: float, width: float) -> tuple[float, float]:
    """Return the saddle under a Gaussian weight: x, y, px."""
    nothing = np.nan, np.nan
    start, reach = (x, y), int(np.ceil(CUT * width)) + 1
    left, top = int(x) - reach, int(y) - reach
    right, bottom = left + 2 * reach + 1, top + 2 * reach + 1
    tall, wide = plane.values.shape
    if left < 0 or top < 0 or right > wide or bottom > tall:
        return nothing
    rows, cols = np.mgrid[top:bottom, left:right]
    value = plane.values[top:bottom, left:right].astype(np.float64)
    if not np.all(np.isfinite(value)):
        return nothing
    own = np.ones(value.shape, bool)
    if plane.sites is not None:
        own = plane.sites[rows % plane.sites.shape[0], cols % plane.sites.shape[1]]
    at_x, at_y, value = cols[own] + 0.5, rows[own] + 0.5, value[own]
    for _ in range(ROUNDS):
        u, v = at_x - x, at_y - y
        root = np.exp(-(u**2 + v**2) / (4 * width**2))
        design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], 1) * root[:, None]
        found, *_ = np.linalg.lstsq(design, value * root, rcond=None)
        bend = np.array([[2 * found[3], found[4]], [found[4], 2 * found[5]]])
        if not np.linalg.det(bend) < 0:
            return nothing
        step = -np.linalg.solve(bend, found[1:3])
        step *= min(1.0, 1.0 / max(np.hypot(*step), 1e-300))  # no farther than a pixel at once
        x, y = x + step[0], y + step[1]
        if np.hypot(x - start[0], y - start[1]) > FARTHEST_PX:
            return nothing
        if np.hypot(*step) < STILL_PX:
            break
    return x, y


def _dots(values: np.ndarray) -> Marks:
    """Return the dots, dark or light ones, of which there are more."""
    low, high = np.quantile(values, (0.02, 0.98))
    if not high > low:
        return _none("dots")
    # Light falls off towards the corners: the level between is that of the surroundings.
    local = gaussian_filter(values, max(values.shape) / 12)
    found = [
        _blobs(values, sign * (values - local) > depth * (high - low))
        for depth in DEPTHS
        for sign in (-1, 1)
    ]
    return max(found, key=lambda one: len(one.x))


def _blobs(values: np.ndarray, inside: np.ndarray) -> Marks:
    """Return centroids of round regions that lie apart."""
    marked, _ = label(inside, np.ones((3, 3)))
    found = []
    for number, box in enumerate(find_objects(marked), start=1):
        one = marked[box] == number
        area = np.count_nonzero(one)
        rows, cols = one.shape
        fills = area / (rows * cols)
        if area < LEAST_DOT_PX or min(rows, cols) < ROUND * max(rows, cols) or fills < 0.6:
            continue
        found.append((box, area))
    if len(found) < 4:
        return _none("dots")
    middles = np.array([[(s.start + s.stop) / 2 for s in box[::-1]] for box, _ in found])
    apart = cKDTree(middles).query(middles, k=2)[0][:, 1]
    # Beside the dots there may be letters and a frame.
    usual = np.median([area for _, area in found])
    rows = [
        _centroid(values, middle, np.sqrt(area / np.pi), far)
        for middle, far, (_, area) in zip(middles, apart, found, strict=True)
        if 0.4 * usual < area < 2.5 * usual and np.sqrt(area / np.pi) < FULLEST * far
    ]
    seen = np.array([row for row in rows if row is not None]).reshape(-1, 2)
    return Marks(seen[:, 0], seen[:, 1], np.zeros(len(seen)), "dots")


def _centroid(
    values: np.ndarray, middle: np.ndarray, radius: float, far: float
) -> tuple[float, float] | None:
    """Return the centroid of a dot's departure from its surroundings.

    The surroundings are a plane through the ring half way to the next dot. A centroid is that of
    the dot as the lens bends it, which is not the image of its middle: of dots 10 px wide under a
    distortion of 24 % by up to 0.03 px.
    """
    x, y = middle
    outer = min(max(radius + 3.0, 0.5 * (radius + far / 2) + 1), far - radius - 1)
    inner = outer - 1.5
    for _ in range(4):
        reach = int(np.ceil(outer)) + 1
        left, top = int(x) - reach, int(y) - reach
        right, bottom = left + 2 * reach + 1, top + 2 * reach + 1
        if left < 0 or top < 0 or right > values.shape[1] or bottom > values.shape[0]:
            return None
        v, u = np.mgrid[top:bottom, left:right] + 0.5
        u, v = u - x, v - y
        away = np.hypot(u, v)
        own = values[top:bottom, left:right]
        ring = (away > inner) & (away <= outer)
        level = np.stack([np.ones_like(u), u, v], -1)
        plane, *_ = np.linalg.lstsq(level[ring], own[ring], rcond=None)
        rest = own - level @ plane
        # The weight falls to zero within a pixel, so that no pixel enters at once.
        weight = np.clip(inner + 0.5 - away, 0, 1)
        total = np.sum(weight * rest)
        x, y = x + np.sum(weight * rest * u) / total, y + np.sum(weight * rest * v) / total
    return x, y


def _none(kind: str) -> Marks:
    return Marks(np.empty(0), np.empty(0), np.empty(0), kind)
