"""The one loader of YAML and JSON: plain data of bounded size, or one clear error.

YAML is read by the core schema of YAML 1.2 (https://yaml.org/spec/1.2.2/, section 10.3), in which
``1e-3`` is a number, and ``no``, ``012`` and ``2001-99-99`` are not what YAML 1.1 makes of them:
texts and the number twelve. Tags are refused: no file of ours needs one.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from gpusim.errors import UserError

# The events of YAML come 1 to 2 MB a second: a file of this size takes seconds. The largest of the
# package has 6 kB; what is larger than a table by hand is JSON, .csv or .nc.
MOST_YAML_BYTES = 4 << 20
MOST_JSON_BYTES = 256 << 20
MOST_TEXT_BYTES = 64 << 20  # tables and lists
MOST_VALUES = 1_000_000  # with every alias written out
DEEPEST = 32  # lists and mappings inside one another; a sensor file has 5
LONGEST_NUMBER = 64  # characters: no float64 needs more than 24

_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(
    r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
)
# Control characters, which move the cursor of a terminal, and halves of characters.
UNSEEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]")


class _Loader(_PARSER):
    """Scalars by the core schema."""

    yaml_implicit_resolvers: dict = {}  # noqa: RUF012 - as PyYAML declares it


def _construct_int(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    return int(node.value, {"0o": 8, "0x": 16}.get(node.value[:2], 10))


def _construct_float(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> float:
    return float(node.value.lower().replace(".inf", "inf").replace(".nan", "nan"))


_TAG = "tag:yaml.org,2002:"
for _name, _regexp, _first in (
    ("bool", re.compile(r"(?:true|True|TRUE|false|False|FALSE)$"), "tTfF"),
    ("int", re.compile(rf"(?:{_INT.pattern})$"), "-+0123456789"),
    ("float", re.compile(rf"(?:{_FLOAT.pattern})$"), "-+0123456789."),
    ("null", re.compile(r"(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
    ("merge", re.compile(r"<<$"), "<"),
):
    _Loader.add_implicit_resolver(_TAG + _name, _regexp, list(_first))
_Loader.add_constructor(f"{_TAG}int", _construct_int)
_Loader.add_constructor(f"{_TAG}float", _construct_float)


def read_bytes(path: Path, what: str, most: int = 1 << 30, allowed: str | None = None) -> bytes:
    """Return a file's content.

    Parameters
    ----------
    path : Path
    what : str
        What it should be: "the lens file".
    most : int
        Bytes that it may have.
    allowed : str, optional
        What would do in its place.

    Raises
    ------
    UserError
        It cannot be read, or is larger.
    """
    try:
        if path.exists() and not path.is_file():  # a device may never end, a pipe never begin
            raise UserError(f"{what} cannot be read: it is no file", file=path, allowed=allowed)
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in its name
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{what} cannot be read: {reason}", file=path, allowed=allowed) from error
    if len(content) > most:
        raise UserError(
            f"{what} is too large to be one", file=path, allowed=f"up to {most:,} bytes"
        )
    return content


def read_text(path: Path, what: str) -> str:
    """Return the text in a file, UTF-8; raise as `read_bytes` does, and where it is no text."""
    return _decoded(read_bytes(path, what, MOST_TEXT_BYTES), path, what)


def _decoded(content: bytes, path: Path, what: str) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{what} cannot be read: it is no text ({error.reason} at byte {error.start})",
            file=path,
            allowed="UTF-8",
        ) from error


def read_yaml(path: Path, what: str) -> object:
    """Return what a YAML file holds.

    Parameters
    ----------
    path : Path
    what : str
        What it should be: "the sensor file".

    Raises
    ------
    UserError
        It cannot be read, is no YAML, or more or deeper than any settings are; a key stands twice
        in one mapping; a text has control characters.
    """
    allowed = "a file of YAML: lines `field: value`, and lists"
    return yaml_of(read_bytes(path, what, MOST_YAML_BYTES, allowed), path, what)


def yaml_of(content: bytes, path: Path, what: str) -> object:
    """Return what the content of a YAML file holds; raise as `read_yaml` does."""
    text = _decoded(content, path, what)
    try:
        return parse_yaml(text)
    except ValueError as error:
        raise UserError(
            f"{what} is not YAML that can be read: {error}",
            file=path,
            allowed="lines `field: value`, and lists",
        ) from error


def read_mapping(path: Path, what: str) -> dict[str, object]:
    """Return the mapping in a YAML file; raise as `read_yaml` does, and where it is none."""
    data = read_yaml(path, what)
    if not isinstance(data, dict):
        raise UserError(
            f"{what} holds no fields with values",
            file=path,
            value="nothing" if data is None else type(data).__name__,
            allowed="lines `field: value`",
        )
    return data


def parse_yaml(text: str) -> object:
    """Return what a text of YAML holds.

    Raises
    ------
    ValueError
        As `read_yaml`; one line that says where.
    """
    try:
        _check_events(text)
        data = yaml.load(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        parts = [part for part in (error.context, error.problem) if part]
        raise ValueError(_at(error.problem_mark or error.context_mark, ", ".join(parts))) from error
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from error
    _check_texts(data)
    return data


def read_json(path: Path, what: str) -> object:
    """Return what a JSON file holds.

    Parameters
    ----------
    path : Path
    what : str
        What it should be: "the quantum efficiency".

    Raises
    ------
    UserError
        As `read_yaml`.
    """
    return json_of(read_bytes(path, what, MOST_JSON_BYTES, "a file of JSON"), path, what)


def json_of(content: bytes, path: Path, what: str) -> object:
    """Return what the content of a JSON file holds; raise as `read_yaml` does."""
    try:
        data = json.loads(
            _decoded(content, path, what),
            object_pairs_hook=_unique,
            parse_int=_bounded_int,
            parse_float=_bounded_float,
        )
        _check_texts(data)
    except json.JSONDecodeError as error:
        raise UserError(
            f"{what} is not JSON: {error.msg}", file=path, field=f"line {error.lineno}"
        ) from error
    except RecursionError as error:
        raise UserError(
            f"{what} is not JSON that can be read: lists and mappings are too deep", file=path
        ) from error
    except ValueError as error:
        raise UserError(f"{what} is not JSON that can be read: {error}", file=path) from error
    return data


def read_record(path: Path, what: str, *needed: str, allowed: str) -> dict[str, Any]:
    """Return the mapping in a JSON file of the project's own.

    Parameters
    ----------
    path : Path
    what : str
        What it should be: "the sidecar".
    *needed : str
        Fields that it has.
    allowed : str
        What would do in its place.

    Raises
    ------
    UserError
        As `read_yaml`; or it is no mapping, or has not these fields.
    """
    try:
        data = read_json(path, what)
    except UserError as error:
        error.allowed = allowed
        raise
    found = data if isinstance(data, dict) else {}
    missing = [name for name in needed if name not in found]
    if missing:
        raise UserError(
            f"{what} is not whole", file=path, field=", ".join(missing), allowed=allowed
        )
    return found


def _at(mark: yaml.Mark | None, problem: str) -> str:
    return (
        problem if mark is None else f"{problem} (line {mark.line + 1}, column {mark.column + 1})"
    )


def _check_events(text: str) -> None:
    """Refuse what would grow or recurse beyond bounds when it is constructed, and doubled keys."""
    sizes: dict[str, int | None] = {}  # of each anchor; None while it is open
    # Each open list or mapping has: its anchor, values up to now, keys (None: a list), key or
    # value.
    stack: list[list] = [[None, 0, None, False]]

    def add(count: int, key: str | None, mark: yaml.Mark) -> None:
        top = stack[-1]
        top[1] += count
        if sum(one[1] for one in stack) > MOST_VALUES:
            raise ValueError(_at(mark, f"more than {MOST_VALUES:,} values, aliases written out"))
        if top[2] is None:
            return
        top[3] = not top[3]
        if top[3] and key is not None:
            if key in top[2] and key != "<<":
                raise ValueError(_at(mark, f"the key {_short(key)} stands there twice"))
            top[2].add(key)

    for event in yaml.parse(text, Loader=_PARSER):
        mark = event.start_mark
        if getattr(event, "tag", None) not in (None, "!"):
            raise ValueError(_at(mark, f"a tag, {_short(event.tag)}: none is read"))
        match event:
            case yaml.AliasEvent():
                size = sizes.get(event.anchor, 0)
                if size is None:
                    raise ValueError(_at(mark, f"*{_short(event.anchor)} holds itself"))
                add(size, None, mark)
            case yaml.ScalarEvent():
                plain = event.implicit[0]
                if plain and len(event.value) > LONGEST_NUMBER and _FLOAT.fullmatch(event.value):
                    raise ValueError(_at(mark, f"a number of {len(event.value)} characters"))
                add(1, event.value, mark)
                if event.anchor:
                    sizes[event.anchor] = 1
            case yaml.CollectionStartEvent():
                if len(stack) > DEEPEST:
                    raise ValueError(_at(mark, f"more than {DEEPEST} lists inside one another"))
                keys = set() if isinstance(event, yaml.MappingStartEvent) else None
                stack.append([event.anchor, 1, keys, False])
                if event.anchor:
                    sizes[event.anchor] = None
            case yaml.CollectionEndEvent():
                anchor, size, _, _ = stack.pop()
                if anchor:
                    sizes[anchor] = size
                add(size, None, mark)


def _check_texts(data: object) -> None:
    """Refuse texts, keys too, that a terminal cannot show."""
    for text in _texts(data):
        if UNSEEN.search(text):
            raise ValueError(f"control characters in the text {_short(text)}")


def _texts(data: object) -> Iterator[str]:
    waiting, seen = [data], set()
    while waiting:
        one = waiting.pop()
        if isinstance(one, str):
            yield one
        elif isinstance(one, list | dict) and id(one) not in seen:
            seen.add(id(one))  # what aliases share is looked at once
            waiting.extend(one)
            if isinstance(one, dict):
                waiting.extend(one.values())


def _short(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the key {_short(twice)} stands there twice")
    return found


def _bounded_int(digits: str) -> int:
    if len(digits) > LONGEST_NUMBER:
        raise ValueError(f"a number of {len(digits)} characters")
    return int(digits)


def _bounded_float(digits: str) -> float:
    number = float(digits)
    if len(digits) > LONGEST_NUMBER or not math.isfinite(number):
        raise ValueError(f"a number out of range, {_short(digits)}")
    return number
