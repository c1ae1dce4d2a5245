"""Patches of a ColorChecker in a picture: found by their shapes, and named by their colours.

Patches are regions without edges, about square and of one size, in six columns and four rows. Which
way up the chart lies the colours say: the way is taken whose 24 colours a matrix of three by three
brings nearest to the chart's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion, find_objects, gaussian_filter, label

from gpusim.errors import UserError
from gpusim.metrics.lattice import count_marks
from gpusim.metrics.picture import Plane
from gpusim.metrics.regions import filled

COLUMNS, ROWS = 6, 4
SMOOTH_PX = 1.0
# Gradient above which an edge lies between patches, over the range of a channel, per px.
EDGE = 0.02
LEAST_PX = 8  # sides of a patch
SQUARE = 0.6  # least ratio of its sides, and least share of its box that it fills
ALIKE = 1.5  # how much larger or smaller than another a patch may be, in side
SEEN = 14  # of the 24 patches: black ones drown in the frame, neighbours run together
INNER = 0.5  # of a patch's side: the part that is measured


@dataclass(frozen=True, eq=False)
class Patches:
    """Where the 24 patches of a chart are, and what their channels say.

    Attributes
    ----------
    corners : ndarray (24, 4, 2)
        Corners of the measured part of each, x and y, px, in the chart's reading order.
    mean, noise : ndarray (24, channels)
        Mean and standard deviation of a pixel.
    clipped : ndarray (24,) of bool
        Some of its pixels are black or saturated in a channel.
    channels : tuple of str
    """

    corners: np.ndarray
    mean: np.ndarray
    noise: np.ndarray
    clipped: np.ndarray
    channels: tuple[str, ...]


def find_patches(
    planes: dict[str, Plane],
    misfit: Callable[[np.ndarray], float],
    given: np.ndarray | None = None,
) -> Patches:
    """Find the patches of a ColorChecker and measure them.

    Parameters
    ----------
    planes : dict of str to Plane
        Red, green and blue.
    misfit : callable
        Function of the 24 means, shape (24, channels): how badly they fit the chart's colours.
    given : ndarray (4, 2), optional
        Middles of the patches in the chart's corners, x and y, px: dark skin, bluish green, black,
        white, clockwise.

    Raises
    ------
    UserError
        There is no such chart, or it leaves the picture.
    """
    shape = next(iter(planes.values())).values.shape
    if given is not None:
        cells = np.array([[0, 0], [COLUMNS - 1, 0], [COLUMNS - 1, ROWS - 1], [0, ROWS - 1]], float)
        quads = _quads(_homography(cells, given), turned=False)
        if not _inside(quads, shape):
            raise _not_found("corners that leave the picture")
        return _measured(planes, quads)
    best: tuple[float, Patches] | None = None
    for matrix in _lattices(planes):
        for turned in (False, True):
            quads = _quads(matrix, turned)
            if not _inside(quads, shape):
                continue
            one = _measured(planes, quads)
            score = misfit(one.mean)
            if best is None or score < best[0]:
                best = score, one
    if best is None:
        raise _not_found("no lattice of six by four patches")
    return best[1]


def _lattices(planes: dict[str, Plane]) -> list[np.ndarray]:
    """Return homographies (3, 3) from cells, 0 to 5 and 0 to 3, of all places that are possible."""
    middles, sides = _regions(planes)
    found = []
    tried: set[frozenset[int]] = set()
    for side in sorted(sides, reverse=True):
        alike = np.flatnonzero((sides <= side) & (sides > side / ALIKE))
        if len(alike) < SEEN or frozenset(alike) in tried:
            continue
        tried.add(frozenset(alike))
        try:
            which, cell = count_marks(*middles[alike].T, SEEN, 3)
        except UserError:
            continue
        cell = cell - cell.min(axis=0)
        tall, places = cell[:, 0].max() < cell[:, 1].max(), middles[alike][which]
        spare = (ROWS, COLUMNS) if tall else (COLUMNS, ROWS)
        spare = np.array(spare) - 1 - cell.max(axis=0)
        if spare.min() < 0:
            continue
        for right in range(spare[0] + 1):
            for down in range(spare[1] + 1):
                moved = cell + np.array([right, down])
                # An upright chart is turned: its columns are the picture's rows.
                own = np.stack([moved[:, 1], ROWS - 1 - moved[:, 0]], 1) if tall else moved
                found.append(_homography(own.astype(float), places))
        break
    return found


def _regions(planes: dict[str, Plane]) -> tuple[np.ndarray, np.ndarray]:
    """Return middles (N, 2) and sides (N,) of regions without edges that are about square."""
    edge = 0.0
    for plane in planes.values():
        smooth = gaussian_filter(filled(plane), SMOOTH_PX)
        low, high = np.quantile(smooth, (0.01, 0.99))
        down, across = np.gradient(smooth)
        edge = np.maximum(edge, np.hypot(down, across) / max(high - low, 1e-30))
    # Dark patches on a dark frame have faint edges: the noise decides how faint ones are seen.
    limit = max(EDGE / 4, 4 * float(np.median(edge)))
    flat = binary_erosion(edge < min(limit, EDGE), iterations=1)
    marked, _ = label(flat)
    middles, sides = [], []
    for number, box in enumerate(find_objects(marked), start=1):
        one = marked[box] == number
        rows, cols = one.shape
        full = np.count_nonzero(one) / one.size
        if min(rows, cols) < max(LEAST_PX, SQUARE * max(rows, cols)) or full < SQUARE:
            continue
        at = np.argwhere(one).mean(axis=0)
        middles.append((box[1].start + at[1] + 0.5, box[0].start + at[0] + 0.5))
        sides.append(np.sqrt(np.count_nonzero(one)))
    return np.array(middles).reshape(-1, 2), np.array(sides)


def _homography(cells: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the matrix that takes cells to places, by direct linear transformation."""
    middle, scale = places.mean(axis=0), places.std()
    u = (places - middle) / scale
    one, none = np.ones(len(cells)), np.zeros((len(cells), 3))
    at = np.column_stack([cells, one])
    rows = np.concatenate(
        [
            np.column_stack([at, none, -u[:, :1] * at]),
            np.column_stack([none, at, -u[:, 1:] * at]),
        ]
    )
    matrix = np.linalg.svd(rows)[2][-1].reshape(3, 3)
    back = np.array([[scale, 0, middle[0]], [0, scale, middle[1]], [0, 0, 1.0]])
    return back @ matrix


def _quads(matrix: np.ndarray, turned: bool) -> np.ndarray:
    """Return the corners (24, 4, 2) of the measured parts; of a chart that is upside down."""
    rows, cols = np.mgrid[:ROWS, :COLUMNS].reshape(2, -1)
    if turned:
        rows, cols = ROWS - 1 - rows, COLUMNS - 1 - cols
    half = INNER / 2 * 0.8  # patches are some 80 % of their pitch
    around = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    cells = np.stack([cols, rows], 1)[:, None] + around
    x, y, w = np.moveaxis(np.concatenate([cells, np.ones((*cells.shape[:2], 1))], -1), -1, 0)
    mapped = np.einsum("ij,jnk->ink", matrix, np.stack([x, y, w]))
    return np.moveaxis(mapped[:2] / mapped[2], 0, -1)


def _inside(quads: np.ndarray, shape: tuple[int, int]) -> bool:
    return bool(
        quads.min() >= 0 and quads[..., 0].max() <= shape[1] and quads[..., 1].max() <= shape[0]
    )


def _measured(planes: dict[str, Plane], quads: np.ndarray) -> Patches:
    """Return means and noise of the pixels whose middles lie in the quadrilaterals."""
    mean, noise = np.empty((len(quads), len(planes))), np.empty((len(quads), len(planes)))
    clipped = np.zeros(len(quads), bool)
    for number, quad in enumerate(quads):
        left, top = np.floor(quad.min(axis=0)).astype(int)
        right, bottom = np.ceil(quad.max(axis=0)).astype(int)
        rows, cols = np.mgrid[top:bottom, left:right]
        sides = []
        for (ax, ay), (bx, by) in zip(quad, np.roll(quad, -1, axis=0), strict=True):
            sides.append((bx - ax) * (rows + 0.5 - ay) - (by - ay) * (cols + 0.5 - ax))
        inside = np.all(np.array(sides) >= 0, axis=0) | np.all(np.array(sides) <= 0, axis=0)
        for at, plane in enumerate(planes.values()):
            own = inside
            if plane.sites is not None:
                height, width = plane.sites.shape
                own = inside & plane.sites[rows % height, cols % width]
            values = plane.values[top:bottom, left:right][own]
            if values.size < 4:
                raise _not_found("patches of fewer than four pixels")
            mean[number, at], noise[number, at] = values.mean(), values.std(ddof=1)
            clipped[number] |= bool(np.any((values <= plane.clip[0]) | (values >= plane.clip[1])))
    return Patches(quads, mean, noise, clipped, tuple(planes))


def _not_found(what: str) -> UserError:
    return UserError(
        "The patches of a ColorChecker are not found.",
        field="PICTURE",
        value=what,
        allowed="the whole chart, its patches 10 px wide or more; or --corners x,y of the middles "
        "of dark skin, bluish green, black and white",
    )
