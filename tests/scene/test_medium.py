"""Tables of a source medium: against their formulas, and whatever a file may hold."""

from __future__ import annotations

import numpy as np
import pytest
from harness import assert_close
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from gpusim.errors import UserError
from gpusim.scene.make import made_again, make_scene
from gpusim.scene.medium import light_of


def cube(path, size, of, *, head=""):
    line = np.linspace(0, 1, size)
    rows = [f"LUT_3D_SIZE {size}", head]
    for blue in line:
        for green in line:
            rows += [" ".join(f"{x:.9f}" for x in of(red, green, blue)) for red in line]
    path.write_text("\n".join(rows) + "\n")
    return path


def film(red, green, blue):
    """Cross-talk of layers, linear in all: a table holds it without error."""
    return 0.8 * red + 0.1 * green, 0.05 * red + 0.9 * green, 0.2 * blue + 0.3 * green


def test_a_cube_maps_colours_as_its_entries_do(tmp_path):
    path = cube(tmp_path / "film.cube", 5, film)
    codes = np.random.default_rng(3).random((20, 30, 3))
    # Nine decimals in the file; trilinear where the map is linear.
    assert_close(light_of(codes, path), np.stack(film(*np.moveaxis(codes, -1, 0)), -1), atol=2e-9)
    # Beyond the domain as at its ends.
    assert_close(light_of(np.full((1, 1, 3), 7.0), path), np.full((1, 1, 3), 1.0) * film(1, 1, 1),
                 atol=2e-9)  # fmt: skip


def test_curves_map_each_colour(tmp_path):
    path = tmp_path / "screen.cube"
    line = np.linspace(0, 1, 1025)
    rows = [f"{x**2:.9f} {x**3:.9f} {x:.9f}" for x in line]
    path.write_text("TITLE a screen\nLUT_1D_SIZE 1025\n" + "\n".join(rows) + "\n")
    codes = np.random.default_rng(4).random((8, 9))
    found = light_of(codes, path)
    # Linear between entries 1/1024 apart: h^2 / 8 of a second derivative of 6 at most.
    assert_close(found, np.stack([codes**2, codes**3, codes], -1), atol=6 / 1024**2 / 8 + 2e-9)


def test_a_picture_is_seen_through_its_medium(tmp_path):
    codes = np.random.default_rng(5).integers(0, 256, (12, 16, 3), np.uint8)
    Image.fromarray(codes).save(tmp_path / "scan.png")
    table = cube(tmp_path / "film.cube", 3, film)
    scene = make_scene(tmp_path / "scan.png", transfer=str(table))
    planes = np.moveaxis(np.stack(film(*np.moveaxis(codes / 255, -1, 0)), -1), -1, 0)
    # Float32 rounds what is 1 at most by 6e-8; nine decimals of the file add 1e-9 each.
    assert_close(scene.source.planes, planes.astype(np.float32), atol=2e-7)
    assert any("film.cube" in note for note in scene.notes)
    assert np.array_equal(made_again(scene.made_from).source.planes, scene.source.planes)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "0 lines"),
        ("LUT_3D_SIZE 2\n0 0 0\n", "3"),
        ("LUT_3D_SIZE 1000\n", "1000"),
        ("LUT_1D_SIZE 2\nLUT_3D_SIZE 2\n", "2 lines"),
        ("LUT_1D_SIZE 2\n0 0 0\nnan 1 1\n", "number"),
        ("LUT_1D_SIZE 2\nDOMAIN_MIN 1 1 1\nDOMAIN_MAX 0 0 0\n0 0 0\n1 1 1\n", "domain"),
        ("LUT_1D_SIZE 2\n0 0 zero\n1 1 1\n", ""),
    ],
)
def test_what_is_no_table_is_refused(tmp_path, text, word):
    path = tmp_path / "bad.cube"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        light_of(np.zeros((2, 2, 3)), path)
    assert word in str(caught.value.value)
    assert "LUT_3D_SIZE" in caught.value.allowed


NUMBERS = st.floats(width=32).map(str) | st.sampled_from(["1", "0 0 0", "x", "-1e9", ""])
LINES = st.one_of(
    st.lists(NUMBERS, max_size=4).map(" ".join),
    st.sampled_from(
        ["LUT_1D_SIZE 2", "LUT_3D_SIZE 2", "LUT_3D_SIZE 99", "DOMAIN_MIN 0 0 0", "DOMAIN_MAX 1 1",
         "TITLE", "# text", "LUT_1D_INPUT_RANGE 0 1"]
    ),
)  # fmt: skip


@settings(max_examples=60, deadline=2000)
@given(st.lists(LINES, max_size=14).map("\n".join) | st.binary(max_size=200).map(repr))
def test_any_text_is_a_table_or_one_clear_error(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("cube") / "any.cube"
    path.write_text(text)
    try:
        found = light_of(np.full((2, 2, 3), 0.5), path)
    except UserError:
        return
    assert np.isfinite(found).all()
