"""The one loader: plain data of bounded size, or one clear error within time and memory."""

import json
import time
import tracemalloc
from pathlib import Path

import pytest

from gpusim.config.text import parse_yaml, read_json, read_mapping, read_yaml
from gpusim.errors import UserError

DEEP = 100_000
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n"
    for a, b in zip("abcdefghi", "bcdefghij", strict=True)
)
MERGES = "a: &a {x: 1}\n" + "".join(
    f"k{n}: &k{n} {{<<: [{', '.join(['*a' if n == 0 else f'*k{n - 1}'] * 9)}]}}\n" for n in range(9)
)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("1.5E+3", 1500.0),
        ("012", 12),
        ("0x1f", 31),
        ("0o17", 15),
        ("-7", -7),
        (".inf", float("inf")),
        ("no", "no"),
        ("on", "on"),
        ("true", True),
        ("~", None),
        ("", None),
        ("2001-99-99", "2001-99-99"),
        ("2001-01-01", "2001-01-01"),
        ("12:30:00", "12:30:00"),
        ("1_000", "1_000"),
        ("'12'", "12"),
        ("[1, [2, {a: 3}]]", [1, [2, {"a": 3}]]),
        ("a: &b {c: 1}\nd: {<<: *b, c: 2}", {"a": {"c": 1}, "d": {"c": 2}}),
    ],
)
def test_scalars_are_those_of_the_core_schema(text, value):
    found = parse_yaml(text)
    assert found == value and type(found) is type(value)


REFUSED = {
    "deep list": ("[" * DEEP, "inside one another"),
    "deep mapping": ("{a: " * DEEP, "inside one another"),
    "deep block": ("- " * DEEP + "a", "inside one another"),
    "alias bomb": (BOMB, "more than 1,000,000 values"),
    "bomb of merges": (MERGES, "more than 1,000,000 values"),
    "itself": ("a: &a [*a]", "holds itself"),
    "unknown alias": ("a: *b", "undefined alias"),
    "digits": (f"rows: {'9' * 4300}", "a number of 4300 characters"),
    "digits after the point": (f"rows: 0.{'1' * 4300}", "a number of 4302 characters"),
    "doubled key": ("rows: 4\ncols: 5\nrows: 6", "'rows' stands there twice (line 3, column 1)"),
    "doubled inside": ("a:\n  - {b: 1, 'b': 2}", "'b' stands there twice"),
    "tag": ("a: !!python/object/apply:os.system [ls]", "a tag"),
    "number by tag": ("a: !!int x", "a tag"),
    "escape sequence": ('title: "\\e[2J"', "control characters"),
    "in a key": ('"a\\x1b": 1', "control characters"),
    "half a character": ('a: "\\ud800"', ""),
    "raw escape": ("a: \x1b[2J", ""),
    "unclosed": ("rows: [1", "line 2"),
    "two documents": ("a: 1\n---\nb: 2", "document"),
    "list as key": ("[1, 2]: 3", "unhashable"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_settings_file_is_one_line_soon_and_in_little_memory(tmp_path: Path, what: str):
    text, words = REFUSED[what]
    file = tmp_path / "a.yaml"
    file.write_text(text, encoding="utf-8", errors="surrogatepass")
    tracemalloc.start()
    started = time.process_time()
    with pytest.raises(UserError) as caught:
        read_yaml(file, "the sensor file")
    spent, (_, most) = time.process_time() - started, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert words in caught.value.problem
    assert "\n" not in caught.value.problem and len(caught.value.problem) < 300
    assert caught.value.file == file
    assert spent < 5 and most < 100 << 20  # the bombs, written out, have 4e8 values


JSON_REFUSED = {
    "deep": ("[" * DEEP, "too deep"),
    "digits": ('{"rows": ' + "9" * 4300 + "}", "a number of 4300 characters"),
    "infinite": ("[1e999]", "out of range"),
    "doubled": ('{"a": 1, "a": 2}', "'a' stands there twice"),
    "escape": ('{"a": "\\u001b[2J"}', "control characters"),
    "half": ('["\\ud800"]', "control characters"),
    "cut": ('{"a": [1,', "not JSON"),
    "empty": ("", "not JSON"),
}


@pytest.mark.parametrize("what", JSON_REFUSED)
def test_what_is_no_json_is_refused(tmp_path: Path, what: str):
    text, words = JSON_REFUSED[what]
    file = tmp_path / "a.json"
    file.write_text(text)
    with pytest.raises(UserError) as caught:
        read_json(file, "the quantum efficiency")
    assert words in caught.value.problem and caught.value.file == file


def test_json_is_read(tmp_path: Path):
    file = tmp_path / "a.json"
    data = {"a": [1, 2.5, None, True, {"b": "text\n"}]}
    file.write_text("\ufeff" + json.dumps(data), encoding="utf-8")
    assert read_json(file, "the file") == data


@pytest.mark.parametrize("make", [lambda at: None, lambda at: at.mkdir()])
def test_a_file_that_is_none_is_refused(tmp_path: Path, make):
    make(tmp_path / "a.yaml")
    with pytest.raises(UserError, match="the sensor file cannot be read"):
        read_yaml(tmp_path / "a.yaml", "the sensor file")


def test_a_name_that_no_file_can_have_is_refused():
    with pytest.raises(UserError, match="cannot be read"):
        read_yaml(Path("a\0b.yaml"), "the sensor file")


def test_what_never_ends_is_refused(tmp_path: Path):
    with pytest.raises(UserError, match="it is no file"):
        read_yaml(Path("/dev/zero"), "the sensor file")
    (tmp_path / "a.yaml").write_bytes(b"# \n" * (1 << 21))
    with pytest.raises(UserError, match="too large to be one"):
        read_yaml(tmp_path / "a.yaml", "the sensor file")


def test_a_list_is_no_mapping(tmp_path: Path):
    (tmp_path / "a.yaml").write_text("- 1")
    with pytest.raises(UserError, match="the lens file holds no fields"):
        read_mapping(tmp_path / "a.yaml", "the lens file")
