"""Float64 twin of directional demosaicing's second stage."""

from __future__ import annotations

import numpy as np

# Weight of each step from a site to the next of its colour along the row, by where it begins:
# (rows down, columns right): Menon, Andriani and Calvagno 2007, section II-B.
STEPS = {
    (0, -2): 3, (0, 0): 3, (-2, -2): 1, (-2, 0): 1, (2, -2): 1, (2, 0): 1, (-1, -1): 1, (1, -1): 1,
}  # fmt: skip


def direction(differences: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how much more the differences change along the column than along the row, and those.

    Both results are (rows, cols), one value a pixel. The differences (rows, cols, 2) wrap around.
    The second result is the differences along the row where the first is not negative, else along
    the column.
    """
    along_row, along_col = differences[..., 0], differences[..., 1]

    def change(values: np.ndarray, axis: int) -> np.ndarray:
        step = np.abs(values - np.roll(values, -2, axis))
        total = np.zeros_like(step)
        for place, weight in STEPS.items():
            down, right = place if axis == 1 else place[::-1]
            total += weight * np.roll(step, (-down, -right), (0, 1))
        return total

    more = change(along_col, 0) - change(along_row, 1)
    return more, np.where(more >= 0, along_row, along_col)
