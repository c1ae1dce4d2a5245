"""Opcodes of DNG files (specification 1.4, chapter 7), read: one walk over a list of them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from gpusim.isp.lens_tags import FIX_VIGNETTE_RADIAL, WARP_RECTILINEAR
from gpusim.isp.rectify import Rectification
from gpusim.isp.shading import Shading

if TYPE_CHECKING:
    from collections.abc import Mapping

HEAD = 16  # bytes: number, version, flags, size
MOST_PLANES = 8


def walk(opcodes: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield number and parameters of each opcode of a list.

    Raises
    ------
    ValueError
        A list that is cut off.
    """
    try:
        (count,) = struct.unpack_from(">I", opcodes)
        place = 4
        for _ in range(count):
            number, _, _, size = struct.unpack_from(">4I", opcodes, place)
            if place + HEAD + size > len(opcodes):
                raise ValueError(f"a damaged list of opcodes: {number} is cut off")
            yield number, opcodes[place + HEAD : place + HEAD + size]
            place += HEAD + size
    except struct.error as error:
        raise ValueError(f"a damaged list of opcodes: {error}") from None


def corrections(opcodes: bytes) -> tuple[Shading | None, Rectification | None]:
    """Return the shading and the distortion that an OpcodeList3 undoes; None where it has none.

    A gain after the distortion is that of another picture than the one which the raw's pixels
    have: it is left out.

    Raises
    ------
    ValueError
        A damaged list, or numbers that are none.
    """
    shading, rectification = None, None
    for number, data in walk(opcodes):
        try:
            if number == FIX_VIGNETTE_RADIAL and rectification is None:
                *k, x, y = _finite(struct.unpack(">7d", data))
                shading = Shading(tuple(k), (x, y))
            elif number == WARP_RECTILINEAR:
                (planes,) = struct.unpack_from(">I", data)
                if not 1 <= planes <= MOST_PLANES:
                    raise ValueError(f"a damaged list of opcodes: maps of {planes} planes")
                *maps, x, y = _finite(struct.unpack_from(f">{6 * planes + 2}d", data, 4))
                rows = tuple(tuple(maps[at : at + 6]) for at in range(0, 6 * planes, 6))
                rectification = Rectification(rows, (x, y))
        except struct.error as error:
            raise ValueError(f"a damaged opcode {number}: {error}") from None
    return shading, rectification


def _finite(values: tuple[float, ...]) -> tuple[float, ...]:
    if not np.isfinite(values).all():
        raise ValueError("a damaged list of opcodes: numbers that are none")
    return values


def corrections_of(
    tags: Mapping[int, tuple[int, object]], tag: int
) -> tuple[Shading | None, Rectification | None]:
    """Return the same of a DNG's tags; ``tag``: the number of OpcodeList3."""
    if tag not in tags:
        return None, None
    return corrections(bytes(tags[tag][1]))
