"""``gpusim lens``: what it shows, what it writes, how it refuses, and when it exits with 1."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import assert_refused, gpusim
from formats.exports import write_isetcam, write_zemax
from PIL import Image

from gpusim.cli import lens as cli_lens
from gpusim.formats.lens_file import load_prescription, presets
from gpusim.formats.ready import NPZ_ARRAYS, load_ready
from gpusim.psf.bank import Bank
from gpusim.psf.compute import compute_bank
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.psf.plane_bank import PlaneBank

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
    without_figures(monkeypatch)


def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let pages do without their figures, which take half a minute: see test_lens_plots.py."""
    monkeypatch.setattr(cli_lens, "studied", lambda *asked: [])


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


def test_a_lens_file_has_its_import_log_and_a_preset_has_none(failing: Path, small_banks):
    rows = re.compile(r"^ *\d+ +read +radius, thickness", re.MULTILINE)
    assert len(rows.findall(gpusim("lens", failing).out)) == 5
    assert not rows.search(gpusim("lens", "cooke-triplet").out)


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
        return compute_plane_bank(
            lens, [550.0], [0.0, 1.0], [0.0, 10.0], size=32, progress=progress
        )

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # not for a bank like this
    monkeypatch.setattr(cli_lens, "cached_plane_bank", small)
    ran = gpusim("lens", tilted, "--out", tmp_path / "bank.nc")
    assert ran.code == 0, ran.err
    assert "50.0000 mm" in ran.out
    assert "distortion" not in ran.out
    assert PlaneBank.load(tmp_path / "bank.nc").psf.shape == (2, 2, 1, 32, 32)


@pytest.mark.parametrize("suffix", ["png", "html"])
def test_a_lens_without_axis_has_a_page_over_both_directions(
    tilted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
):
    def small(lens, *, progress):
        return compute_plane_bank(
            lens, [550.0], [-10.0, 0.0, 10.0], [0.0, 10.0], size=32, progress=progress
        )

    monkeypatch.setattr(cli_lens, "cached_plane_bank", small)
    without_figures(monkeypatch)
    ran = gpusim("lens", tilted, "--out", tmp_path / f"lens.{suffix}")
    assert ran.code == 0, ran.err
    assert "image of the axis" in ran.out
    if suffix == "png":
        assert np.asarray(Image.open(tmp_path / "lens.png").convert("L")).std() > 20
    else:
        text = (tmp_path / "lens.html").read_text(encoding="utf-8")
        assert "tilted by 0.1, 0 deg" in text
        assert "image of the axis" in text


def test_a_saved_bank_without_axis_is_shown_again(tilted: Path, tmp_path: Path):
    lens = load_prescription(tilted)
    compute_plane_bank(lens, [550.0], [-10.0, 0.0], [0.0, 10.0], size=32).save(tmp_path / "bank.nc")
    ran = gpusim("lens", tmp_path / "bank.nc", "--out", tmp_path / "again.png")
    assert ran.code == 0, ran.err
    assert "image of the axis" in ran.out
    assert (tmp_path / "again.png").stat().st_size > 20_000
    (tmp_path / "bank.nc").write_bytes((tmp_path / "bank.nc").read_bytes()[:-3000])
    assert gpusim("lens", tmp_path / "bank.nc").code == 2


def ready_made(folder: Path) -> dict[str, Path]:
    """Write a lens of Gaussians in every form that is read; return where."""
    zemax, isetcam = folder / "zemax", folder / "isetcam"
    zemax.mkdir()
    isetcam.mkdir()
    write_isetcam(isetcam)
    listed = write_zemax(zemax)
    bank = load_ready(listed).bank()
    bank.save(folder / "bank.nc")
    given = {name: getattr(bank, name) for name in NPZ_ARRAYS if hasattr(bank, name)}
    np.savez(folder / "bank.npz", title="arrays", source="made up", **given)
    return {
        "Zemax text exports": listed,
        "ISETCam ray-trace folder": isetcam,
        "saved bank": folder / "bank.nc",
        "NumPy arrays": folder / "bank.npz",
        "MTF table": Path("diffraction-limited"),
    }


def test_ready_made_lenses_of_every_kind_are_shown(tmp_path: Path):
    for kind, path in ready_made(tmp_path).items():
        ran = gpusim("lens", path)
        assert ran.code == 0, ran.err
        assert kind in ran.out
        for words in ("focal length", "image circle", "T-stop", "not known"):
            assert words in ran.out
        assert "check values" not in ran.out  # there is no source to check


@pytest.mark.parametrize("suffix", ["png", "html", "nc"])
def test_a_ready_made_lens_has_its_page_and_its_bank(tmp_path: Path, suffix: str):
    ran = gpusim("lens", "diffraction-limited", "--out", tmp_path / f"out.{suffix}")
    assert ran.code == 0, ran.err
    assert ran.out.splitlines()[-1] == str(tmp_path / f"out.{suffix}")
    file = tmp_path / f"out.{suffix}"
    if suffix == "png":
        assert np.asarray(Image.open(file).convert("L")).std() > 20
    elif suffix == "html":
        assert "MTF table" in file.read_text(encoding="utf-8")
    else:
        np.testing.assert_array_equal(
            Bank.load(file).psf, load_ready("diffraction-limited").bank().psf
        )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("diffraction-limited", "--f-number", "4"), ("ready-made", "--f-number", "4.0")),
        (("diffraction-limited", "--focus-shift", "4"), ("ready-made", "--focus-shift")),
        (("missing.nc",), ("no such lens", "missing.nc")),
        (("missing.npz",), ("no such lens", "missing.npz")),
        (("/",), ("ISETPARMS.TXT",)),
    ],
)
def test_what_is_no_ready_made_lens_or_cannot_be_changed_is_refused(arguments, words):
    assert_refused(gpusim("lens", *arguments), *words)


def test_a_command_that_fails_leaves_the_old_file(
    tmp_path: Path, small_banks, monkeypatch: pytest.MonkeyPatch
):
    from gpusim.report import drawing

    def broken(figure):
        raise KeyboardInterrupt

    monkeypatch.setattr(drawing, "png", broken)
    (tmp_path / "lens.png").write_text("old")
    assert gpusim(*DEMO, "--out", tmp_path / "lens.png").code == 130
    assert (tmp_path / "lens.png").read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["lens.png"]


def test_model_glasses_say_what_they_leave_open(small_banks, tmp_path):
    out = tmp_path / "page.html"
    ran = gpusim("lens", "tessar", "--out", out)
    assert ran.code == 0, ran.err
    shown = " ".join(ran.out.split())
    for words in (
        r"lateral colour [\d.]+ um, [\d.]+ um with catalogue glasses, at most [\d.]+ um apart",
        r"longitudinal colour \d+ um, \d+ um with catalogue glasses",
        r"surface 7 HOYA/\S+ \(nd [+-]0\.00\d+, Vd [+-]\d\.\d+\)",
        r"\+-[\d.]+ um of lateral colour",
    ):
        assert re.search(words, shown), words
    page = out.read_text(encoding="utf-8")
    assert "with catalogue glasses" in page
    assert "of longitudinal colour" in page
    # The rest of a published lens's import log is in its file.
    assert "read " not in ran.out.split("surface  ")[-1]
    nearest = gpusim("lens", "tessar", "--nearest-glasses")
    assert nearest.code == 0, nearest.err
    assert "by the nearest of the catalogues" in " ".join(nearest.out.split())
    assert figure(nearest.out, "lateral colour") != figure(ran.out, "lateral colour")
    without = gpusim("lens", "double-gauss")
    assert "catalogue glasses" not in without.out


def figure(text: str, name: str) -> str:
    """Return what stands beside a name."""
    return re.search(rf"^{name} +(\S+)", text, re.MULTILINE)[1]
