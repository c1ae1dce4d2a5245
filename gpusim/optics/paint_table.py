"""A chart's primitives and their steps, as shaders/optics/paint reads them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gpusim.scene.chart import Disc, Polygon, Primitive

PRIMITIVE = np.dtype(
    [
        ("centre", "<f4", 2),
        ("half_size", "<f4", 2),
        ("axis", "<f4", 2),
        ("kind", "<u4"),
        ("step", "<u4"),
    ]
)
# Radius below which a disc is cut into strips, standard deviations of the Gaussian: above, the
# first order in s/R is off by 3e-4 at most. 5 + 2.5 R/s strips leave 3e-6 of the integral; no map
# that is not about to fold squeezes the Gaussian so much that 100 do not suffice.
SMALL_DISC, MOST_STRIPS = 16.0, 100
RECTANGLE_KIND, DISC_KIND, SMALL_DISC_KIND, POLYGON_KIND = 0, 1, 2, 3


def with_steps(
    coefficients: np.ndarray, materials: Sequence[int], under: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of coefficients with those of steps between materials, and each step's row.

    Parameters
    ----------
    coefficients : ndarray (M, J)
        Coefficients of the materials.
    materials, under : sequence of int (P,)
        Material of each primitive, and of what it lies in.

    Returns
    -------
    rows : ndarray (M + N, J)
    steps : ndarray (P,) of int
    """
    pairs = np.stack([materials, under], axis=1).astype(int).reshape(-1, 2)
    distinct, number = np.unique(pairs, axis=0, return_inverse=True)
    changes = coefficients[distinct[:, 0]] - coefficients[distinct[:, 1]]
    return np.concatenate([coefficients, changes]), len(coefficients) + number.ravel()


def primitive_row(
    shape: Primitive,
    step: int,
    pitch_um: float,
    sigma: float,
    least_stretch: float,
    *,
    first: int = 0,
) -> tuple:
    """Return a primitive as a row of `PRIMITIVE`.

    Parameters
    ----------
    shape : Rect, Disc or Polygon
        In um.
    step : int
        Row of the step from what is around it to its own material.
    pitch_um : float
        Pitch of the sim grid.
    sigma : float
        Sigma of the Gaussian, sim samples.
    least_stretch : float
        Least stretch of the chief-ray map.
    first : int
        Place of a polygon's first corner in the list of all corners.
    """
    centre = (shape.cx / pitch_um, shape.cy / pitch_um)
    if isinstance(shape, Polygon):
        return (centre, (first, len(shape.points)), (1.0, 0.0), POLYGON_KIND, step)
    if not isinstance(shape, Disc):
        size = (shape.half_w / pitch_um, shape.half_h / pitch_um)
        axis = (np.cos(shape.angle_rad), np.sin(shape.angle_rad))
        return (centre, size, axis, RECTANGLE_KIND, step)
    radius = shape.radius / pitch_um
    if radius >= SMALL_DISC * sigma:
        return (centre, (radius, 0.0), (1.0, 0.0), DISC_KIND, step)
    strips = min(np.ceil(5 + 2.5 * radius / (sigma * least_stretch)), MOST_STRIPS)
    axis = (np.cos(np.pi / strips), np.sin(np.pi / strips))
    return (centre, (radius, strips), axis, SMALL_DISC_KIND, step)


def table_of(
    shapes: Sequence[Primitive],
    steps: Sequence[int],
    pitch_um: float,
    sigma: float,
    least_stretch: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of primitives, at least one, and the corners of the polygons among them.

    Parameters
    ----------
    shapes, steps
        Each as `primitive_row` takes it.
    pitch_um, sigma, least_stretch : float
        As there.

    Returns
    -------
    rows : ndarray (P,) of `PRIMITIVE`
    corners : ndarray (C, 2), float32
        From each polygon's middle, sim samples; at least one.
    """
    rows = np.zeros(max(len(shapes), 1), PRIMITIVE)
    corners: list[np.ndarray] = []
    first = 0
    for place, (shape, step) in enumerate(zip(shapes, steps, strict=True)):
        rows[place] = primitive_row(shape, step, pitch_um, sigma, least_stretch, first=first)
        if isinstance(shape, Polygon):
            corners.append((shape.corners() - (shape.cx, shape.cy)) / pitch_um)
            first += len(shape.points)
    return rows, np.concatenate([*corners, np.zeros((1, 2))]).astype(np.float32)
