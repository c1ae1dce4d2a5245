"""Float64 twin of the cti stage: every transfer made, one after the other."""

from __future__ import annotations

import numpy as np


def cti(charge: np.ndarray, inefficiency: float, before: int | np.ndarray = 0) -> np.ndarray:
    """Return what arrives at the read-out, packet by packet, along the first axis.

    In each transfer every packet leaves a fraction behind, which joins the packet after it.

    Parameters
    ----------
    charge : ndarray (packets, ...)
        Electrons; packet 0 lies ``before`` + 1 transfers from the read-out, the next one further.
    inefficiency : float
        Fraction left behind in each transfer.
    before : int or ndarray (...) of int
        Elements between packet 0 and the read-out, of all lines or of each. Where it is negative,
        so many packets are none, and must hold no charge.
    """
    packets = np.array(charge, np.float64)
    place = np.arange(len(packets)).reshape(-1, *[1] * (packets.ndim - 1))
    transfers = np.broadcast_to(place + before + 1, packets.shape)
    for transfer in range(transfers.max()):
        # A packet that was read leaves nothing more behind.
        left = np.where(transfer < transfers, inefficiency * packets, 0.0)
        packets -= left
        packets[1:] += left[:-1]
    return packets
