"""ICC profiles of the spaces that pictures are developed into.

Matrix profiles of version 4 (ICC.1:2022): primaries and white adapted to D50 by Bradford (annex E),
and the curve as a parametric one (10.18). Equal spaces give equal bytes.
"""

from __future__ import annotations

import hashlib
import struct

import numpy as np

from gpusim.isp.transfer import SPACES, Space, Transfer
from gpusim.scene.colorimetry import adaptation, rgb_to_xyz

VERSION = 0x04400000
# D50 of the connection space to the digits of s15Fixed16 numbers (7.2.16).
D50 = np.array([0xF6D6, 0x10000, 0xD32D]) / 65536
MADE = (2024, 1, 1, 0, 0, 0)  # a date that does not change with the day
ONE_LINE = 12  # bytes of a record of a multi-localised text, and of an entry of the tag table
HEADER = 128


def profile(name: str) -> bytes:
    """Return the ICC profile of a space, by its name in `gpusim.isp.transfer.SPACES`."""
    space = SPACES[name]
    columns, chad = _adapted(space)
    curve = _curve(space.transfer)
    tags = {
        b"desc": _text(space.title),
        b"cprt": _text("No copyright, use freely"),
        b"wtpt": _numbers(b"XYZ ", D50),
        b"chad": _numbers(b"sf32", chad.ravel()),
        **{
            name: _numbers(b"XYZ ", column)
            for name, column in zip((b"rXYZ", b"gXYZ", b"bXYZ"), columns.T, strict=True)
        },
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve),
    }
    place = HEADER + 4 + ONE_LINE * len(tags)
    table, data, places = b"", b"", {}
    for name, content in tags.items():
        if content not in places:
            places[content] = place + len(data)
            data += content + bytes(-len(content) % 4)
        table += struct.pack(">4s2I", name, places[content], len(content))
    size = place + len(data)
    body = struct.pack(">I", len(tags)) + table + data
    # The identifier is that of the profile without flags, intent and itself (7.2.18).
    digest = hashlib.md5(_header(size, bytes(16)) + body, usedforsecurity=False).digest()
    return _header(size, digest) + body


def _adapted(space: Space) -> tuple[np.ndarray, np.ndarray]:
    """Return the primaries' XYZ under D50, a column each, and the matrix that adapts to it."""
    to_xyz = rgb_to_xyz(space.chromaticities)
    chad = adaptation(to_xyz.sum(axis=1), D50)
    columns = np.round(65536 * chad @ to_xyz)
    # Rounded, the three are to give the white again: the middle of each row takes what is left.
    columns[:, 1] += np.round(65536 * D50) - columns.sum(axis=1)
    return columns / 65536, chad


def _header(size: int, digest: bytes) -> bytes:
    return struct.pack(
        ">I4sI4s4s4s6H4s4sI4sIQI3i4s16s28x",
        size,
        bytes(4),
        VERSION,
        b"mntr",
        b"RGB ",
        b"XYZ ",
        *MADE,
        b"acsp",
        bytes(4),
        0,
        bytes(4),
        0,
        0,
        0,
        *_fixed(D50),
        bytes(4),
        digest,
    )


def _curve(transfer: Transfer | None) -> bytes:
    """Return the curve from stored values to light: y = (a x + b)^g above d, c x below."""
    if transfer is None:
        kind, numbers = 0, (1.0,)
    else:
        scale = 1 + transfer.offset
        numbers = (
            1 / transfer.power,
            1 / scale,
            transfer.offset / scale,
            1 / transfer.slope,
            transfer.slope * transfer.cut,
        )
        kind = 3
    return struct.pack(f">4s4xH2x{len(numbers)}i", b"para", kind, *_fixed(numbers))


def _numbers(kind: bytes, values: np.ndarray) -> bytes:
    return struct.pack(f">4s4x{len(values)}i", kind, *_fixed(values))


def _fixed(values: np.ndarray | tuple[float, ...]) -> list[int]:
    """Return numbers as s15Fixed16."""
    return [round(65536 * float(value)) for value in values]


def _text(text: str) -> bytes:
    """Return a multi-localised text of one language."""
    content = text.encode("utf-16-be")
    head = struct.pack(">4s4x2I2s2s2I", b"mluc", 1, ONE_LINE, b"en", b"US", len(content), 28)
    return head + content
