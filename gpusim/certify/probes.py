"""Which pixels a certificate looks at."""

from __future__ import annotations

import numpy as np

from gpusim.psf.field_bank import FieldBank
from gpusim.sensor.sensor import Sensor

SEED = 1288  # of the probes' positions: fixed, so that two renders are probed alike
EDGE_SHARE = 0.5  # of the probes lie on the steepest edges
# Where nobody says how many: so many are looked at first, and at most so many.
FEWEST, MOST = 64, 256


def choose_probes(rate: np.ndarray, period: int, count: int) -> np.ndarray:
    """Choose probe pixels: half spread over the field, half on the steepest edges.

    Parameters
    ----------
    rate : ndarray (rows, cols)
        Mean signal.
    period : int
        Period of the filter pattern: edges are sought between pixels of one colour.
    count : int

    Returns
    -------
    ndarray (count, 2) of int
        Row and column.
    """
    rng = np.random.default_rng(SEED)
    rows, cols = rate.shape
    edges = int(count * EDGE_SHARE)
    chosen = []
    for number in (count - edges, edges):
        across = max(1, int(np.ceil(np.sqrt(number * cols / rows))))
        down = max(1, -(-number // across))
        for k in range(number):
            row0, row1 = (rows * (k // across) // down, rows * (k // across + 1) // down)
            col0, col1 = (cols * (k % across) // across, cols * (k % across + 1) // across)
            row1, col1 = max(row1, row0 + 1), max(col1, col0 + 1)
            if number == edges and chosen and len(chosen) >= count - edges:
                part = rate[row0:row1, col0:col1].astype(np.float64)
                slope = np.zeros(part.shape)
                slope[:, period:] = np.abs(part[:, period:] - part[:, :-period])
                slope[period:] = np.maximum(slope[period:], np.abs(part[period:] - part[:-period]))
                row, col = np.unravel_index(np.argmax(slope), slope.shape)
                chosen.append((row0 + int(row), col0 + int(col)))
            else:
                chosen.append((int(rng.integers(row0, row1)), int(rng.integers(col0, col1))))
    return np.array(chosen, int).reshape(-1, 2)


def rounds(count: int, first: int) -> list[np.ndarray]:
    """Cut the probes that `choose_probes` returns into rounds, by number.

    The first is of `first` probes, each further one of as many as all before it. They are taken at
    random, and as large a share of each lies on edges as of all.
    """
    rng = np.random.default_rng(SEED)
    edges = int(count * EDGE_SHARE)
    spread = count - edges
    numbers = np.concatenate([rng.permutation(spread), spread + rng.permutation(edges)])
    places = [np.arange(number) / max(number, 1) for number in (spread, edges)]
    order = numbers[np.argsort(np.concatenate(places), kind="stable")]
    ends = [first]
    while ends[-1] < count:
        ends.append(2 * ends[-1])
    return np.split(order, ends[:-1])


def beyond_circle(bank: FieldBank, sensor: Sensor, pixels: np.ndarray) -> np.ndarray:
    """Return which pixels (P, 2) have their middle beyond the circle that light reaches."""
    middle = np.array([sensor.rows, sensor.cols]) / 2
    at_um = (pixels + 0.5 - middle)[:, ::-1] * sensor.pixel_pitch_um
    return np.hypot(*(at_um - bank.centre_um).T) > bank.rectilinear_circle_um
