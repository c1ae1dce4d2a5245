"""The settings of development as a file."""

import pytest

from gpusim.errors import UserError
from gpusim.isp.settings import Settings, read_settings, settings_text

GIVEN = Settings(
    demosaic="malvar",
    white_balance="5100K",
    space="p3",
    matrix_fit="lab",
    ev=-0.5,
    roll_off=0.2,
    curve=((0.0, 0.0), (0.3, 0.25), (1.0, 1.0)),
    defects=True,
    shading=False,
)


@pytest.mark.parametrize("settings", [Settings(), GIVEN])
def test_what_is_written_is_read_again(tmp_path, settings: Settings):
    path = tmp_path / "a.yaml"
    path.write_text(settings_text(settings, ["a note: with a colon", "another"]))
    assert read_settings(path) == settings
    assert path.read_text().startswith("# a note: with a colon\n# another\n")


@pytest.mark.parametrize(
    ("line", "field"),
    [
        ("demosaic: amaze", "demosaic"),
        ("white_balance: sunny", "white_balance"),
        ("white_balance: patch:1,2,3", "white_balance"),
        ("space: adobe", "space"),
        ("matrix_fit: luv", "matrix_fit"),
        ("ev: 30", "ev"),
        ("ev: .nan", "ev"),
        ("roll_off: 1", "roll_off"),
        ("curve: [[0, 0], [0.5, 2], [1, 1]]", "curve"),
        ("curve: [[0, 0], [0.5, 1]]", "curve"),
        ("curve: [[0, 0], [0.5, 1], [0.5, 1], [1, 1]]", "curve"),
        ("sharpening: 3", "sharpening"),
    ],
)
def test_what_is_wrong_is_told(tmp_path, line: str, field: str):
    path = tmp_path / "a.yaml"
    path.write_text(line + "\n")
    with pytest.raises(UserError) as caught:
        read_settings(path)
    assert caught.value.file == path
    assert str(caught.value.field).startswith(field)
