"""Float64 twin of the cti stage: every transfer made, one after the other."""

from __future__ import annotations

import numpy as np


def cti(charge: np.ndarray, inefficiency: float, before: int = 0) -> np.ndarray:
    """Return what arrives at the read-out, packet by packet, along the first axis.

    In each transfer every packet leaves a fraction behind, which joins the packet after it.

    Parameters
    ----------
    charge : ndarray (packets, ...)
        Electrons; packet 0 lies ``before`` + 1 transfers from the read-out, the next one further.
    inefficiency : float
        Fraction left behind in each transfer.
    before : int
        Elements between packet 0 and the read-out.
    """
    packets = np.array(charge, np.float64)
    arrived = np.zeros_like(packets)
    # Packet k is read after before + 1 + k transfers.
    for transfer in range(before + len(packets)):
        left = inefficiency * packets
        packets -= left
        packets[1:] += left[:-1]
        k = transfer - before
        if k >= 0:
            arrived[k] = packets[k]
            # What this packet left behind in its last transfer has joined the next; it is gone.
            packets[k] = 0
    return arrived
