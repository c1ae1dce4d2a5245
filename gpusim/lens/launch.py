"""Where the rays of a field start: on a plane perpendicular to it.

Never on the plane of the first vertex: of objects at infinity tan(theta) appears nowhere, and
fields of 90 deg and more are like any other. Those of a point of an object plane start there along
the way from that point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Launch:
    """The plane from which the rays of one field start, across its chief rays.

    A ray starts at E + px e1 + py e2. From infinity it goes along d = (0, sin theta, cos theta),
    with e1 = (1, 0, 0) and e2 = (0, cos theta, -sin theta); an azimuth turns all three about the
    axis, from y towards x. From a point of the object plane it goes along the way from that point,
    and d is the way to E. Paths are those from the wavefront through E: a plane, or a sphere.

    Attributes
    ----------
    theta : float
        Field angle, rad; any from -pi to pi.
    base : ndarray, shape (3, L)
        E of each wavelength, mm. ``launch_field`` puts it where the chief ray meets the first
        surface, so that (px, py) = 0 is the chief ray.
    azimuth : float
        Azimuth of the field, rad: 0 in the y-z plane, which is all that a centred lens needs.
    source : ndarray, shape (3,), or None
        Point of the object, mm; None where it is at infinity.
    """

    theta: float
    base: np.ndarray
    azimuth: float = 0.0
    source: np.ndarray | None = None

    @property
    def direction(self) -> np.ndarray:
        """Direction cosines d of the chief rays, shape (3, L)."""
        if self.source is None:
            field = self._turned(0.0, np.sin(self.theta), np.cos(self.theta))
            return np.broadcast_to(field[:, None], self.base.shape)
        way = self.base - self.source[:, None]
        return way / np.sqrt((way * way).sum(0))

    @property
    def e1(self) -> np.ndarray:
        """Unit vector of px, shape (3, L)."""
        across = self._turned(1.0, 0.0, 0.0)[:, None]
        if self.source is None:
            return np.broadcast_to(across, self.base.shape)
        d = self.direction
        across = across - (across * d).sum(0) * d
        return across / np.sqrt((across * across).sum(0))

    @property
    def e2(self) -> np.ndarray:
        """Unit vector of py, shape (3, L)."""
        if self.source is None:
            field = self._turned(0.0, np.cos(self.theta), -np.sin(self.theta))
            return np.broadcast_to(field[:, None], self.base.shape)
        return np.cross(self.direction, self.e1, axis=0)

    def _turned(self, x: float, y: float, z: float) -> np.ndarray:
        c, s = np.cos(self.azimuth), np.sin(self.azimuth)
        return np.array([c * x + s * y, c * y - s * x, z])

    def points(self, px: np.ndarray, py: np.ndarray) -> np.ndarray:
        """Return where rays start, shape (3, L, R), for px and py of shape (L, R)."""
        e1, e2 = self.e1[:, :, None], self.e2[:, :, None]
        return self.base[:, :, None] + px * e1 + py * e2

    def rays(self, px: np.ndarray, py: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rays' starts and directions, (3, L, R), and their paths to there, (L, R)."""
        point = self.points(px, py)
        if self.source is None:
            direction = np.broadcast_to(self.direction[:, :, None], point.shape)
            return point, direction, np.zeros(px.shape)
        way, chief = (one - self.source[:, None, None] for one in (point, self.base[:, :, None]))
        far, chief_far = (np.sqrt((one * one).sum(0)) for one in (way, chief))
        # The difference of the two, of which nothing cancels: the plane is across the chief ray.
        return point, way / far, (px * px + py * py) / (far + chief_far)
