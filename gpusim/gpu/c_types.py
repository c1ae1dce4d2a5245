"""How wgpu-py's C types are looked up: a fast way through cffi."""

from __future__ import annotations

import re
from typing import Any


def parse_few(ffi: Any) -> None:
    """Let a cffi interface parse, with each type that is named, only the types in its name.

    cffi parses a line for each of the 430 types that wgpu declares whenever one is named for the
    first time, which takes 25 ms, and a capture names 54. What a type is follows from the
    declarations as before; only which words are types is told, and no more than asked for. Without
    the parser that is known here (cffi 1.15 to 2.1) nothing changes.

    Parameters
    ----------
    ffi : cffi.FFI
        Once all is declared.
    """
    parser = getattr(ffi, "_parser", None)
    whole = getattr(parser, "_declarations", None)
    if not isinstance(whole, dict) or not callable(getattr(parser, "_parse", None)):
        return
    parse = parser._parse

    def parse_named(source: str) -> Any:
        named = {f"typedef {word}" for word in re.findall(r"\w+", source)}
        parser._declarations = {key: whole[key] for key in named & whole.keys()}
        try:
            return parse(source)
        finally:
            parser._declarations = whole

    parser._parse = parse_named
