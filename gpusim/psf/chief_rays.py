"""Chief rays between the fields of a bank: as many as the map from angle to height asks for."""

from __future__ import annotations

from functools import cache

import numpy as np

from gpusim.lens.system import System
from gpusim.lens.wavefront import sample_rays
from gpusim.psf.field_map import FieldMap

# Half-way between rays their map may miss the next ones by so much. With these it is 2^8 times as
# good (`gpusim.psf.field_map.DEGREE`): of the phone lens, 0.006 um and then 1e-5.
MISS_UM = 0.01
HALVINGS = 4
MIDDLE = np.zeros(1)  # of the stop: the chief ray goes with any point, and some are asked for


class ChiefRays:
    """Chief rays of a lens with an axis, each traced once.

    Parameters
    ----------
    system : System
    wavelengths_nm : ndarray (L,)
    """

    def __init__(self, system: System, wavelengths_nm: np.ndarray) -> None:
        self._system = system
        self._index = system.index(np.asarray(wavelengths_nm, float))
        self._traced = cache(self._trace)

    def _trace(self, theta: float) -> tuple[np.ndarray, np.ndarray]:
        found = sample_rays(self._system, self._index, theta, MIDDLE, MIDDLE)
        radial = found.chief_direction[:, 1]
        return 1e3 * found.chief_y_mm, radial / np.sqrt(1 - radial**2)

    def lands_um(self, theta: float, focus_um: float = 0.0) -> np.ndarray:
        """Return where the rays (L,) of a field, rad, land in an image plane that is moved."""
        height_um, slope = self._traced(theta)
        return height_um + focus_um * slope


def between_fields(
    rays: ChiefRays,
    field_deg: np.ndarray,
    height_um: np.ndarray,
    scale_um: float,
    focus_um: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return field angles, those of the bank among them, and where their chief rays land.

    Each interval is halved until the map through the rays meets all new ones.

    Parameters
    ----------
    rays : ChiefRays
    field_deg : ndarray (F,)
        Rising from 0.
    height_um : ndarray (F, L)
        Where their chief rays land.
    scale_um : float
        Principal distance at the reference wavelength.
    focus_um : float
        How far the image plane is moved away from the lens.

    Returns
    -------
    angles_deg : ndarray (M,)
    heights_um : ndarray (M, L)

    Raises
    ------
    UserError
        Where a chief ray does not reach the image.
    """
    angles, heights = np.asarray(field_deg, float), np.asarray(height_um, float)

    for _ in range(HALVINGS):
        theta = np.radians(angles)
        between = (theta[1:] + theta[:-1]) / 2
        maps = [FieldMap(theta, column, scale_um) for column in heights.T]
        new = np.stack([rays.lands_um(float(one), focus_um) for one in between])
        miss_um = np.abs(np.stack([one.height_um(between) for one in maps], axis=1) - new).max()
        order = np.argsort(np.concatenate([theta, between]))
        angles = np.concatenate([angles, np.degrees(between)])[order]
        heights = np.concatenate([heights, new])[order]
        if miss_um <= MISS_UM:
            break
    return angles, heights
