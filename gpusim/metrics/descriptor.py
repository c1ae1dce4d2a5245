"""The data sets of the EMVA 1288 working group: a text file that lists levels and their frames.

``EMVA1288_Data.txt`` has a line for each fact (release 3.0 and 3.1 of the standard's data sets)::

    v 3.0                        release of the layout
    n 12 640 480                 bits, columns and rows of the frames
    b 320000.0 961.0             a level of light: exposure time in ns, photons per pixel
    i images/b_001_snap_001.png  a frame of the level above
    d 320000.0                   a level in the dark: exposure time in ns

What follows a ``#`` is a comment. Names may have backslashes between folders.
"""

from __future__ import annotations

import math
import os
from pathlib import Path

from gpusim.config.text import read_text
from gpusim.errors import UserError
from gpusim.metrics.frames import MONOCHROME, Frames, Key, refuse_single

NAME = "EMVA1288_Data.txt"
FIELDS = {"v": 1, "n": 3, "b": 2, "d": 1, "i": 1}  # numbers or names of each kind of line
ALLOWED = "v RELEASE, n BITS COLUMNS ROWS, b NS PHOTONS, d NS, i FILE"


def find_descriptor(path: Path) -> Path | None:
    """Return the list of a data set in this layout: the file, or that of a folder; None if none."""
    if os.path.isdir(path):
        path = path / NAME
    return path if path.suffix.lower() == ".txt" and os.path.isfile(path) else None


def read_descriptor(listed: Path) -> Frames:
    """Read the list of a data set.

    Raises
    ------
    UserError
        A line that cannot be read, a frame that is missing or alone, or belongs to no level.
    """
    groups: dict[Key, list[Path]] = {}
    key: Key | None = None
    bits = None
    for number, line in enumerate(read_text(listed, "the list of frames").splitlines(), start=1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        kind, *rest = text.split(maxsplit=1)
        given = rest if kind == "i" else (rest[0].split() if rest else [])
        if kind not in FIELDS or len(given) != FIELDS[kind]:
            raise _unread(listed, number, text)
        if kind == "i":
            file = listed.parent.joinpath(*given[0].replace("\\", "/").split("/"))
            if key is None or not os.path.isfile(file):
                problem = "a frame is missing" if key else "a frame belongs to no level"
                raise UserError(problem, file=file, field=f"line {number} of {listed.name}")
            groups.setdefault(key, []).append(file)
            continue
        if kind == "v":
            continue
        values = _numbers(given)
        if values is None or (kind == "n" and not 1 <= values[0] <= 16):
            raise _unread(listed, number, text)
        if kind == "n":
            bits = int(values[0])
        else:
            key = values[0] * 1e-9, values[1] if kind == "b" else 0.0, None
    if not groups:
        raise UserError("there are no frames", file=listed, allowed=ALLOWED)
    refuse_single(groups)
    return Frames(listed.parent, listed.parent.resolve().name, MONOCHROME, groups, bits)


def _numbers(given: list[str]) -> list[float] | None:
    try:
        values = [float(one) for one in given]
    except ValueError:
        return None
    return values if all(0 <= one < math.inf for one in values) else None


def _unread(listed: Path, number: int, text: str) -> UserError:
    return UserError(
        "a line cannot be read", file=listed, field=f"line {number}", value=text, allowed=ALLOWED
    )
