"""Float64 twin of the bloom stage: flows along a column as queues, in closed form."""

from __future__ import annotations

import numpy as np


def bloom(
    charge: np.ndarray, full_well_e: float, photosites: slice = slice(None)
) -> tuple[np.ndarray, np.ndarray]:
    """Return the charge (rows, cols) after blooming, and what left (2, cols) at row 0 and the end.

    With x what a photosite adds to a flow less its room, the flow behind it is max(flow + x, 0): it
    is that of a queue, S - min(0, min S) over all sums S of x so far (Lindley 1952, "The theory of
    queues with a single server", eq. 1).

    Parameters
    ----------
    charge : ndarray (rows, cols)
        Electrons.
    full_well_e : float
    photosites : slice
        The rows that hold photosites.
    """
    held = np.array(charge, np.float64)
    inner = held[photosites]
    excess = np.maximum(inner - full_well_e, 0)
    inner -= excess
    left = np.zeros((2, held.shape[1]))
    halves = np.floor(excess / 2)
    for end, way, parts in ((1, slice(None), excess - halves), (0, slice(None, None, -1), halves)):
        given, room = parts[way], (full_well_e - inner)[way]
        sums = np.cumsum(given - room, axis=0)
        flow = sums - np.minimum(np.minimum.accumulate(sums), 0)
        arriving = np.zeros_like(flow)
        arriving[1:] = flow[:-1]
        inner[way] += arriving + given - flow
        left[end] = flow[-1]
    return held, left
