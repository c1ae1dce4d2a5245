"""Charge-transfer inefficiency, linear. Stage ``shaders/sensor/cti.wgsl``."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import gammaln

from gpusim.gpu import Array, Kernel, Recording

TAIL = 2.0**-32  # share of a packet that may be left out at either side, before it is given back


@lru_cache(maxsize=4)
def shares(elements: int, before: int, inefficiency: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of the packets that arrive with each packet.

    A packet that has n transfers to make, and leaves the fraction e behind in each, has made them
    all after n + d with the probability C(n - 1 + d, d) (1 - e)^n e^d: the negative binomial law.
    Its share arrives with the d-th packet after it. Seen from that one, with N = n + d to make,
    the law is binomial, (1 - e) C(N-1, d) (1 - e)^(N-1-d) e^d, as in Janesick 2001 ("Scientific
    Charge-Coupled Devices", chapter 5), and an even field stays even, at 1 - e. Sums of logarithms
    keep it exact for any n and e, and only the d that matter are taken: a band about n e / (1 - e).

    Parameters
    ----------
    elements : int
        Packets.
    before : int
        Elements between the first of them and the read-out.
    inefficiency : float

    Returns
    -------
    first : ndarray (elements,), uint32
        The least d of each packet that arrives.
    weights : ndarray (width, elements), float32
        Shares for d from there on, 0 where they do not matter; read-only, as is ``first``.
    """
    from scipy.stats import nbinom  # a third of a second of every start, for CCDs alone

    source = np.arange(elements)
    n = before + 1.0 + source
    kept = 1 - inefficiency
    low, high = nbinom.ppf(TAIL, n, kept), nbinom.isf(TAIL, n, kept)
    d = low + np.arange(int((high - low).max()) + 1)[:, None]
    logarithm = gammaln(n + d) - gammaln(d + 1) - gammaln(n)
    share = np.exp(logarithm + n * np.log1p(-inefficiency) + d * np.log(inefficiency))
    share[d > high] = 0
    share /= share.sum(axis=0)
    offset = d.astype(np.int64)
    target = source + offset
    used = (share > 0) & (target < elements)
    first = np.full(elements, elements)
    np.minimum.at(first, target[used], offset[used])
    last = np.zeros(elements, int)
    np.maximum.at(last, target[used], offset[used])
    first = np.minimum(first, last)  # packets with which nothing arrives
    weights = np.zeros(((last - first).max() + 1, elements), np.float32)
    weights[offset[used] - first[target[used]], target[used]] = share[used]
    first = first.astype(np.uint32)
    first.flags.writeable = weights.flags.writeable = False
    return first, weights


def record_cti(
    rec: Recording,
    charge: Array,
    inefficiency: float,
    *,
    serial: bool = False,
    before: int = 0,
    label: str = "arrived",
) -> Array:
    """Record what arrives at the read-out of whole columns, or of whole rows.

    Parameters
    ----------
    rec : Recording
    charge : Array (rows, cols), f32
        Electrons, with 0 for the overscan, where the last trails are read.
    inefficiency : float
        Fraction that each transfer leaves behind.
    serial : bool
        Along rows, towards column 0; else along columns, towards row 0.
    before : int
        Elements between the first packet and the read-out.
    label : str
        Label of the buffer that is returned.

    Returns
    -------
    Array (rows, cols), f32
        Electrons: the mean of what arrives.
    """
    rows, cols = charge.shape
    first, weights = shares(cols if serial else rows, before, inefficiency)
    arrived = rec.buffer(label, charge.shape, "f4")
    tables = {}
    for name, table in (("first", first), ("weights", weights)):
        tables[name] = rec.buffer(f"{label} {name}", table.shape, table.dtype)
        rec.upload(tables[name], table)
    kernel = Kernel("sensor/cti", SERIAL=serial)
    params = {"rows": rows, "cols": cols, "width": len(weights)}
    groups = (-(-cols // 64), -(-rows // 4), 1) if serial else (-(-cols // 256), rows, 1)
    kernel.record(rec, groups, params, charge=charge, **tables, arrived=arrived)
    return arrived
