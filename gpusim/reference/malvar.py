"""Float64 twin of demosaicing by linear filters of 5 x 5."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import correlate

# Figure 2 of Malvar, He and Cutler 2004, in eighths.
GREEN = np.array(
    [[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]
)
ALONG_ROW = np.array(
    [
        [0, 0, 0.5, 0, 0],
        [0, -1, 0, -1, 0],
        [-1, 4, 5, 4, -1],
        [0, -1, 0, -1, 0],
        [0, 0, 0.5, 0, 0],
    ]
)
CORNERS = np.array(
    [
        [0, 0, -1.5, 0, 0],
        [0, 2, 0, 2, 0],
        [-1.5, 0, 6, 0, -1.5],
        [0, 2, 0, 2, 0],
        [0, 0, -1.5, 0, 0],
    ]
)


def malvar(light: np.ndarray) -> np.ndarray:
    """Return red, green and blue at each pixel (3, rows, cols), of a frame that is mirrored.

    Red is at even rows and columns, blue at odd ones.
    """
    light = np.asarray(light, np.float64)

    def by(mask: np.ndarray) -> np.ndarray:
        return correlate(light, mask / 8, mode="mirror")

    even_row, even_col = (n % 2 == 0 for n in np.indices(light.shape))
    red, blue = even_row & even_col, ~even_row & ~even_col
    row, col = by(ALONG_ROW), by(ALONG_ROW.T)
    whole = np.array([np.where(even_row, row, col), by(GREEN), np.where(even_row, col, row)])
    corners = by(CORNERS)
    whole[0][blue], whole[2][red] = corners[blue], corners[red]
    for plane, own in zip(whole, (red, ~red & ~blue, blue), strict=True):
        plane[own] = light[own]
    return whole
