"""Float64 twin of quad Bayer made into Bayer: photosite by photosite, from the equations."""

from __future__ import annotations

import numpy as np

CELL, PERIOD = 2, 4  # photosites along a cell of one filter, and along the pattern
REACH = 4  # photosites from which on a colour difference does not count
FLAT = 0.002  # of saturation: differences below say nothing of where an edge runs


def binned(signal: np.ndarray, phase: tuple[int, int]) -> np.ndarray:
    """Return the sums over the whole cells, the first of which begins at a row and column."""
    rows, cols = ((n - first) // CELL for n, first in zip(signal.shape, phase, strict=True))
    sums = np.zeros((rows, cols))
    for row, col in np.ndindex(rows, cols):
        for down, across in np.ndindex(CELL, CELL):
            sums[row, col] += signal[phase[0] + CELL * row + down, phase[1] + CELL * col + across]
    return sums


class Remosaic:
    """A quad Bayer frame, and what a Bayer array would have seen in its place.

    Parameters
    ----------
    signal : ndarray (rows, cols)
        Above black.
    pattern : tuple of str
        Rows of the filter pattern, from the first photosite.
    phase : (int, int)
        Row and column at which the first whole cell begins.
    white : dict of str to float
        What white makes in each colour, the largest 1.
    span : float
        The signal at saturation.
    """

    def __init__(
        self,
        signal: np.ndarray,
        pattern: tuple[str, ...],
        phase: tuple[int, int],
        *,
        white: dict[str, float],
        span: float,
    ) -> None:
        self.signal, self.pattern, self.phase = np.asarray(signal, float), pattern, phase
        self.white, self.flat = white, (FLAT * span) ** 2

    def site(self, row: int, col: int) -> str:
        """Return the filter of a photosite, which may lie outside the frame."""
        return self.pattern[row % PERIOD][col % PERIOD]

    def wanted(self, row: int, col: int) -> str:
        """Return the filter there of a Bayer array: each cell's in place of a photosite's."""
        down, across = ((n - first) % CELL for n, first in zip((row, col), self.phase, strict=True))
        return self.site(self.phase[0] + CELL * down, self.phase[1] + CELL * across)

    def balanced(self, row: int, col: int) -> float:
        """Return the signal over the white's; outside, that of the rim's period goes on."""
        at = []
        for place, count in zip((row, col), self.signal.shape, strict=True):
            while place < 0:
                place += PERIOD
            while place >= count:
                place -= PERIOD
            at.append(place)
        return self.signal[tuple(at)] / self.white[self.site(row, col)]

    def green(self, row: int, col: int) -> float:
        """Return green: a photosite's own, or by lines through it, weighed by how little they vary.

        On a line the next cell on one side begins one photosite off, on the other side two.
        """
        if self.site(row, col) == "G":
            return self.balanced(row, col)
        values, weights = [], []
        for axis, place in enumerate((row, col)):
            towards = -1 if (place - self.phase[axis]) % CELL == 0 else 1
            near, far = (
                self.balanced(row + off * (axis == 0), col + off * (axis == 1))
                for off in (towards, -2 * towards)
            )
            values.append(near + (far - near) / 3)
            weights.append(1 / ((near - far) ** 2 + self.flat))
        return float(np.average(values, weights=weights))

    def difference(self, row: int, col: int, colour: str) -> float:
        """Return a colour's difference to green: the mean by a tent over its photosites."""
        total = weights = 0.0
        for down, across in np.ndindex(2 * REACH - 1, 2 * REACH - 1):
            y, x = row + down - REACH + 1, col + across - REACH + 1
            if self.site(y, x) == colour:
                weight = (REACH - abs(y - row)) * (REACH - abs(x - col))
                total += weight * (self.balanced(y, x) - self.green(y, x))
                weights += weight
        return total / weights

    def at(self, row: int, col: int) -> float:
        """Return the signal of the Bayer array at a place."""
        wanted = self.wanted(row, col)
        if wanted == self.site(row, col):
            return self.signal[row, col]
        found = self.green(row, col)
        if wanted != "G":
            found += self.difference(row, col, wanted)
        return found * self.white[wanted]
