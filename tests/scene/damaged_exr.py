"""OpenEXR files of every compression, and what damage does to each part of them.

A file is (OpenEXR file layout): magic number, version, attributes (name, type, size, value), a 0,
the table of offsets of chunks, chunks (where they lie in the picture, size, data).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR

COMPRESSIONS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB")
ROWS, COLS, TILE = 40, 24, 16
HUGE = (0xFFFFFFFF, 0x7FFFFFFF, 0x80000000, 0)


@dataclass(frozen=True)
class Parts:
    """Where the parts of a file begin.

    Attributes
    ----------
    attributes : list of (str, int, int, int)
        Name, where the attribute begins, where its value does, and where that ends.
    offsets : range
        Where each entry of the table of offsets lies.
    chunks : list of int
        Where each chunk begins.
    """

    attributes: list[tuple[str, int, int, int]]
    offsets: range
    chunks: list[int]


def write_whole(at: Path, compression: str, tiled: bool, kind: type) -> Path:
    """Write a picture of noise on a ramp, whose samples no compression finds all alike."""
    ramp = np.linspace(0.1, 2, ROWS * COLS * 3).reshape(ROWS, COLS, 3)
    rgb = (ramp * np.random.default_rng(3).uniform(0.9, 1, ramp.shape)).astype(kind)
    header = {
        "compression": getattr(OpenEXR, f"{compression}_COMPRESSION"),
        "type": OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage,
        "whiteLuminance": 80.0,
        "chromaticities": (0.7, 0.29, 0.2, 0.8, 0.13, 0.05, 0.3127, 0.329),
    }
    if tiled:
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize = header["tiles"].ySize = TILE
    OpenEXR.File(header, {"RGB": rgb}).write(str(at))
    return at


def parts_of(content: bytes) -> Parts:
    """Return where the parts of a file of one part begin."""
    attributes, at = [], 8
    while content[at]:
        name_end = content.index(0, at)
        type_end = content.index(0, name_end + 1)
        value = type_end + 5
        (size,) = struct.unpack_from("<i", content, type_end + 1)
        attributes.append((content[at:name_end].decode(), at, value, value + size))
        at = value + size
    first = at + 1
    # The first chunk lies behind the table, and the table's smallest entry says where.
    (chunk,) = struct.unpack_from("<Q", content, first)
    offsets = range(first, chunk, 8)
    chunks = [struct.unpack_from("<Q", content, place)[0] for place in offsets]
    return Parts(attributes, offsets, chunks)


def damaged(content: bytes, header: bool) -> Iterator[tuple[str, bytes]]:
    """Yield what damage was done, and the file with it; to the attributes only with `header`."""
    parts = parts_of(content)
    yield from _cut(content, parts)
    for name, start, value, end in parts.attributes if header else ():
        # The sign of its name, its type, its size, and of each byte of its value.
        places = [start, start + len(name) + 1, *range(value - 4, min(end, value + 12))]
        for place in places:
            for bit in (0, 6, 7):
                yield f"{name}: bit {bit} of byte {place - start}", _flipped(content, place, bit)
        yield f"without {name}", content[:start] + content[end:]
        yield f"{name} twice", content[:start] + 2 * content[start:end] + content[end:]
    for number, place in enumerate(parts.offsets[:2]):
        other = parts.chunks[-1]
        for offset in (0, place, other, other + 1, len(content), 2**40, 2**63, 2**64 - 1):
            found = _put(content, place, struct.pack("<Q", offset))
            yield f"offset {number} is {offset}", found
    for number, chunk in enumerate(parts.chunks[:2]):
        for word in range(6):
            for given in HUGE:
                found = _put(content, chunk + 4 * word, struct.pack("<I", given))
                yield f"chunk {number}: word {word} is {given:#x}", found
        for place in range(chunk, min(chunk + 160, len(content)), 7):
            yield f"chunk {number}: byte {place - chunk}", _flipped(content, place, place % 8)


def _cut(content: bytes, parts: Parts) -> Iterator[tuple[str, bytes]]:
    ends = [0, 3, 7, 9, parts.offsets[0] - 1, parts.offsets[0] + 4, parts.offsets[-1] + 8]
    ends += [parts.chunks[0] + 6, parts.chunks[-1], parts.chunks[-1] + 9, len(content) - 1]
    for end in [*ends, *(middle for _, _, middle, _ in parts.attributes)]:
        yield f"cut at {end}", content[:end]


def _flipped(content: bytes, place: int, bit: int) -> bytes:
    return _put(content, place, bytes([content[place] ^ 1 << bit]))


def _put(content: bytes, place: int, part: bytes) -> bytes:
    return content[:place] + part + content[place + len(part) :]
