"""Float64 twin of directional demosaicing's last stage."""

from __future__ import annotations

import numpy as np


def colours(
    light: np.ndarray, chosen: np.ndarray, refined: np.ndarray, along_row: np.ndarray
) -> np.ndarray:
    """Return red, green and blue at each pixel (3, rows, cols), of a frame that wraps around.

    Red is at even rows and columns, blue at odd ones; of the others only the sites of red and blue
    count (Menon, Andriani and Calvagno 2007, sections II-C and II-D).
    """
    even_row, even_col = (n % 2 == 0 for n in np.indices(light.shape))
    red, blue = even_row & even_col, ~even_row & ~even_col
    green = ~red & ~blue

    def beside(values: np.ndarray, axis: int) -> np.ndarray:
        return (np.roll(values, 1, axis) + np.roll(values, -1, axis)) / 2

    def red_less_blue(values: np.ndarray) -> np.ndarray:
        """Return it at green sites, of differences to green at the others."""
        rows, cols = beside(values, 1), beside(values, 0)
        return np.where(even_row, rows - cols, cols - rows)

    middle = np.where(green, light, light - refined)
    at_red = np.where(even_row, beside(refined, 1), beside(refined, 0))
    at_blue = np.where(even_row, beside(refined, 0), beside(refined, 1))
    first, second = red_less_blue(chosen), red_less_blue(refined)
    axes = [
        np.mean([beside(first, axis), np.roll(second, 1, axis), np.roll(second, -1, axis)], axis=0)
        for axis in (0, 1)
    ]
    contrast = np.where(along_row, axes[1], axes[0])
    full_red = np.where(red, light, np.where(green, light + at_red, light + contrast))
    full_blue = np.where(blue, light, np.where(green, light + at_blue, light - contrast))
    return np.stack([full_red, middle, full_blue])
