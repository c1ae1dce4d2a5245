"""Chief rays between the fields of a bank: as many as the map from field to image asks for."""

from __future__ import annotations

from functools import cache

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import System
from gpusim.parallel import each
from gpusim.psf.field_map import FieldMap
from gpusim.psf.plane_map import MAP_ERROR_UM, Rings

# Half-way between rays their map may miss the next ones by so much. With these it is 2^8 times as
# good (`gpusim.psf.field_map.DEGREE`): of the phone lens, 0.006 um and then 1e-5.
MISS_UM = 0.01
HALVINGS = 4
# Chief rays of the map: on rings of field angle, denser towards the rim, where splines are least
# sure; twice as many as long as they leave more open than `gpusim.psf.plane_map` allows. A phone's
# lens takes 20.
RINGS, MOST_RINGS = 10, 80
SPOKES = 20
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


def rays_on_rings(system: System, reference_nm: float, largest_deg: float) -> dict[str, np.ndarray]:
    """Trace as many chief rays as the map takes, by the names of the bank's variables."""
    count = RINGS
    while True:
        rays = _on_rings(system, reference_nm, largest_deg, count)
        if largest_deg == 0 or count == MOST_RINGS:
            return rays
        fields, landed = (
            np.stack([rays[f"ray_x_{unit}"], rays[f"ray_y_{unit}"]], axis=1)
            for unit in ("deg", "um")
        )
        if Rings(fields, landed).error_um <= MAP_ERROR_UM:
            return rays
        count *= 2


def _on_rings(
    system: System, reference_nm: float, largest_deg: float, count: int
) -> dict[str, np.ndarray]:
    """Trace the chief rays of the axis and of so many rings."""
    index = system.index(np.array([reference_nm]))
    rings_deg = largest_deg * np.sin(np.pi / 2 * np.arange(1, count + 1) / count)
    spokes = 2 * np.pi * np.arange(SPOKES) / SPOKES

    def land(field: tuple[float, float]) -> tuple[float, float]:
        found = sample_rays(system, index, np.radians(field[0]), MIDDLE, MIDDLE, azimuth=field[1])
        return 1e3 * found.chief_x_mm[0], 1e3 * found.chief_y_mm[0]

    fields = [(0.0, 0.0)]
    if largest_deg > 0:
        fields += [(ring, spoke) for ring in rings_deg for spoke in spokes]
    landed = np.array(each(land, fields))
    if largest_deg > 0:
        grid = landed[1:].reshape(count, SPOKES, 2)
        inner = np.concatenate([np.broadcast_to(landed[0], (1, SPOKES, 2)), grid[:-1]])
        outwards, around = grid - inner, np.roll(grid, -1, axis=1) - grid
        # Azimuth runs from y towards x: outwards and around, in that order, turn clockwise.
        turns = outwards[..., 1] * around[..., 0] - outwards[..., 0] * around[..., 1]
        if turns.min() <= 0:
            ring = int(np.flatnonzero((turns <= 0).any(axis=1))[0])
            raise UserError(
                "distortion folds the image over: image height does not rise with field angle",
                file=system.prescription.file,
                field="max_field_deg",
                value=f"{largest_deg:g}",
                # The turn lies within the two rings before the one that has turned back.
                allowed=f"up to {rings_deg[ring - 2] if ring > 1 else 0:.4g} deg",
            )
    theta, azimuth = np.transpose(fields)
    return {
        "ray_x_deg": theta * np.sin(azimuth),
        "ray_y_deg": theta * np.cos(azimuth),
        "ray_x_um": landed[:, 0],
        "ray_y_um": landed[:, 1],
    }
