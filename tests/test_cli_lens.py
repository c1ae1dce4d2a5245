"""``gpusim lens``: what it shows, what it writes, how it refuses, and when it exits with 1."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import assert_refused, gpusim
from PIL import Image

from gpusim.cli import lens as cli_lens
from gpusim.lens import plane_bank
from gpusim.lens.bank import Bank, compute_bank
from gpusim.lens.plane_bank import compute_plane_bank
from gpusim.lens.prescription import load_prescription, presets

DEMO = ("lens", "double-gauss", "--focal-length", "8.3", "--f-number", "2.8")


@pytest.fixture(scope="module")
def computed() -> dict[str, Bank]:
    return {}


@pytest.fixture
def small_banks(monkeypatch: pytest.MonkeyPatch, computed: dict[str, Bank]):
    """Let the command work with banks of three wavelengths and three fields."""

    def small(lens, *, progress, **settings):
        edge = lens.max_field_deg
        name = f"{lens.title} {lens.history}"
        if name not in computed:
            computed[name] = compute_bank(
                lens,
                [450.0, 550.0, 650.0],
                [0.0, edge / 2, edge],
                progress=progress,
                **settings | {"size": 64},
            )
        return computed[name]

    monkeypatch.setattr(cli_lens, "cached_bank", small)


@pytest.fixture
def failing(tmp_path: Path) -> Path:
    """Return a lens file whose source states a focal length that the lens does not have."""
    data = yaml.safe_load(presets()["cooke-triplet"].read_text())
    data["checks"][0]["value"] = 51.0
    file = tmp_path / "failing.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def test_without_a_name_it_lists_the_library():
    ran = gpusim("lens")
    assert ran.code == 0, ran.err
    for name in presets():
        (line,) = [line for line in ran.out.splitlines() if line.split()[0] == name]
        assert re.search(r"\d mm .*f/\d", line)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("no-such-lens",), ("lens", "no-such-lens", *presets())),
        (("missing.zmx",), ("missing.zmx",)),
        (("double-gauss", "--focal-length", "-8"), ("efl_mm", "-8", "> 0")),
        (("double-gauss", "--f-number", "0.5"), ("f_number", "0.5", ">=")),
        (("double-gauss", "--out", "bank.csv"), ("--out", "bank.csv", ".nc or .png or .html")),
        (("--out", "bank.nc"), ("LENS", "double-gauss")),
        (("--f-number", "4"), ("LENS", "double-gauss")),
    ],
)
def test_a_wrong_lens_is_refused(arguments: tuple[str, ...], words: tuple[str, ...]):
    assert_refused(gpusim("lens", *arguments), *words)


def test_it_shows_the_data_and_writes_the_bank(tmp_path: Path, small_banks):
    ran = gpusim(*DEMO, "--out", tmp_path / "bank.nc")
    assert ran.code == 0, ran.err
    for words in ("US 2,673,491", "8.3000 mm", "f/2.8", "22\N{DEGREE SIGN}", "closed to f/2.8"):
        assert words in ran.out
    for name in ("T-stop", "exit pupil", "image circle", "distortion", "lateral colour"):
        assert name in ran.out
    bank = Bank.load(tmp_path / "bank.nc")
    assert bank.f_number == pytest.approx(2.8, rel=1e-3)
    assert f"{2e-3 * bank.image_circle_um:.3f} mm diameter" in ran.out
    assert ran.out.splitlines()[-1] == str(tmp_path / "bank.nc")
    assert [file.name for file in tmp_path.iterdir()] == ["bank.nc"]


def test_it_writes_the_page_as_picture(tmp_path: Path, small_banks):
    assert gpusim(*DEMO, "--out", tmp_path / "lens.png").code == 0
    picture = Image.open(tmp_path / "lens.png")
    assert picture.width > 1800
    assert np.asarray(picture.convert("L")).std() > 20
    assert [file.name for file in tmp_path.iterdir()] == ["lens.png"]


def test_it_writes_the_page_as_html(tmp_path: Path, small_banks):
    assert gpusim(*DEMO, "--out", tmp_path / "lens.html").code == 0
    text = (tmp_path / "lens.html").read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "8.3000 mm" in text
    assert [file.name for file in tmp_path.iterdir()] == ["lens.html"]


def test_each_check_value_of_the_source_has_a_line_with_its_verdict(small_banks):
    ran = gpusim("lens", "cooke-triplet")
    assert ran.code == 0, ran.err
    checks = [line for line in ran.out.splitlines() if "source" in line and "found" in line]
    assert len(checks) == len(load_prescription("cooke-triplet").checks) >= 2
    assert all(line.endswith(": ok") for line in checks)
    assert checks[0].startswith("efl_mm, catalogue indices: source 50 \N{PLUS-MINUS SIGN} 0.05")


def test_check_values_are_those_of_the_lens_as_published(small_banks):
    # At f/8 the f-number is not the source's f/5, and need not be.
    ran = gpusim("lens", "cooke-triplet", "--f-number", "8")
    assert ran.code == 0, ran.err
    assert "f/8" in ran.out
    assert "found 5: ok" in ran.out


def test_a_check_value_that_is_not_met_ends_with_1_after_everything(
    failing: Path, tmp_path: Path, small_banks
):
    ran = gpusim("lens", failing, "--out", tmp_path / "lens.png")
    assert ran.code == 1
    assert "Traceback" not in ran.err
    assert "source 51 \N{PLUS-MINUS SIGN} 0.05, found 50: FAILED" in ran.out
    assert "found 5: ok" in ran.out
    assert "T-stop" in ran.out
    assert ran.out.splitlines()[-1] == str(tmp_path / "lens.png")
    assert (tmp_path / "lens.png").exists()


def test_a_lens_file_has_its_account_and_a_preset_has_none(failing: Path, small_banks):
    account = re.compile(r"^ *\d+ +read +radius, thickness", re.MULTILINE)
    assert len(account.findall(gpusim("lens", failing).out)) == 5
    assert not account.search(gpusim("lens", "cooke-triplet").out)


@pytest.fixture
def tilted(tmp_path: Path) -> Path:
    """Return a lens file with a tilted element."""
    data = yaml.safe_load(presets()["cooke-triplet"].read_text())
    data["surfaces"][2]["tilt_deg"] = [0.1, 0.0]
    file = tmp_path / "tilted.yaml"
    file.write_text(yaml.safe_dump(data, sort_keys=False))
    return file


def test_a_lens_without_axis_shows_its_first_order_and_writes_its_plane_bank(
    tilted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def small(lens, *, progress):
        return compute_plane_bank(lens, [550.0], [0.0], [0.0, 10.0], size=32, progress=progress)

    monkeypatch.setattr(plane_bank, "compute_plane_bank", small)
    ran = gpusim("lens", tilted, "--out", tmp_path / "bank.nc")
    assert ran.code == 0, ran.err
    assert "50.0000 mm" in ran.out
    assert "distortion" not in ran.out
    assert plane_bank.PlaneBank.load(tmp_path / "bank.nc").psf.shape == (2, 1, 1, 32, 32)


def test_a_lens_without_axis_has_no_page(tilted: Path, tmp_path: Path):
    ran = gpusim("lens", tilted, "--out", tmp_path / "lens.png")
    assert_refused(ran, "symmetric about the axis", "surfaces.3", "tilt_deg")
    assert not (tmp_path / "lens.png").exists()


def test_a_command_that_fails_leaves_the_old_file(
    tmp_path: Path, small_banks, monkeypatch: pytest.MonkeyPatch
):
    from gpusim.report import lens_figure

    def broken(page):
        raise KeyboardInterrupt

    monkeypatch.setattr(lens_figure, "png", broken)
    (tmp_path / "lens.png").write_text("old")
    assert gpusim(*DEMO, "--out", tmp_path / "lens.png").code == 130
    assert (tmp_path / "lens.png").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["lens.png"]
