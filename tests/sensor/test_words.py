"""How stages address the random generator: keys in words, pixels in groups of four."""

import pytest

from gpusim.sensor.words import quads, words


def test_keys_are_split_into_words():
    assert words(0x123456789ABCDEF0) == (0x9ABCDEF0, 0x12345678)


@pytest.mark.parametrize(
    ("col0", "cols", "count"), [(0, 1, 1), (0, 4, 1), (0, 5, 2), (3, 1, 1), (3, 2, 2), (6, 6, 2)]
)
def test_quads_touched(col0: int, cols: int, count: int):
    assert quads(col0, cols) == count
