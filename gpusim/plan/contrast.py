"""How much brighter than its pixels' own light a scene is around them.

Light that is left out of a PSF far from its middle is missing where the scene is dark beside what
is bright. It is planned for an edge, relative to the light beside it, and counts by the contrast.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter

from gpusim.scene.chart import Chart
from gpusim.scene.raster import PlacedRaster
from gpusim.scene.shapes import Disc, Primitive, Rect

CHARTS = 20.0  # of a white next to a dark neighbour
# Photographs are measured: by how much what lies within a Gaussian of this sigma is brighter than
# what is at a pixel, the RMS relative to the latter, times BESIDE. A still life with lamps at
# f/2.8, on pixels of 1.55 um, has an RMS of 3. There the tail cut off at 32 um, planned as 8.4e-6
# of an edge, brought the engine 2.0e-3: 240 times as much. Beside lamps it was 5e-3; without a cut
# 5e-4.
AROUND_UM, OWN_UM = 16.0, 1.5
BESIDE = 80.0
MOST = 500.0
DARKEST = 1e-9  # of the brightest: nothing is darker

# White over black of the edges that errors beside them are relative to.
STEEPEST = 20.0  # of a chart's: what is darker is seen through the blur of what is bright
PHOTOGRAPH = 4.0
CELLS = 6, 5  # across and down the sensor: a certificate's probes lie on the steepest edge of each
PER_SIDE = 16  # points of an outline's sides
OUTLINE = 64  # points of a disc's


def edge_contrast(
    placed: Chart | PlacedRaster,
    light: np.ndarray,
    half_um: tuple[float, float],
    real_um: Callable[[np.ndarray], np.ndarray],
) -> float:
    """Return the contrast of a scene's steepest edges, each of a part of the sensor.

    Parameters
    ----------
    placed : Chart or PlacedRaster
        On the sensor, um.
    light : ndarray (M,)
        The chart's materials' own, to a common factor.
    half_um : (float, float)
        Half the sensor's sides.
    real_um : callable
        Returns about where points (N, 2) of the ideal plane land, um.

    Returns
    -------
    float
        That whose logarithm is the root mean square over the parts, for errors relative to the
        dark side go nearly with it.
    """
    if not isinstance(placed, Chart):
        return PHOTOGRAPH
    steepest = np.zeros(CELLS)
    ratio = np.ones(CELLS)
    light = np.maximum(light, light.max() / STEEPEST)
    outlines = [_outline(shape) for shape in placed.primitives]
    if not outlines:
        return 1.0
    landed = real_um(np.concatenate(outlines))
    ends = np.cumsum([len(one) for one in outlines])[:-1]
    parts = zip(placed.primitives, placed.under, np.split(landed, ends), strict=True)
    for shape, under, outline_um in parts:
        one, other = light[shape.material], light[under]
        at = (outline_um / half_um + 1) / 2 * CELLS
        there = at[np.all((at >= 0) & (at < CELLS), axis=1)].astype(int)
        for col, row in np.unique(there, axis=0):
            if abs(one - other) > steepest[col, row]:
                steepest[col, row] = abs(one - other)
                ratio[col, row] = max(one, other) / min(one, other)
    seen = np.log(ratio[steepest > 0])
    return float(np.exp(np.sqrt(np.mean(seen**2)))) if len(seen) else 1.0


def _outline(shape: Primitive) -> np.ndarray:
    """Return points (N, 2) of an outline."""
    if isinstance(shape, Disc):
        turn = np.linspace(0, 2 * np.pi, OUTLINE, endpoint=False)
        return np.array([shape.cx, shape.cy]) + shape.radius * np.stack(
            [np.cos(turn), np.sin(turn)], axis=1
        )
    if isinstance(shape, Rect):
        c, s = np.cos(shape.angle_rad), np.sin(shape.angle_rad)
        across, down = shape.half_w * np.array([c, s]), shape.half_h * np.array([-s, c])
        ways = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = np.array([shape.cx, shape.cy]) + [u * across + v * down for u, v in ways]
    else:
        corners = np.array(shape.points)
    way = np.linspace(0, 1, PER_SIDE, endpoint=False)[:, None, None]
    return (corners * (1 - way) + np.roll(corners, -1, axis=0) * way).reshape(-1, 2)


@lru_cache(maxsize=4)
def contrast_of(placed: Chart | PlacedRaster) -> float:
    """Return by how much an edge's error beside its bright side counts more where it is dark."""
    if isinstance(placed, Chart):
        return CHARTS
    light = placed.planes.max(axis=0)
    around, own = (
        gaussian_filter(light, max(sigma_um / placed.pitch_um, 0.5), truncate=3.0)
        for sigma_um in (AROUND_UM, OWN_UM)
    )
    lit = around > 0
    if not lit.any():
        return CHARTS
    more = around[lit] / np.maximum(own[lit], DARKEST * float(light.max())) - 1
    rms = float(np.sqrt(np.mean(np.square(more, dtype=np.float64))))
    return float(np.clip(BESIDE * rms, CHARTS, MOST))
