"""Where a scene is steepest on the image plane: where a certificate would look.

A chart is steepest on its outlines. In a photograph that is where neighbouring samples differ most.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from gpusim.optics.chief_ray import ChiefRayMap
from gpusim.scene.chart import Chart, Polygon, Primitive, Rect
from gpusim.scene.raster import PlacedRaster
from gpusim.sensor.sensor import Sensor

RINGS = 3  # of the field, in each of which there are
ALONG = 15  # places along a side that is long beside a ring
PLACES_EACH = 2  # places where an outline is steepest, of different directions
# A photograph is cut into as many cells as a certificate has probes on edges. Few of them, beside
# lamps, may make up all of the sum of squares. So cells are ordered by their steepest step, over
# the darker side's light, and a few are worked out, each of which stands for so many.
CELLS = 128
STANDS_FOR = (1, 1, 2, 2, 4, 4, 8, 8, 16, 16, 32, 34)
MOST_SHAPES = 512  # of a chart, that are looked at
DARK = 1e-4  # of the brightest: nothing is darker where it is a matter of contrast


def steep_places(
    placed: Chart | PlacedRaster, chief_ray: ChiefRayMap, sensor: Sensor, rates: np.ndarray
) -> list[tuple[tuple[float, float], int]]:
    """Return places (x, y), um on the real plane, where a scene is steep, each with its weight.

    Parameters
    ----------
    placed : Chart or PlacedRaster
        On the sensor, um on the ideal plane.
    chief_ray : ChiefRayMap
    sensor : Sensor
    rates : ndarray (C, M)
        Electrons/s of each of the scene's spectra in each channel.
    """
    half = np.array(
        [sensor.cols * sensor.pixel_pitch_um / 2, sensor.rows * sensor.pixel_pitch_um / 2]
    )
    if isinstance(placed, Chart):
        return [(place, 1) for place in _at_outlines(placed, chief_ray, half, rates)]
    return _at_steps(placed, chief_ray, half, rates)


def _at_outlines(
    chart: Chart, chief_ray: ChiefRayMap, half: np.ndarray, of_spectra: np.ndarray
) -> list[tuple[float, float]]:
    """Return where the largest steps of a chart are: in each ring of the field a few."""
    corner = np.abs(chief_ray.ideal_um(half))
    every = -(-len(chart.primitives) // MOST_SHAPES) or 1
    points = [
        (int(under), shape.material, *point)
        for shape, under in zip(chart.primitives[::every], chart.under[::every], strict=True)
        for point in _outline(shape, tuple(corner.tolist()))
    ]
    if not points:
        return []
    outer, inner, u, v, along_u, along_v = np.array(points).T
    outer, inner = outer.astype(int), inner.astype(int)
    rates = of_spectra / of_spectra.max(axis=1, keepdims=True).clip(1e-300)
    low, high = (np.sort(rates[:, [outer, inner]], axis=1)[:, side] for side in (0, 1))
    contrast = ((high - low) / (low + DARK)).max(axis=0)
    # Straight up or down is one direction, and so is along; an edge of another crosses more.
    turned = np.round(np.degrees(np.arctan2(along_v, along_u))) % 90
    real = _real(chief_ray, half, np.stack([u, v], axis=1))
    radius = np.max(np.abs(real) / half, axis=1)
    chosen = []
    for ring in range(RINGS):
        seen: list[float] = []
        inside = (radius >= ring / RINGS) & (radius < (ring + 1) / RINGS)
        order = np.flatnonzero(inside & (contrast > 0))
        for number in order[np.argsort(-contrast[order], kind="stable")]:
            if turned[number] not in seen:
                seen.append(float(turned[number]))
                chosen.append(tuple(real[number].tolist()))
            if len(seen) == PLACES_EACH:
                break
    return chosen


def _at_steps(
    placed: PlacedRaster, chief_ray: ChiefRayMap, half_um: np.ndarray, of_spectra: np.ndarray
) -> list[tuple[tuple[float, float], int]]:
    """Return where a photograph is steepest in its cells, and for how many each stands."""
    half = np.abs(chief_ray.ideal_um(half_um))
    rates = of_spectra.sum(axis=0).astype(np.float32)
    light = np.tensordot(rates, placed.planes.astype(np.float32, copy=False), axes=1)
    light = np.maximum(light, DARK * light.max() + np.float32(1e-30))
    steps = np.zeros(light.shape, np.float32)
    for axis in (0, 1):
        before, after = (np.delete(light, end, axis) for end in (-1, 0))
        step = np.abs(after - before) / np.minimum(before, after)
        steps[tuple(slice(size) for size in step.shape)] += step
    across = math.ceil(math.sqrt(CELLS * half[0] / half[1]))
    down = math.ceil(CELLS / across)
    found = []
    for row in _cut(placed.y0_um, half[1], placed.pitch_um, light.shape[0], down):
        for col in _cut(placed.x0_um, half[0], placed.pitch_um, light.shape[1], across):
            part = steps[row, col]
            if part.size:
                y, x = np.unravel_index(np.argmax(part), part.shape)
                x_um = placed.x0_um + (col.start + x + 1) * placed.pitch_um
                y_um = placed.y0_um + (row.start + y + 1) * placed.pitch_um
                found.append((float(part[y, x]), x_um, y_um))
    found.sort(reverse=True)
    chosen, first = [], 0
    for count in STANDS_FOR:
        own = found[first : first + count]
        if own:
            _, *place = own[len(own) // 2]
            real = _real(chief_ray, half_um, np.array([place]))[0]
            chosen.append((tuple(real.tolist()), len(own)))
        first += count
    return chosen


def _real(chief_ray: ChiefRayMap, half_um: np.ndarray, ideal_um: np.ndarray) -> np.ndarray:
    """Return about where points (N, 2) of the ideal plane land; beyond the sensor, its edge."""
    return np.clip(chief_ray.real_um(ideal_um), -half_um, half_um)


def _outline(shape: Primitive, half_um: tuple[float, float]) -> list[tuple[float, ...]]:
    """Return points of an outline, with the directions outwards.

    Sides that are long beside the frame give several points: their middle may lie beyond it.
    """
    turns = [2.4 * (shape.cx + shape.cy) / shape.reach]  # any direction
    near = min(half_um) / RINGS
    if isinstance(shape, Polygon):
        return _sides(shape, half_um, near)
    if isinstance(shape, Rect):
        found = []
        whole = float(np.hypot(*half_um))
        for quarter in range(4 if shape.reach > near else 2):
            angle = shape.angle_rad + quarter * np.pi / 2
            cos, sin = float(np.cos(angle)), float(np.sin(angle))
            out, along = (shape.half_w, shape.half_h)[:: 1 if quarter % 2 == 0 else -1]
            x, y = shape.cx + out * cos, shape.cy + out * sin
            places = [0.0]
            if along > near:
                # Where the side passes the frame's middle, and as far as the frame reaches.
                middle = x * sin - y * cos
                places += list(np.clip(middle + whole * _middles(ALONG, 1.0), -along, along))
            found += [(x - at * sin, y + at * cos, cos, sin) for at in places]
        return found
    if shape.radius > near:
        turns = list(2 * np.pi * np.arange(ALONG) / ALONG)
    return [
        (shape.cx + shape.radius * cos, shape.cy + shape.radius * sin, cos, sin)
        for cos, sin in ((float(np.cos(turn)), float(np.sin(turn))) for turn in turns)
    ]


def _sides(shape: Polygon, half_um: tuple[float, float], near: float) -> list[tuple[float, ...]]:
    """Return the same of a polygon."""
    found = []
    corners = shape.corners()
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        places = [length / 2]
        if length > 2 * near:
            middle = -float(start @ along)
            reach = float(np.hypot(*half_um)) * _middles(ALONG, 1.0)
            places += list(np.clip(middle + reach, 0.0, length))
        out = (float(along[1]), float(-along[0]))
        found += [(*(start + at * along).tolist(), *out) for at in places]
    return found


def _cut(start_um: float, half_um: float, pitch_um: float, size: int, count: int) -> list[slice]:
    """Return the samples of an axis that the sensor sees, cut into so many parts."""
    ends = (np.linspace(-half_um, half_um, count + 1) - start_um) / pitch_um
    at = np.clip(np.round(ends), 0, size).astype(int).tolist()
    return [slice(*pair) for pair in itertools.pairwise(at)]


def _middles(count: int, half: float) -> np.ndarray:
    return (2 * np.arange(count) + 1 - count) / count * half
