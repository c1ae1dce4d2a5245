"""Which spectrum of a chart lies where around a pixel, for the sums of the exact model.

Cells that lie in one material count whole. Those that an outline cuts fall into squares, and of a
square that is cut, each material counts at the centre of mass of its share.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gpusim.reference.coverage import NOTHING, cross, part_of
from gpusim.reference.fields import Grid, Heights
from gpusim.reference.quadrature import Zone


class Outlines:
    """The shapes of one chart, as the pixels of one camera see them.

    Parameters
    ----------
    chart : gpusim.scene.chart.Chart
        Placed: in um on the ideal plane.
    fields : Heights or Grid
    alike : list of (int, float)
        For each of the chart's spectra the one that stands for it, and as how many times that it
        counts.
    """

    def __init__(self, chart: Any, fields: Heights | Grid, alike: list[tuple[int, float]]) -> None:
        self.chart, self.fields, self.alike = chart, fields, alike
        bounds = [(shape.cx, shape.cy, shape.reach) for shape in chart.primitives]
        self.bounds = np.array(bounds).reshape(-1, 3)

    def shares(
        self, zone: Zone, centre: np.ndarray
    ) -> tuple[dict[int, np.ndarray], dict[int, tuple[np.ndarray, np.ndarray]]]:
        """Return where each spectrum lies around a pixel, and by which factor.

        Returns
        -------
        whole : dict of ndarray
            Factors in the cells that lie in one material, by block of the zone.
        cut : dict of (ndarray (P, 2), ndarray (P,))
            The cells that an outline cuts: centres of mass, as distances t, and areas times
            factors.
        """
        corners = zone.cells[:, [0, 0, -1, -1], [0, -1, 0, -1]]
        middle = self.fields.ideal(centre - corners.mean(axis=1))
        from_middle = self.fields.ideal(centre - corners) - middle[:, None]
        # From a block's middle to its farthest point, and as many times less for a cell; the tenth
        # is for the map's curvature.
        radius = 1.1 * (len(zone.cells[0]) + 1) / (len(zone.cells[0]) - 1)
        radius = radius * np.hypot(from_middle[..., 0], from_middle[..., 1]).max(axis=1)
        small = (radius / len(zone.cells[0]))[:, None, None]
        near = self._near(middle, radius)
        material = np.full(zone.cells.shape[:3], self.chart.background)
        split = np.zeros(material.shape, bool)
        for shape, _ in near:
            distance = shape.distance(middle[:, 0], middle[:, 1])
            inside = distance < -radius
            material[inside], split[inside] = shape.material, False
            at = np.abs(distance) <= radius
            if at.any():
                cells = self.fields.ideal(centre - zone.cells[at])
                depth = shape.distance(cells[..., 0], cells[..., 1])
                material[at] = np.where(depth < 0, shape.material, material[at])
                split[at] = (split[at] & (depth > -small[at])) | (np.abs(depth) <= small[at])
        split &= zone.reached
        whole: dict[int, np.ndarray] = {}
        for number in np.unique(material[zone.reached & ~split]):
            spectrum, factor = self.alike[number]
            whole[spectrum] = whole.get(spectrum, 0.0) + factor * ((material == number) & ~split)
        return whole, self._cut_shares(near, zone, centre, zone.cells[split])

    def _near(self, middle: np.ndarray, radius: np.ndarray) -> list[tuple[Any, int]]:
        """Return the primitives that reach into the rectangle of some discs, in their order.

        Each with the material that it lies in.
        """
        low, high = (middle - radius[:, None]).min(axis=0), (middle + radius[:, None]).max(axis=0)
        at, reach = self.bounds[:, :2], self.bounds[:, 2:]
        near = np.all((at + reach >= low) & (at - reach <= high), axis=1)
        numbers = np.flatnonzero(near)
        return [
            (self.chart.primitives[number], int(self.chart.under[number])) for number in numbers
        ]

    def _cut_shares(
        self,
        near: list[tuple[Any, int]],
        zone: Zone,
        centre: np.ndarray,
        cells: np.ndarray,
    ) -> dict[int, tuple[np.ndarray, np.ndarray]]:
        """Return centres of mass and areas of each spectrum's parts of cells (P, 2)."""
        side = zone.step_um / zone.split
        offsets = (np.arange(zone.split) + 0.5) * side - zone.step_um / 2
        t = cells[:, None] + np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        t = t.reshape(-1, 2)
        ideal = self.fields.ideal(centre - t)
        # For each material: its share of a square, and that share times the way from the square's
        # middle to the share's centre of mass.
        shares = {self.chart.background: (np.ones(len(t)), np.zeros((len(t), 2)))}
        for shape, under in near:
            distance = shape.distance(ideal[:, 0], ideal[:, 1])
            part = (distance < 0).astype(np.float64)
            moment = np.zeros((len(t), 2))
            # Squares are small: the map stretches all of a zone's alike, within a factor of two.
            at = np.abs(distance) <= 2 * side * self._stretch(centre)
            if not part.any() and not at.any():
                continue
            if at.any():
                quads = self._corners(centre - t[at], side)
                part[at], mass = part_of(quads, shape)
                moment[at] = part[at][:, None] * _in_square(quads, mass, side)
            # What it takes it takes from the one material that it lies in: outlines may touch.
            for number, sign in ((under, -1.0), (shape.material, 1.0)):
                share, way = shares.get(number, (0.0, 0.0))
                shares[number] = share + sign * part, way + sign * moment
        found: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
        for number, (share, way) in shares.items():
            there = share > NOTHING
            spectrum, factor = self.alike[number]
            # A source that lies farther right is less far from the pixel.
            places = t[there] - way[there] / share[there][:, None]
            found.setdefault(spectrum, []).append((places, factor * share[there] * side**2))
        return {
            spectrum: (
                np.concatenate([one[0] for one in parts]),
                np.concatenate([one[1] for one in parts]),
            )
            for spectrum, parts in found.items()
            if sum(len(one[1]) for one in parts)
        }

    def _stretch(self, real: np.ndarray) -> float:
        """Return the largest length on the ideal plane of a unit length at a real point."""
        moved = self.fields.ideal(real + np.array([[1.0, 0], [-1.0, 0], [0, 1.0], [0, -1.0]]))
        return float(np.hypot(*(moved - self.fields.ideal(real)).T).max())

    def _corners(self, source: np.ndarray, side: float) -> np.ndarray:
        """Return the corners (P, 4, 2) on the ideal plane of squares at real points (P, 2)."""
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * side / 2
        return self.fields.ideal(source[:, None] + corners)


def _in_square(quads: np.ndarray, points: np.ndarray, side: float) -> np.ndarray:
    """Return points (P, 2) of the ideal plane as ways from the middles of real squares, um.

    Their images are the quads (P, 4, 2), over which the map is taken as even.
    """
    across = (quads[:, 1] + quads[:, 2] - quads[:, 0] - quads[:, 3]) / (2 * side)
    down = (quads[:, 2] + quads[:, 3] - quads[:, 0] - quads[:, 1]) / (2 * side)
    way = points - quads.mean(axis=1)
    return np.stack([cross(way, down), cross(across, way)], axis=-1) / cross(across, down)[:, None]
