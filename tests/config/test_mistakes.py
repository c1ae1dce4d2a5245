"""What a user is told of a wrong file: everything at once, on one screen."""

from pathlib import Path

import pytest
from pydantic import Field

from gpusim.config.mistakes import checked
from gpusim.config.model import Strict
from gpusim.config.names import nearest
from gpusim.errors import UserError

FILE = Path("a.yaml")


class Part(Strict):
    """A part."""

    count: int
    on: bool = False


class Whole(Strict):
    """A file."""

    rows: int
    temporal_dark_noise_e: float = Field(gt=0)
    f_number: float
    many: dict[str, list[float]] = Field(default_factory=dict)
    size: float | tuple[float, ...] = 1.0
    part: Part | None = None
    parts: tuple[Part, ...] = ()
    anything: dict[str, object] = Field(default_factory=dict)


GOOD = {"rows": 4, "temporal_dark_noise_e": 2.5, "f_number": 4}


def refused(data: object) -> UserError:
    with pytest.raises(UserError) as caught:
        checked(Whole, data, FILE)
    return caught.value


def test_all_missing_fields_are_told_at_once():
    error = refused({"part": {}})
    assert error.problem == "4 fields are missing"
    assert error.field == "rows, temporal_dark_noise_e, f_number, part.count"


def test_a_name_of_others_is_told_ours_before_what_is_missing():
    error = refused({"xyz": 1, "rows": 4, "read_noise_e": 2.5})
    assert error.problem == (
        "unknown field: perhaps temporal_dark_noise_e is meant; "
        "missing: temporal_dark_noise_e, f_number"
    )
    assert error.field == "read_noise_e"


@pytest.mark.parametrize(
    ("field", "value", "place"),
    [
        ("rows", True, "rows"),
        ("f_number", False, "f_number"),
        ("many", {"G": [1, True]}, "many"),
        ("size", [1.0, True], "size"),
        ("part", {"count": True}, "part.count"),
        ("parts", [{"count": 1}, {"count": False}], "parts.2.count"),
    ],
)
def test_true_is_no_number(field, value, place):
    error = refused(GOOD | {field: value})
    assert error.field == place and "not true or false" in error.allowed


def test_true_stands_where_it_may():
    part = {"count": 1, "on": True}
    made = checked(Whole, GOOD | {"part": part, "anything": {"a": True}}, FILE)
    assert made.part.on is True and made.anything == {"a": True}


@pytest.mark.parametrize(
    ("name", "names", "found"),
    [
        ("read_noise_e", ["rows", "temporal_dark_noise_e"], "temporal_dark_noise_e"),
        ("Read-Noise", ["rows", "temporal_dark_noise_e"], "temporal_dark_noise_e"),
        ("read_noise_e", ["rows"], None),  # the field that is meant must be there
        ("IMX47", ["imx477", "imx363"], "imx477"),
        ("fnumber", ["f_number"], "f_number"),
        ("xyz", ["rows"], None),
        (3, ["rows"], None),
    ],
)
def test_the_nearest_name(name, names, found):
    assert nearest(name, names) == found


def test_a_screen_is_short_and_steers_no_terminal():
    error = UserError("bad\x1b[2J", file="a\x07.yaml", field="x", value="9" * 10_000, allowed="é")
    screen = error.screen()
    assert "\x1b" not in screen and "\\x1b[2J" in screen and "\\x07" in screen
    assert len(screen) < 500 and "(10000 characters)" in screen and "é" in screen
    assert "too long" in UserError("bad", value=10**5000).screen()
