"""How the sensor stages address the random generator (``shaders/common/philox.wgsl``)."""

from __future__ import annotations


def words(number: int) -> tuple[int, int]:
    """Return the low and high 32-bit word of a 64-bit key."""
    return number & 0xFFFFFFFF, number >> 32


def quads(col0: int, cols: int) -> int:
    """Return how many aligned groups of four pixels hold ``cols`` pixels from ``col0`` on."""
    return -(-(col0 % 4 + cols) // 4)
