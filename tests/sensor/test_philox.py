"""The random generator: known answers, bit for bit against integers in NumPy, and its purposes.

Tolerances: none, integers are exact.
"""

import re

import numpy as np
import pytest
from harness import assert_close, wgsl_eval

from gpusim.gpu.wgsl import shaders_root
from gpusim.reference import philox as reference
from gpusim.sensor.philox import quads, words

# Random123, kat_vectors: philox4x32 10: counter, key, words.
KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((2**32 - 1,) * 4, (2**32 - 1,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]
EDGES = np.array([0, 1, 0xFFFF, 0x10000, 0x10001, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF])


def on_device(counter: np.ndarray, key: np.ndarray) -> np.ndarray:
    inputs = {"counter": ("vec4u", counter), "key": ("vec2u", key)}
    return wgsl_eval("philox", "philox(counter, key)", inputs, returns="vec4u")


@pytest.mark.parametrize("words_of", [on_device, reference.philox], ids=["device", "reference"])
def test_known_answers(words_of):
    counter, key, words = (np.array(column, np.uint32) for column in zip(*KNOWN, strict=True))
    assert_close(words_of(counter, key), words, atol=0)


def test_words_are_those_of_the_reference():
    rng = np.random.default_rng(1)
    counter = rng.integers(0, 2**32, (100_000, 4), dtype=np.uint32)
    key = rng.integers(0, 2**32, (100_000, 2), dtype=np.uint32)
    assert_close(on_device(counter, key), reference.philox(counter, key), atol=0)


def test_multiply_high_is_exact():
    rng = np.random.default_rng(2)
    a, b = (axis.ravel() for axis in np.meshgrid(EDGES, EDGES))
    a = np.append(a, rng.integers(0, 2**32, 10_000)).astype(np.uint32)
    b = np.append(b, rng.integers(0, 2**32, 10_000)).astype(np.uint32)
    high = wgsl_eval(
        "philox", "multiply_high(a, b)", {"a": ("u32", a), "b": ("u32", b)}, returns="u32"
    )
    assert_close(high, (a.astype(np.uint64) * b.astype(np.uint64)) >> np.uint64(32), atol=0)


def test_purposes_are_those_of_the_reference_and_all_unlike():
    text = (shaders_root() / "common" / "philox.wgsl").read_text()
    found = dict(re.findall(r"const PURPOSE_(\w+) = (0x[0-9A-F]+)u;", text))
    assert len(found) == text.count("const PURPOSE_") == len(set(found.values()))
    assert {name: int(value, 16) for name, value in found.items()} == {
        name: value << 16 for name, value in vars(reference).items() if name.isupper()
    }


def test_keys_are_split_into_words():
    assert words(0x123456789ABCDEF0) == (0x9ABCDEF0, 0x12345678)


@pytest.mark.parametrize(
    ("col0", "cols", "count"), [(0, 1, 1), (0, 4, 1), (0, 5, 2), (3, 1, 1), (3, 2, 2), (6, 6, 2)]
)
def test_quads_touched(col0: int, cols: int, count: int):
    assert quads(col0, cols) == count
