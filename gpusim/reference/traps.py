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
        Of the volume ((n - notch) / (well - notch))^power that n electrons fill.
    groups : int, optional
        Of sites, which packets pass at once; without it, each site is passed by itself.
    before : int
        Sites between packet 0 and the read-out.
    overscan : int
        Last packets that have no site of their own.

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
    trapped = np.zeros(arrived.shape[1])
    for line in range(arrived.shape[1]):
        for group in reversed(range(groups)):
            first, end = group * sites // groups, (group + 1) * sites // groups
            edges = np.array([0.0, 1.0])  # of the volume
            held = np.zeros((1, len(density)))  # between them: electrons in all sites, by density
            for packet in range(max(first - before, 0), len(arrived)):
                passed = min(packet + before + 1, end) - first
                width = np.diff(edges)[:, None]
                released = float((density * held * (1 - kept) * width).sum())
                held = held * kept
                # The cloud half-way through: after (passed + 1) / 2 of the releases.
                seen = arrived[packet, line] + released * (passed + 1) / (2 * passed)
                free = arrived[packet, line] + released
                fill = np.clip((seen - notch_e) / (well_e - notch_e), 0, 1) ** well_fill_power
                if fill > 0:
                    at = np.searchsorted(edges, fill)
                    if edges[at] != fill:
                        edges = np.insert(edges, at, fill)
                        held = np.insert(held, at, held[at - 1], axis=0)
                    room = passed - held[:at]
                    wanted = float((density * room * np.diff(edges)[:at, None]).sum())
                    share = min(1.0, free / wanted) if wanted > 0 else 1.0
                    held[:at] += share * room
                    free -= share * wanted
                    if share == 1:
                        edges, held = np.delete(edges, np.s_[1:at]), held[at - 1 :]
                arrived[packet, line] = free
            trapped[line] += float((density * held * np.diff(edges)[:, None]).sum())
    return arrived, trapped
