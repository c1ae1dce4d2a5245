"""A ColorChecker drawn by a camera with known matrices: patches as soft squares, turned, tilted."""

from __future__ import annotations

import numpy as np

SIZE = (300, 220)  # columns and rows
PITCH_PX = 36.0


def chart(
    rgb: np.ndarray, turn_deg: float = 5.0, tilt: float = 4e-4, back: float = 0.05
) -> np.ndarray:
    """Return a picture (rows, cols, channels) of 24 colours (24, channels) in reading order."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    x, y = x - SIZE[0] / 2, y - SIZE[1] / 2
    x, y = x / (1 + tilt * x), y / (1 + tilt * x)
    turn = np.radians(turn_deg)
    x, y = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    col, row = x / PITCH_PX + 3, y / PITCH_PX + 2
    # 1 within a patch, 0 in the frame around it, a pixel between.
    away = np.maximum(np.abs(col % 1 - 0.5), np.abs(row % 1 - 0.5))
    inside = np.clip((0.4 - away) * PITCH_PX + 0.5, 0, 1)
    on = (col >= 0) & (col < 6) & (row >= 0) & (row < 4)
    which = np.clip(row.astype(int), 0, 3) * 6 + np.clip(col.astype(int), 0, 5)
    share = (inside * on)[..., None]
    return share * rgb[which] + (1 - share) * back
