"""Float64 twin of the traps stage: the occupancy of the traps over the volume, kept whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def traps(
    charge: np.ndarray,
    species: Sequence[tuple[float, float]],
    *,
    well_fill_power: float,
    well_e: float,
    notch_e: float = 0.0,
    groups: int | None = None,
    before: int = 0,
    overscan: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return what arrives at the read-out along the first axis, and what is still trapped.

    Parameters
    ----------
    charge : ndarray (packets, lines)
        Electrons; packet 0 lies next to the read-out.
    species : sequence of (density, release_transfers)
    well_fill_power, well_e, notch_e : float
        Parameters of the volume ((n - notch) / (well - notch))^power that n electrons fill.
    groups : int, optional
        Groups of sites, which packets pass at once; without it, each site is passed by itself.
    before : int
        Sites between packet 0 and the read-out.
    overscan : int
        Last packets that have no site of their own; below 0, sites beyond the last packet.

    Returns
    -------
    arrived : ndarray (packets, lines)
    trapped : ndarray (lines,)
    """
    arrived = np.array(charge, np.float64)
    sites = before + len(arrived) - overscan
    groups = groups or sites
    density, release = np.array(species, np.float64).T
    kept = np.exp(-1 / release)
    lines = arrived.shape[1]
    trapped = np.zeros(lines)
    for group in reversed(range(groups)):
        first, end = group * sites // groups, (group + 1) * sites // groups
        # Slabs of the volume, by line and upwards: their upper edges, and what is held in all sites
        # of the group, by density. Slabs of no height are none.
        top = np.ones((lines, 1))
        held = np.zeros((lines, 1, len(density)))
        for packet in range(max(first - before, 0), len(arrived)):
            passed = min(packet + before + 1, end) - first
            released = _electrons(top, held * (1 - kept), density)
            held = held * kept
            # The cloud half-way through: after (passed + 1) / 2 of the releases.
            seen = arrived[packet] + released * (passed + 1) / (2 * passed)
            free = arrived[packet] + released
            fill = np.clip((seen - notch_e) / (well_e - notch_e), 0, 1) ** well_fill_power
            # The slab in which the cloud ends becomes two.
            at = (top < fill[:, None]).sum(axis=1)[:, None]
            slab = np.arange(top.shape[1] + 1)
            whole = slab - (slab > at)
            top = np.take_along_axis(top, whole, axis=1)
            held = np.take_along_axis(held, whole[..., None], axis=1)
            np.put_along_axis(top, at, fill[:, None], axis=1)
            room = np.where((slab <= at)[..., None], passed - held, 0.0)
            wanted = _electrons(top, room, density)
            share = np.ones(lines)
            np.divide(free, wanted, out=share, where=(free < wanted) & (wanted > 0))
            share = np.maximum(share, 0)
            held += share[:, None, None] * room
            arrived[packet] = free - share * wanted
            # Where all traps are filled, the slabs up to the cloud's end are one.
            top = np.where((slab < at) & (share == 1)[:, None], 0.0, top)
            used = int((top > 0).argmax(axis=1).min())
            top, held = top[:, used:], held[:, used:]
        trapped += _electrons(top, held, density)
    return arrived, trapped


def _electrons(top: np.ndarray, held: np.ndarray, density: np.ndarray) -> np.ndarray:
    """Return the electrons (lines,) in slabs of so much volume."""
    return (np.diff(top, axis=1, prepend=0.0)[..., None] * held * density).sum(axis=(1, 2))
