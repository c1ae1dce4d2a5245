"""Tiles and strips: that they cover a rectangle once, meet between filter patterns, and fit."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.gpu.pool import MAX_BINDING_BYTES
from gpusim.plan.tiles import (
    SMALLEST_PX,
    STRIP_PLANES,
    Rect,
    aligned,
    enclosing,
    halves,
    strip_bytes,
    strips,
    tile_bytes,
    tiles_of,
)

MIB = 1 << 20
RECTS = [(0, 0, 96, 128), (3, 5, 200, 333), (0, 0, 3040, 4056), (7, 0, 1, 4000), (2, 9, 999, 1)]


def assert_cover(parts: list[Rect], rect: Rect) -> None:
    """Check that each pixel of a rectangle lies in one of its parts, and no other pixel does."""
    row, col, rows, cols = rect
    seen = np.zeros((rows, cols), np.uint8)
    for first_row, first_col, height, width in parts:
        assert height > 0 and width > 0 and first_row >= row and first_col >= col
        seen[first_row - row :, first_col - col :][:height, :width] += 1
        assert first_row + height <= row + rows and first_col + width <= col + cols
    assert (seen == 1).all()


@pytest.mark.parametrize("period", [1, 2, 4])
@pytest.mark.parametrize("rect", RECTS)
def test_tiles_cover_a_rectangle_and_meet_between_patterns(rect: Rect, period: int):
    for given in ((256 * MIB, 37), (16 * MIB, None), (1024 * MIB, None)):
        tiles = tiles_of(rect, period, *given)
        assert_cover(tiles, rect)
        for row, col, height, width in tiles:
            assert row == rect[0] or row % period == 0
            assert col == rect[1] or col % period == 0
            if given[1]:
                assert max(height, width) <= 37


@pytest.mark.parametrize("megapixels", [1, 12, 48, 100])
@pytest.mark.parametrize("budget", [64 * MIB, 256 * MIB, 1024 * MIB])
def test_the_planes_of_a_tile_do_not_grow_with_the_frame(megapixels: int, budget: int):
    rows, cols = round(np.sqrt(megapixels * 0.75e6)), round(np.sqrt(megapixels / 0.75 * 1e6))
    tiles = tiles_of((0, 0, rows, cols), 2, budget)
    largest = max(tile_bytes(tile, 2) for tile in tiles)
    # Half as much again, where the classes of the pool are that far apart.
    assert largest <= min(1.5 * budget / 8, MAX_BINDING_BYTES)
    # As few as that allows, or nearly: a quarter full at least, where there are several.
    assert len(tiles) == 1 or len(tiles) <= 4 * rows * cols * 4 / (budget / 8)


def test_a_frame_of_48_megapixels_is_cut_into_wide_tiles_of_equal_height():
    tiles = tiles_of((0, 0, 6000, 8000), 2, 1024 * MIB)
    assert tiles == [(0, 0, 3000, 8000), (3000, 0, 3000, 8000)]


def test_halves_are_cut_between_patterns_down_to_the_smallest_tile():
    rects = [(3, 5, 200, 333)]
    seen = 0
    while rects:
        rect = rects.pop()
        parts = halves(rect, 4)
        if parts:
            assert_cover(parts, rect)
            assert parts[1][0] % 4 == 0 or parts[1][0] == rect[0]
            assert parts[1][1] % 4 == 0 or parts[1][1] == rect[1]
            rects += parts
        else:
            seen += 1
            assert max(rect[2:]) <= SMALLEST_PX
    assert seen > 15


@pytest.mark.parametrize("rect", RECTS)
def test_strips_take_the_memory_that_is_counted_for_them(rect: Rect):
    for budget in (MIB, 64 * MIB, 1024 * MIB):
        parts = strips(rect, budget)
        assert_cover(parts, rect)
        counted = strip_bytes(rect, budget)
        assert all(STRIP_PLANES * 4 * height * width <= counted for _, _, height, width in parts)
        # A sixteenth, with the classes of the pool, or a single row.
        assert counted <= 1.5 * budget / 16 or {part[2] for part in parts} == {1}


def test_the_rectangle_around_others_is_the_smallest_that_holds_them():
    assert enclosing([(3, 5, 1, 2)]) == (3, 5, 1, 2)
    assert enclosing([(3, 5, 1, 2), (-2, 6, 3, 8), (0, 4, 9, 1)]) == (-2, 4, 11, 10)


def test_a_rectangle_grows_to_whole_patterns():
    assert aligned((3, 5, 1, 2), 2) == (2, 4, 2, 4)
    assert aligned((4, 6, 2, 2), 2) == (4, 6, 2, 2)
    assert aligned((0, 0, 5, 5), 1) == (0, 0, 5, 5)
    assert tile_bytes((3, 5, 1, 2), 2) == 256
