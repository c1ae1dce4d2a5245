"""Where in a frame the bank of a lens is judged: between its fields.

A lens with an axis is judged at image heights and on rings of pixels. A lens without one is judged
at image points and at pixels near to them. As of the engine's probes, half of the pixels lie on the
steepest edges, where a shift shows most, and half anywhere: beside edges black is lit by PSFs' far
light alone, and errs more than the edges do.
"""

from __future__ import annotations

import numpy as np

from gpusim.psf.bank import Bank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.sensor.sensor import Sensor

HEIGHTS = 4  # image heights or points at which the lens is traced
EACH = 4  # pixels at each of them
SEED = 1288  # of those that lie anywhere: fixed, so that two renders are judged alike
AZIMUTHS = 1440  # places on a ring among which pixels are chosen
SEEN = 65  # points each way among which those next to the cells' middles are
# From a point, in pixels, among which pixels are chosen: PSFs are those of the point for all.
NEAR = 128


def radii_of(
    bank: Bank, sensor: Sensor, shape: tuple[int, int], origin: tuple[int, int], between: bool
) -> tuple[np.ndarray, list[int]]:
    """Return image heights in a rectangle to judge the bank at, and the fields that lie there.

    Half-way between fields; or else odd fields, to be judged by their neighbours.
    """
    half = np.array([sensor.rows, sensor.cols]) / 2
    low = (np.array(origin) - half) * sensor.pixel_pitch_um
    high = low + np.array(shape) * sensor.pixel_pitch_um
    nearest = np.hypot(*np.clip(0.0, low, high))
    farthest = np.hypot(*np.maximum(np.abs(low), np.abs(high)))
    own = bank.real_height_um[:, bank.reference]
    if between:
        start, end = np.maximum(own[:-1], nearest), np.minimum(own[1:], farthest)
        there = np.flatnonzero(end > start)
        places = (start + end)[there] / 2
    else:
        there = np.arange(1, len(own) - 1, 2)
        there = there[(own[there] > nearest) & (own[there] < farthest)]
        places = own[there]
    if not len(places):
        return places, []
    # The rim is where a lens changes most; the rest evenly.
    chosen = np.unique(np.round(np.linspace(0, len(places) - 1, HEIGHTS + 1)[1:]).astype(int))
    return places[chosen], [int(number) for number in there[chosen]]


def pixels_on_rings(
    sensor: Sensor, rate: np.ndarray, origin: tuple[int, int], radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (P, 2) at the heights, and the height (P,) of each."""
    chosen, owners = [], []
    rng = np.random.default_rng(SEED)
    turn = np.linspace(0, 2 * np.pi, AZIMUTHS, endpoint=False)
    for number, radius in enumerate(radii):
        ring = radius / sensor.pixel_pitch_um * np.stack([np.sin(turn), np.cos(turn)], axis=1)
        at = np.floor(ring + np.array([sensor.rows, sensor.cols]) / 2).astype(int) - origin
        inside = np.all((at >= 0) & (at < np.array(rate.shape)), axis=1)
        at, where = at[inside], np.flatnonzero(inside)
        slope = _steepness(sensor, rate, at)
        for place, part in enumerate(np.array_split(np.arange(AZIMUTHS), EACH)):
            own = np.flatnonzero((where >= part[0]) & (where <= part[-1]) & (slope >= 0))
            if len(own):
                chosen.append(at[own[_one_of(slope[own], place + number, rng)]] + origin)
                owners.append(number)
    return np.array(chosen, int).reshape(-1, 2), np.array(owners, int)


def points_of(
    bank: PlaneBank, sensor: Sensor, shape: tuple[int, int], origin: tuple[int, int], between: bool
) -> tuple[np.ndarray, list[int]]:
    """Return image points (P, 2), um, in a rectangle to judge a bank without an axis at.

    Between the fields, each cell gives its middle, or else the point of the rectangle next to that.
    Otherwise the points are the fields of odd rows and columns, with their numbers: their
    neighbours judge them.
    """
    corner = (np.array(origin) - np.array([sensor.rows, sensor.cols]) / 2)[::-1]
    low = corner * sensor.pixel_pitch_um
    high = low + np.array(shape)[::-1] * sensor.pixel_pitch_um
    sides = bank.field_x_deg, bank.field_y_deg
    across = len(sides[0])
    if between:
        # Pixels stand for the plane, for the map leads from there to the fields.
        line = [np.linspace(a, b, SEEN) for a, b in zip(low, high, strict=True)]
        seen = np.stack(np.meshgrid(*line), axis=-1).reshape(-1, 2)
        seen = seen[np.hypot(*(seen - bank.centre_um).T) < bank.rectilinear_circle_um]
        field = np.stack(bank.field_deg(*seen.T), axis=-1)
        cells = [
            np.clip(np.searchsorted(side, at, "right") - 1, 0, len(side) - 2)
            for side, at in zip(sides, field.T, strict=True)
        ]
        number = cells[1] * across + cells[0]
        share = [
            (at - side[own]) / (side[own + 1] - side[own])
            for side, at, own in zip(sides, field.T, cells, strict=True)
        ]
        off = np.hypot(*(np.stack(share) - 0.5))
        nearest = [
            np.flatnonzero(number == one)[off[number == one].argmin()] for one in np.unique(number)
        ]
        points, numbers = seen[nearest], number[nearest]
    else:
        rows, cols = (np.arange(1, len(side) - 1, 2) for side in sides[::-1])
        numbers = (rows[:, None] * across + cols).ravel()
        at = (*np.divmod(numbers, across), bank.reference)
        points = np.stack([bank.chief_x_um[at], bank.chief_y_um[at]], axis=-1)
        inside = np.all((points > low) & (points < high), axis=1)
        points, numbers = points[inside], numbers[inside]
    if not len(points):
        return points, []
    # From the middle outwards: the rim is where a lens changes most.
    order = np.argsort(np.hypot(*(points - bank.centre_um).T), kind="stable")
    evenly = np.unique(np.round(np.linspace(0, len(points) - 1, HEIGHTS + 1)[1:]).astype(int))
    chosen = order[evenly]
    return points[chosen], [int(one) for one in numbers[chosen]]


def pixels_near(
    sensor: Sensor, rate: np.ndarray, origin: tuple[int, int], points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels (P, 2) near to image points, and the point of each."""
    chosen, owners = [], []
    rng = np.random.default_rng(SEED)
    for number, (x, y) in enumerate(points):
        middle = np.array([y, x]) / sensor.pixel_pitch_um
        middle = middle + np.array([sensor.rows, sensor.cols]) / 2 - origin
        low = np.maximum(middle.astype(int) - NEAR, 0)
        high = np.minimum(middle.astype(int) + NEAR + 1, rate.shape)
        # In strips: on edges of more than one kind.
        for place, rows in enumerate(np.array_split(np.arange(low[0], high[0]), EACH)):
            at = np.stack(np.meshgrid(rows, np.arange(low[1], high[1]), indexing="ij"), -1)
            at = at.reshape(-1, 2)
            at = at[(slope := _steepness(sensor, rate, at)) >= 0]
            if len(at):
                chosen.append(at[_one_of(slope[slope >= 0], place + number, rng)] + origin)
                owners.append(number)
    return np.array(chosen, int).reshape(-1, 2), np.array(owners, int)


def _one_of(slope: np.ndarray, number: int, rng: np.random.Generator) -> int:
    """Return which of some pixels is judged: of every other choice the steepest, else any."""
    return int(slope.argmax() if number % 2 == 0 else rng.integers(len(slope)))


def _steepness(sensor: Sensor, rate: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return how much the signal changes to the next pixel of its colour (P,); dark ones: -1."""
    most = np.array(rate.shape) - 1
    here = rate[tuple(at.T)].astype(np.float64)
    slope = np.zeros(len(at))
    for axis in (0, 1):
        step = np.eye(2, dtype=int)[axis] * sensor.period[axis]
        there = rate[tuple(np.clip(at + step, 0, most).T)].astype(np.float64)
        slope = np.maximum(slope, np.abs(here - there))
    return np.where(here > 0, slope, -1.0)
