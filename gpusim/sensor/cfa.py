"""The colour filter array of a sensor: of which channel each photosite is."""

from __future__ import annotations

from itertools import chain

from pydantic import field_validator, model_validator

from gpusim.config.model import Strict, wrong
from gpusim.config.names import perhaps

# Red, green, blue, cyan, magenta, yellow, white (no filter): those that a DNG can name, in the
# order of TIFF/EP's CFAPattern (ISO 12234-2), in which red is 0 and white 6.
CFA_LETTERS = "RGBCMYW"
# By the names under which they are known; W is what RCCB and RCCC call C, clear.
PATTERNS = {
    "RGGB": ("RG", "GB"),
    "BGGR": ("BG", "GR"),
    "GRBG": ("GR", "BG"),
    "GBRG": ("GB", "RG"),
    "RCCB": ("RW", "WB"),
    "RCCC": ("RW", "WW"),
    "RGBW": ("RG", "BW"),
    "quad Bayer": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "X-Trans": ("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG"),
    "monochrome": ("W",),
}


Pattern = tuple[tuple[str, ...], ...]


class ColourFilterArray(Strict):
    """The filter pattern, from the upper left pixel: a channel for each photosite, row by row.

    A channel is a letter of :data:`CFA_LETTERS`, which is the colour of its filter, and may have
    more after it: Gr and Gb are green photosites of unlike response. A file may also give one of
    the names of :data:`PATTERNS`, in which C is clear: a photosite without a filter, W. The pattern
    alone may stand for all of it: ``cfa: RGGB``.

    Attributes
    ----------
    pattern : tuple of tuple of str
    shift_px : (float, float)
        x, y by which the filters lie to the right of their pixels, and below, pixels. What is
        loaded from a file has the mixtures that its pixels then see: see
        :func:`gpusim.sensor.misregistration.mixed`.
    """

    pattern: Pattern
    shift_px: tuple[float, float] = (0.0, 0.0)

    @model_validator(mode="before")
    @classmethod
    def _pattern_alone(cls, data: object) -> object:
        return {"pattern": data} if isinstance(data, str | list | tuple) else data

    @field_validator("pattern", mode="before")
    @classmethod
    def _by_name(cls, pattern: object) -> object:
        if not isinstance(pattern, str):
            return pattern
        if pattern not in PATTERNS:
            raise wrong(
                f"there is no pattern {pattern!r}{perhaps(pattern, PATTERNS)}",
                f"a table, or {', '.join(PATTERNS)}",
            )
        return [list(row) for row in PATTERNS[pattern]]

    @field_validator("shift_px")
    @classmethod
    def _within_a_pixel(cls, shift: tuple[float, float]) -> tuple[float, float]:
        if max(map(abs, shift)) > 1:
            raise wrong("the filters are shifted by more than a pixel", "x, y from -1 to 1 pixel")
        return shift

    @property
    def letters(self) -> list[list[str]]:
        """The pattern of the filters' colours."""
        return [[name[0] for name in row] for row in self.pattern]

    @field_validator("pattern")
    @classmethod
    def _rectangle_of_letters(cls, pattern: Pattern) -> Pattern:
        if not pattern or not pattern[0] or any(len(row) != len(pattern[0]) for row in pattern):
            raise wrong("the pattern is no rectangle", "rows of equal length: [[R, G], [G, B]]")
        for name in chain(*pattern):
            if name[:1] not in tuple(CFA_LETTERS):
                raise wrong(f"unknown filter colour {name!r}", ", ".join(CFA_LETTERS))
        return pattern
