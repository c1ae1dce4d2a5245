"""Text and numbers of other programs' lens files: decoded and read, never evaluated."""

from __future__ import annotations

import math


def decoded(content: bytes) -> str:
    """Return the text of a file: UTF-16 (with or without byte-order mark), UTF-8 or ANSI.

    Design programs write UTF-16 or the code page of Western Windows; neither says which it is.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", errors="replace")
    if content[:1] == b"\x00":
        return content.decode("utf-16-be", errors="replace")
    if b"\x00" in content[:64]:
        return content.decode("utf-16-le", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def finite(word: str) -> float:
    """Return a number.

    Raises
    ------
    ValueError
        Where the word is none, or infinite, or not a number by name.
    """
    # Python also takes 1_000, which no lens file means; Fortran's exponent D is one.
    value = float(word.replace("_", "?").upper().replace("D", "E"))
    if not math.isfinite(value):
        raise ValueError(f"{word} is not finite")
    return value
