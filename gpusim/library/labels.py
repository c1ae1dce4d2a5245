"""Labels of a scene (depth, albedo, classes) on the pixels of a sensor, through the distortion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gpusim.errors import UserError
from gpusim.lens.projection import RECTILINEAR
from gpusim.optics.chief_ray import chief_ray_map
from gpusim.psf.field_bank import seen_as
from gpusim.scene.make import plane_of
from gpusim.scene.panorama import PANORAMA, samples
from gpusim.scene.raster import Raster

if TYPE_CHECKING:
    from gpusim.camera import Camera
    from gpusim.sensor.frame import Areas


def labels_on_sensor(
    camera: Camera,
    labels: np.ndarray,
    beyond: float = 0,
    projection: str = RECTILINEAR.name,
) -> np.ndarray:
    """Return what label each pixel of a sensor sees, without blur.

    Each pixel has the label at the point that its middle's chief ray comes from, at the reference
    wavelength: none is mixed of two. The map lies as a photograph does, over the whole sensor.

    Parameters
    ----------
    camera : Camera
    labels : ndarray (rows, cols) or (rows, cols, n)
        Values of any type.
    beyond : number
        Label of what no ray of the lens or no part of the map reaches.
    projection : str
        That of the scene: see `gpusim.scene.make.make_scene`.

    Returns
    -------
    ndarray (sensor rows, sensor cols) or (sensor rows, sensor cols, n)
        Values of the type of the labels.

    Raises
    ------
    UserError
        No map of labels, ``beyond`` is none of their type, there is no such projection, or the
        map is no panorama.
    """
    labels = np.asarray(labels)
    if labels.ndim not in (2, 3) or not labels.size or labels.dtype.kind not in "biuf":
        raise UserError(
            "no map of labels",
            field="labels",
            value=f"{labels.dtype} {labels.shape}",
            allowed="numbers (rows, cols) or (rows, cols, n)",
        )
    fill = np.asarray(beyond).astype(labels.dtype)
    if not (fill == beyond or (np.isnan(beyond) and labels.dtype.kind == "f")):
        raise UserError(
            "no label of this type", field="beyond", value=beyond, allowed=str(labels.dtype)
        )
    sensor, bank = camera.sensor, seen_as(camera.bank(), plane_of(projection))
    half_um = [side * sensor.pixel_pitch_um / 2 for side in (sensor.cols, sensor.rows)]
    high, wide = labels.shape[:2]
    y, x = (
        (np.arange(count) + 0.5) * sensor.pixel_pitch_um - half
        for count, half in zip((sensor.rows, sensor.cols), half_um[::-1], strict=True)
    )
    real_um = np.stack(np.meshgrid(x, y), axis=-1)
    ideal_um = chief_ray_map(bank.levels[0]).ideal_um(real_um)
    if projection == PANORAMA:
        right, down = np.moveaxis(ideal_um / (1e3 * bank.principal_distance_mm), -1, 0)
        row, col = samples(right, down, (high, wide))
        # At half a turn a direction is on either end of its row; beyond it there is none.
        col, row = col % wide, np.where(np.hypot(right, down) <= np.pi, row, -1)
    else:
        pitch_um = Raster(np.zeros((1, high, wide), np.float32)).pitch_um(*half_um)
        col, row = ideal_um[..., 0] / pitch_um + wide / 2, ideal_um[..., 1] / pitch_um + high / 2
    col, row = np.floor(col).astype(int), np.floor(row).astype(int)
    seen = (row >= 0) & (row < high) & (col >= 0) & (col < wide)
    seen &= np.hypot(*np.moveaxis(real_um, -1, 0)) <= bank.image_circle_um
    found = np.full((sensor.rows, sensor.cols, *labels.shape[2:]), fill, labels.dtype)
    found[seen] = labels[row[seen], col[seen]]
    return found


def in_raw(seen: np.ndarray, areas: Areas, shape: tuple[int, ...]) -> np.ndarray:
    """Return labels on the pixels of a raw; shielded pixels, which see nothing, have 0.

    Parameters
    ----------
    seen : ndarray (sensor rows, sensor cols) or (sensor rows, sensor cols, n)
        As of `labels_on_sensor`.
    areas : Areas
        The raw's own.
    shape : (int, int)
        Rows and columns of the raw.
    """
    (row, col, rows, cols), (first_row, first_col, *_) = areas.lit, areas.active
    whole = np.zeros((*shape, *seen.shape[2:]), seen.dtype)
    lit = seen[row : row + rows, col : col + cols]
    whole[first_row : first_row + rows, first_col : first_col + cols] = lit
    return whole
