"""How stages that take samples one by one are dispatched: four to an invocation, on one line."""

from __future__ import annotations

from gpusim.gpu import Kernel

MOST_GROUPS = 65535  # along one axis (WebGPU)


def line(kernel: Kernel, samples: int) -> tuple[tuple[int, int, int], dict[str, int]]:
    """Return the workgroups for so many samples, a multiple of 4, and ``fours`` and ``wide``."""
    groups, _, _ = kernel.cover(samples // 4)
    along = min(groups, MOST_GROUPS)
    grid = (along, -(-groups // along) if along else 1, 1)
    return grid, {"fours": samples // 4, "wide": along * kernel.workgroup_size[0]}
