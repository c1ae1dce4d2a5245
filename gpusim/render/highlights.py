"""The light of highlights, kept for the tiles of a frame."""

from __future__ import annotations

import numpy as np

from gpusim.plan.tiles import Rect, aligned
from gpusim.sensor.frame import overlap


class PointSourceLight:
    """The light of highlights on a rectangle of lit pixels, electrons/s of the planes, by tile."""

    def __init__(self, rect: Rect, period: int, tiles: list[Rect], light: list[np.ndarray]) -> None:
        self.rect, self.period = rect, period
        _, _, rows, cols = aligned(rect, period)
        self.light = np.empty((len(light[0]), rows // period, cols // period), np.float32)
        for tile, part in zip(tiles, light, strict=True):
            self._part(tile)[...] = part

    def covers(self, rect: Rect) -> bool:
        """Return whether the light on a rectangle is there."""
        return overlap(self.rect, rect) == rect

    def on(self, rect: Rect) -> np.ndarray:
        """Return the light (S, rows, cols) on a rectangle of whole periods."""
        return np.ascontiguousarray(self._part(rect))

    def _part(self, rect: Rect) -> np.ndarray:
        period = self.period
        row, col = (
            (own - first) // period for own, first in zip(rect[:2], self.rect[:2], strict=True)
        )
        return self.light[:, row : row + -(-rect[2] // period), col : col + -(-rect[3] // period)]
