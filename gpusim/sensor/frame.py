"""The frame that a sensor reads out: the lit pixels, and what lies around them.

All rectangles are (row, col, rows, cols), counted from the first lit pixel: what lies above it or
to its left has negative numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field, model_validator

from gpusim.config.model import Strict, wrong

MAX_BORDER = 4096  # pixels

Rect = tuple[int, int, int, int]


class Border(Strict):
    """Rows and columns around the lit pixels.

    Attributes
    ----------
    top, bottom, left, right : int
        Pixels.
    """

    top: int = Field(default=0, ge=0, le=MAX_BORDER)
    bottom: int = Field(default=0, ge=0, le=MAX_BORDER)
    left: int = Field(default=0, ge=0, le=MAX_BORDER)
    right: int = Field(default=0, ge=0, le=MAX_BORDER)

    @model_validator(mode="after")
    def _some(self) -> Border:
        if not any((self.top, self.bottom, self.left, self.right)):
            raise wrong("the border has no pixels", "top, bottom, left or right above 0; or leave")
        return self

    def around(self, rect: Rect) -> Rect:
        """Return a rectangle with this border around it."""
        row, col, rows, cols = rect
        return (
            row - self.top,
            col - self.left,
            rows + self.top + self.bottom,
            cols + self.left + self.right,
        )


class Overscan(Strict):
    """What is read after the last row and column of pixels: packets that were never exposed.

    Attributes
    ----------
    rows, cols : int
    """

    rows: int = Field(default=0, ge=0, le=MAX_BORDER)
    cols: int = Field(default=0, ge=0, le=MAX_BORDER)


@dataclass(frozen=True)
class Frame:
    """The areas of a frame, each within the next.

    Attributes
    ----------
    lit : Rect
        The pixels that see light.
    pixels : Rect
        All that collect charge: with the optical black, which is shielded from light.
    read : Rect
        All that is read out.
    """

    lit: Rect
    pixels: Rect
    read: Rect

    def on_chip(self, rect: Rect) -> tuple[int, int]:
        """Return where a rectangle begins, counted from the first pixel that is read: never < 0."""
        return rect[0] - self.read[0], rect[1] - self.read[1]


def overlap(rect: Rect, other: Rect) -> Rect:
    """Return what two rectangles share; without rows or columns where they share nothing."""
    first = [max(rect[axis], other[axis]) for axis in (0, 1)]
    last = [min(rect[axis] + rect[axis + 2], other[axis] + other[axis + 2]) for axis in (0, 1)]
    rows, cols = (max(end - begin, 0) for begin, end in zip(first, last, strict=True))
    return first[0], first[1], rows, cols


def parts_around(lit: Rect, frame: Rect) -> list[Rect]:
    """Return the rectangles that make a frame of the one within it: above, below, left, right."""
    row, col, rows, cols = frame
    top, left = lit[0] - row, lit[1] - col
    below, right = top + lit[2], left + lit[3]
    parts = [
        (row, col, top, cols),
        (row + below, col, rows - below, cols),
        (lit[0], col, lit[2], left),
        (lit[0], col + right, lit[2], cols - right),
    ]
    return [part for part in parts if part[2] and part[3]]


@dataclass(frozen=True)
class Areas:
    """Which pixels of a raw see light.

    Attributes
    ----------
    lit : Rect
        These, counted from the first lit pixel of the sensor.
    active : Rect
        Where they lie in the raw.
    masked : tuple of Rect
        Where pixels shielded from light lie in the raw.
    """

    lit: Rect
    active: Rect
    masked: tuple[Rect, ...]


def areas_of(rect: Rect, frame: Frame) -> Areas:
    """Return which pixels of a raw, a rectangle of all that is read, see light."""
    lit = overlap(rect, frame.lit)
    shielded = parts_around(lit, overlap(rect, frame.pixels))
    row, col = rect[:2]
    first_row, first_col, *size = lit
    return Areas(
        lit,
        (first_row - row, first_col - col, *size),
        tuple((one[0] - row, one[1] - col, *one[2:]) for one in shielded),
    )
