"""What opcodes of a DNG undo, read; damaged lists."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusim.isp.opcodes import corrections, walk
from gpusim.isp.rectify import Rectification
from gpusim.isp.shading import Shading

SHADING = Shading((0.4, 0.25, -0.1, 0.05, 0.02), (0.47, 0.55))
MAP = (1.01, 0.02, -0.01, 0.001, 1e-4, -2e-4)


def opcode(number: int, data: bytes) -> bytes:
    return struct.pack(">4I", number, 0x01030000, 1, len(data)) + data


GAIN = opcode(3, struct.pack(">7d", *SHADING.k, *SHADING.axis))
WARP = opcode(1, struct.pack(">I8d", 1, *MAP, 0.5, 0.4))
THREE = opcode(1, struct.pack(">I20d", 3, *MAP, *MAP, *MAP, 0.5, 0.4))
OTHER = opcode(9, bytes(76))


def listed(*opcodes: bytes) -> bytes:
    return struct.pack(">I", len(opcodes)) + b"".join(opcodes)


def test_both_are_found_among_others():
    assert corrections(listed(OTHER, GAIN, WARP)) == (SHADING, Rectification((MAP,), (0.5, 0.4)))
    assert corrections(listed(THREE))[1] == Rectification((MAP,) * 3, (0.5, 0.4))
    assert corrections(listed(OTHER)) == (None, None)
    # A gain after the distortion is of the picture, not of the raw's pixels.
    assert corrections(listed(WARP, GAIN))[0] is None
    assert [number for number, _ in walk(listed(OTHER, GAIN))] == [9, 3]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        listed(OTHER, GAIN)[:-9],
        listed(opcode(3, bytes(8))),
        listed(opcode(1, struct.pack(">I8d", 7, *MAP, 0.5, 0.4))),
        listed(opcode(1, struct.pack(">I8d", 0, *MAP, 0.5, 0.4))),
        listed(opcode(3, struct.pack(">7d", *[np.nan] * 7))),
    ],
)
def test_a_damaged_list_is_refused(content: bytes):
    with pytest.raises(ValueError, match="damaged"):
        corrections(content)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_list_or_an_error(content: bytes):
    try:
        corrections(content)
    except ValueError:
        return
