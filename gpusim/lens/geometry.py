"""Shapes and places of a lens's surfaces, as rays meet them.

z along the axis in the direction of light, the first vertex at z = 0; all lengths in mm.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Geometry:
    """Shapes and places of S surfaces.

    Attributes
    ----------
    curvature, conic, vertex_z : ndarray, shape (S,)
        1/mm, conic constant, mm.
    asphere : ndarray, shape (S, 15)
        a2 ... a30, mm^(1-k).
    stop : int
        Index of the stop surface, from 0.
    decentre : ndarray, shape (S, 2)
        x and y of each vertex, mm.
    rotation : ndarray, shape (S, 3, 3)
        From the frame of each surface to that of the lens.
    object_z : float
        Place of the object plane, mm before the first vertex as a number < 0; -inf: at infinity.
    field_z : float
        Point of the axis, the paraxial entrance pupil's, at which the angle of a point of the
        object plane is its field. It means nothing where the object is at infinity.
    """

    curvature: np.ndarray
    conic: np.ndarray
    asphere: np.ndarray
    vertex_z: np.ndarray
    stop: int
    decentre: np.ndarray
    rotation: np.ndarray
    object_z: float = -np.inf
    field_z: float = 0.0

    @functools.cached_property
    def moved(self) -> np.ndarray:
        """Which surfaces are decentred or tilted, shape (S,)."""
        return self.decentre.any(axis=1) | (self.rotation != np.eye(3)).any(axis=(1, 2))

    def centred(self) -> Geometry:
        """Return the same surfaces, all on the axis."""
        identity = np.broadcast_to(np.eye(3), self.rotation.shape)
        return replace(self, decentre=np.zeros_like(self.decentre), rotation=identity)

    def source(self, theta: float, azimuth: float = 0.0) -> np.ndarray | None:
        """Return the point of the object plane, shape (3,), of a field; None at infinity."""
        if np.isinf(self.object_z):
            return None
        height = (self.object_z - self.field_z) * np.tan(theta)
        return np.array([height * np.sin(azimuth), height * np.cos(azimuth), self.object_z])
