"""How a scene lies on the ideal image plane: where a camera without distortion puts a field angle.

With focal length f there are two. Rectilinear is u = f tan(theta): what is straight in the world
stays straight, and it ends short of 90 degrees. Angular is u = f theta: every angle has its place.
Radiance is carried from place to place and not spread: no projection makes anything brighter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Projection:
    """Heights over the focal length against field angles, rad.

    Attributes
    ----------
    name : str
    end_deg : float
        Where it ends: tan(85 deg) is 11, and at 90 degrees it is gone.
    """

    name: str
    end_deg: float

    def height(self, theta: np.ndarray) -> np.ndarray:
        """Return u / f."""
        return np.tan(theta) if self.name == "rectilinear" else np.asarray(theta, float)

    def angle(self, height: np.ndarray) -> np.ndarray:
        """Return theta of u / f."""
        return np.arctan(height) if self.name == "rectilinear" else np.asarray(height, float)

    def slope(self, theta: float) -> float:
        """Return d(u / f) / d(theta)."""
        return float(1 / np.cos(theta) ** 2) if self.name == "rectilinear" else 1.0


RECTILINEAR, ANGULAR = Projection("rectilinear", 85.0), Projection("angular", 180.0)
PROJECTIONS = {one.name: one for one in (RECTILINEAR, ANGULAR)}
