"""The digital numbers of a raw by the colour of their filters."""

from __future__ import annotations

import numpy as np

from gpusim.sensor.cfa import CFA_LETTERS
from gpusim.sensor.sensor import Sensor


def channel_values(
    lit: np.ndarray, sensor: Sensor, first: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Return the numbers of each filter colour, by its letter.

    Parameters
    ----------
    lit : ndarray (rows, cols)
        Pixels that see light.
    sensor : Sensor
    first : (int, int)
        Row and column of the first of them on the sensor.
    """
    letters = np.array([list(line) for line in sensor.cfa.letters])
    high, wide = letters.shape
    there = [str(one) for one in CFA_LETTERS if one in letters]
    found: dict[str, list[np.ndarray]] = {one: [] for one in there}
    for down, across in np.ndindex(high, wide):
        letter = letters[(first[0] + down) % high, (first[1] + across) % wide]
        found[letter].append(lit[down::high, across::wide].ravel())
    return {letter: np.concatenate(parts) for letter, parts in found.items()}
