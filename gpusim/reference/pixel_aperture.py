"""The aperture of a pixel, as rectangles with a response, for the sums of the exact model."""

from __future__ import annotations

from typing import Any

import numpy as np

MOTION_ORDER = 4  # nodes along a motion over the pixel, and as many more for each um

# Ends in x and y of a rectangle, um from the pixel's middle, and its response.
Box = tuple[float, float, float, float, float]


def side_um_of(sensor: Any) -> float:
    """Return the side of a square as large as the aperture."""
    return sensor.pixel_pitch_um * np.sqrt(sensor.fill_factor)


def boxes_of(sensor: Any) -> list[Box]:
    """Return ends in x and y of rectangles, um from the pixel's middle, and their response.

    The response is such that its integral over the pixel is the fill factor's area. Where the
    image moves over the pixel, it sees as from many places on the way, by Gauss-Legendre.
    """
    pitch, side_um = sensor.pixel_pitch_um, side_um_of(sensor)
    if sensor.aperture is None:
        edge = side_um / 2
        boxes = [(-edge, edge, -edge, edge, 1.0)]
    elif sensor.aperture.rectangles is not None:
        boxes = [
            (*(pitch * (at - 0.5) for at in (r.x, r.x + r.width, r.y, r.y + r.height)), 1.0)
            for r in sensor.aperture.rectangles
        ]
    else:
        cells = np.array(sensor.aperture.map, np.float64)
        x, y = (np.linspace(-pitch / 2, pitch / 2, count + 1) for count in cells.shape[::-1])
        boxes = [
            (x[col], x[col + 1], y[row], y[row + 1], cells[row, col])
            for row, col in np.argwhere(cells)
        ]
    whole = sum((x1 - x0) * (y1 - y0) * one for x0, x1, y0, y1, one in boxes)
    boxes = [(*ends, one * side_um**2 / whole) for *ends, one in boxes]
    if sensor.scan_motion_px is None:
        return boxes
    mx, my = (pitch * one for one in sensor.scan_motion_px)
    nodes, weights = np.polynomial.legendre.leggauss(
        MOTION_ORDER + int(MOTION_ORDER * np.hypot(mx, my))
    )
    return [
        (x0 + at * mx, x1 + at * mx, y0 + at * my, y1 + at * my, one * share)
        for at, share in zip(nodes / 2, weights / 2, strict=True)
        for x0, x1, y0, y1, one in boxes
    ]


def points_in(boxes: list[Box], side_um: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return points (P, 2) of the aperture, so many across, and shares (P,) of its response."""
    line, share = np.polynomial.legendre.leggauss(order)
    nodes = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) / 2
    shares = np.outer(share, share).ravel() / 4
    places, parts = [], []
    for x0, x1, y0, y1, one in boxes:
        size = np.array([x1 - x0, y1 - y0])
        places.append(np.array([x0 + x1, y0 + y1]) / 2 + nodes * size)
        parts.append(shares * one * size.prod() / side_um**2)
    return np.concatenate(places), np.concatenate(parts)
