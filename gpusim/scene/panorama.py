"""Equirectangular panoramas as scenes: laid by angle around the optical axis.

A panorama of 360 x 180 degrees has its longitudes along rows and its latitudes along columns. The
camera stands in its middle and looks at its centre.
"""

from __future__ import annotations

import numpy as np

from gpusim.errors import UserError

PANORAMA = "equirectangular"


def widened(panorama: np.ndarray) -> np.ndarray:
    """Return a panorama whose rows near the poles are blurred to the angle of those at the equator.

    There a sample is 1 / cos(latitude) times as wide; a mean over as many neighbours leaves nothing
    finer than what the angular raster can hold, and nothing negative.

    Parameters
    ----------
    panorama : ndarray (M, rows, cols)

    Returns
    -------
    ndarray (M, rows, cols), float64
    """
    _, rows, cols = panorama.shape
    latitude = np.pi * ((np.arange(rows) + 0.5) / rows - 0.5)
    widths = np.minimum(1 / np.cos(latitude), cols)
    out = panorama.astype(np.float64)
    for row, width in enumerate(widths):
        if width < 1.5:  # up to 48 degrees: less than half a sample to either side
            continue
        # Twice around, so that the mean of any arc is a difference of two sums.
        total = np.cumsum(np.pad(np.tile(out[:, row], 3), ((0, 0), (1, 0))), axis=1)
        ends = cols + np.arange(cols) + 0.5 + np.array([[-width / 2], [width / 2]])
        low, high = (
            np.stack([np.interp(end, np.arange(total.shape[1]), line) for line in total])
            for end in ends
        )
        out[:, row] = (high - low) / width
    return out


def samples(
    right: np.ndarray, down: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return where a panorama (rows, cols) has the directions of an angular projection.

    Parameters
    ----------
    right, down : ndarray
        Places in the angular projection, rad off the optical axis.
    shape : (int, int)
        The panorama's.

    Returns
    -------
    (ndarray, ndarray)
        Rows and columns, counted from the panorama's upper left corner.

    Raises
    ------
    UserError
        Where it is not twice as wide as high.
    """
    rows, cols = shape
    if cols != 2 * rows:
        raise UserError(
            "no panorama of 360 x 180 degrees",
            field="projection",
            value=f"equirectangular, {cols} x {rows} samples",
            allowed="twice as many columns as rows",
        )
    theta = np.hypot(right, down)
    sinc = np.sinc(theta / np.pi)  # sin(theta) / theta
    longitude = np.arctan2(right * sinc, np.cos(theta))
    latitude = np.arcsin(np.clip(down * sinc, -1, 1))
    return (latitude / np.pi + 0.5) * rows, (longitude / (2 * np.pi) + 0.5) * cols


def by_angle(panorama: np.ndarray) -> np.ndarray:
    """Return a panorama in the angular projection (azimuthal equidistant), all of it.

    Parameters
    ----------
    panorama : ndarray (M, rows, 2 rows)
        Equirectangular; row 0 is up, column 0 the left half of what lies behind the camera. None
        negative.

    Returns
    -------
    ndarray (M, 2 rows, 2 rows), float32
        Samples as far apart as the panorama's rows, from -180 to 180 degrees off the optical axis
        both ways; linear between the panorama's samples, so that none is negative. Beyond 180
        degrees there is nothing: 0.

    Raises
    ------
    UserError
        Where the panorama is not twice as wide as high.
    """
    from scipy.ndimage import map_coordinates

    _, rows, cols = panorama.shape
    at = np.pi * ((np.arange(cols) + 0.5) / rows - 1)
    right, down = np.meshgrid(at, at)
    theta = np.hypot(right, down)
    row, col = samples(right, down, (rows, cols))
    # Across a pole the row goes on half a turn away; from the last column to the first.
    whole = widened(panorama)
    whole = np.concatenate(
        [np.roll(whole[:, :1], rows, 2), whole, np.roll(whole[:, -1:], rows, 2)], axis=1
    )
    places = [row + 0.5, col - 0.5]
    planes = [map_coordinates(plane, places, order=1, mode="grid-wrap") for plane in whole]
    return np.where(theta <= np.pi, planes, 0.0).astype(np.float32)
