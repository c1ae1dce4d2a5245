"""The single figures of a lens: readable for any lens and for two, their numbers as files."""

from __future__ import annotations

import csv
import io
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from labels import overlaps, words
from lens.made import lens as made_lens
from lens.made import model
from PIL import Image
from sampling import one_in

from gpusim.cli import lens as cli_lens
from gpusim.cli.lens_plots import Setting, second
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.system import build, first_order
from gpusim.psf.compute import compute_bank
from gpusim.report.lens.plots import PLOTS, csv_text, draw_plot, json_text, tables
from gpusim.report.lens.study import Study, aligned
from gpusim.report.lens_html import _plots


def gauss(f_number: float) -> Study:
    lens = load_prescription("double-gauss").scaled(8.3).limited(14.3)
    return Study(f"double-gauss, f/{f_number:g}", build(lens.stopped(f_number)))


@pytest.fixture(scope="module")
def study() -> Study:
    return gauss(2.8)


@pytest.fixture(scope="module")
def both(study: Study) -> list[Study]:
    return aligned([gauss(2.8), gauss(5.6)])


@pytest.fixture(scope="module")
def tilted() -> Study:
    rows = [
        {"radius": 30.0, "thickness": 3.0, **model(1.6), "tilt_deg": [1.0, 2.0]},
        {"radius": -60.0},
    ]
    return Study("tilted", build(made_lens(rows, f_number=8.0)))


def by_name(name: str):
    return next(plot for plot in PLOTS if plot.name == name)


def readable(figure) -> None:
    shown = words(figure)
    assert len(shown) > 4
    assert overlaps(shown) == []
    width, height = figure.get_size_inches() * figure.dpi
    for text, box in shown:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


@pytest.mark.parametrize("plot", one_in(2, PLOTS), ids=lambda plot: plot.name)
def test_labels_of_a_figure_can_be_read(study: Study, plot):
    readable(draw_plot(plot, [study]))


@pytest.mark.parametrize("plot", one_in(4, PLOTS), ids=lambda plot: plot.name)
def test_two_lenses_share_a_figure(both: list[Study], plot):
    figure = draw_plot(plot, both)
    readable(figure)
    said = [text for text, _ in words(figure)]
    assert {"double-gauss, f/2.8", "double-gauss, f/5.6"} <= set(said)
    for name, columns in tables(plot, both).items():
        assert next(iter(columns)) == "lens", name
        assert set(columns["lens"]) == {study.label for study in both}


@pytest.mark.parametrize("plot", one_in(4, PLOTS), ids=lambda plot: plot.name)
def test_a_lens_without_an_axis_has_its_figures(tilted: Study, plot):
    readable(draw_plot(plot, [tilted]))


def test_a_field_of_one_angle_has_figures_too():
    rows = [{"radius": 50.0, "thickness": 3.0, **model(1.5)}, {"radius": -50.0}]
    alone = Study("axis alone", build(made_lens(rows, max_field_deg=0.0)))
    for name in ("ray-fans", "field-curvature", "distortion-grid", "lateral-colour", "angles"):
        readable(draw_plot(by_name(name), [alone]))


@pytest.mark.parametrize("plot", PLOTS, ids=lambda plot: plot.name)
def test_columns_are_of_one_length_with_units_in_their_names(study: Study, tilted: Study, plot):
    for one in (study, tilted):
        for name, columns in tables(plot, [one]).items():
            assert len({len(values) for values in columns.values()}) == 1, name
            assert all(len(values) > 1 for values in columns.values())
            if "field" in columns:
                assert np.isfinite(columns["field_deg"]).all()


def test_lenses_on_one_figure_have_one_range(both: list[Study]):
    wide, narrow = both
    assert wide.frequency == narrow.frequency
    np.testing.assert_array_equal(wide.frequencies, narrow.frequencies)
    np.testing.assert_array_equal(wide.depth_mm, narrow.depth_mm)
    # At twice the f-number half as many cycles get through.
    assert narrow.limit[-1] < 0.7 * wide.limit[-1]


# numbers that two figures share


def test_the_frequency_that_was_asked_for_is_taken():
    asked = Study("", build(load_prescription("double-gauss").scaled(8.3).stopped(2.8)), 90.0)
    assert asked.frequency == 90.0
    columns = tables(by_name("mtf-focus"), [asked])["mtf-focus"]
    assert set(columns["frequency_cy_mm"]) == {90.0}
    here = np.isclose(columns["shift_mm"], 0, atol=1e-12) & (columns["field"] == "axis")
    at = np.interp(90.0, asked.frequencies, asked.mtf[0, 0])
    # Two grids of the pupil, 1e-3, and a chord of the curve.
    assert columns["tangential"][here][0] == pytest.approx(at, abs=2e-3)
    over = tables(by_name("mtf-field"), [asked])["mtf-field"]
    axis = (over["field_deg"] == 0) & (over["frequency_cy_mm"] == 90.0)
    assert over["tangential"][axis][0] == pytest.approx(at, abs=2e-3)


def test_the_grid_is_distorted_as_the_curve_says(study: Study):
    ideal, real = study.grid
    corner = np.linalg.norm(real[0, 0]) / np.linalg.norm(ideal[0, 0])
    columns = tables(by_name("field-curvature"), [study])["distortion"]
    # The grid's corner lies at the largest field; the scale on axis is found in two ways.
    assert 100 * (corner - 1) == pytest.approx(columns["f_tan_percent"][-1], abs=2e-3)
    np.testing.assert_allclose(ideal[5, 5], real[5, 5], atol=1e-9)
    # x grows to the right, y upwards: the first row is the lowest.
    assert ideal[0, -1, 0] > 0 > ideal[0, -1, 1]


def test_the_ideal_grid_has_the_scale_of_the_focal_length(study: Study):
    ideal, _ = study.grid
    order = first_order(study.system.prescription, study.primary_nm)
    reach = np.linalg.norm(ideal[-1, -1])
    # The image plane is a little off the paraxial one.
    assert reach == pytest.approx(order.efl_mm * np.tan(np.radians(14.3)), rel=2e-3)


def test_illumination_is_that_of_the_bank(study: Study):
    lens = study.system.prescription
    bank = compute_bank(lens, [500.0, 550.0, 600.0], [0.0, 7.15, 14.3], size=64)
    found = np.interp([7.15, 14.3], np.degrees(study.contrast_theta), study.illumination)
    np.testing.assert_allclose(found, bank.relative_illumination[1:, 1], rtol=0, atol=3e-3)


def test_encircled_energy_rises_below_the_limit(study: Study):
    share = study.encircled
    assert share.shape == (3, len(study.radius_um))
    assert (np.diff(share, axis=1) > -1e-3).all()
    assert (share <= study.encircled_limit + 5e-3)[0].all()
    np.testing.assert_allclose(share[:, [0, -1]], [[0, 1]] * 3, atol=1e-2)


def test_angles_begin_on_the_axis_and_say_the_f_number(study: Study):
    columns = tables(by_name("angles"), [study])["angles"]
    assert columns["chief_ray_deg"][0] == pytest.approx(0, abs=1e-6)
    assert (np.diff(columns["chief_ray_deg"]) > 0).all()
    assert columns["f_number_tangential"][0] == pytest.approx(2.8, rel=0.01)


# files


def test_a_table_comes_back_from_its_csv(study: Study):
    (columns,) = tables(by_name("ray-fans"), [study]).values()
    rows = list(csv.DictReader(io.StringIO(csv_text(columns))))
    assert len(rows) == len(columns["stop"])
    assert rows[0].keys() == columns.keys()
    for name in ("ex_um", "ey_um"):
        back = np.array([float(row[name]) if row[name] else np.nan for row in rows])
        np.testing.assert_allclose(back, columns[name], rtol=1e-9)
        assert np.isfinite(back).any()


def test_the_json_has_every_figure_and_no_number_that_is_none(study: Study):
    text = json_text([study])
    assert "NaN" not in text and "Infinity" not in text
    found = json.loads(text)
    assert list(found["figures"]) == [plot.name for plot in PLOTS]
    assert found["lenses"][0]["frequency_cy_mm"] == study.frequency
    spots = found["figures"]["spots"]["tables"]["spots"]
    assert spots["rms_um"][0] == study.spots[0].rms_um


def test_the_page_holds_all_figures(study: Study):
    assert [title for title, _ in _plots([study])] == [plot.title for plot in PLOTS]
    assert _plots([]) == []


# the command


@pytest.fixture
def small_bank(monkeypatch: pytest.MonkeyPatch):
    """Let the command work with a bank of one field and three wavelengths."""

    def small(lens, *, progress, **settings):
        lines = [450.0, 550.0, 650.0]
        return compute_bank(lens, lines, [0.0, 14.0], progress=progress, **settings | {"size": 64})

    monkeypatch.setattr(cli_lens, "cached_bank", small)


def test_the_command_writes_figures_and_numbers(tmp_path, small_bank):
    demo = ("lens", "double-gauss", "--focal-length", "8.3", "--f-number", "8")
    numbers = tmp_path / "n.json"
    ran = gpusim(
        *demo, "--with", "f-number=11,focus-shift=5", "--frequency", "60", "--json", numbers,
        "--figures", tmp_path / "figures", "--csv", tmp_path / "csv",
        "--out", tmp_path / "lens.html",
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert {file.stem for file in (tmp_path / "figures").iterdir()} == {p.name for p in PLOTS}
    assert Image.open(tmp_path / "figures" / "spots.png").width == 736
    assert {file.stem for file in (tmp_path / "csv").iterdir()} == {
        name for plot in PLOTS for name in plot.tables
    }
    page = (tmp_path / "lens.html").read_text()
    assert page.count('class="sheet"') == 1 + len(PLOTS)
    found = json.loads(numbers.read_text())
    assert [one["label"] for one in found["lenses"]] == [
        "double-gauss, f = 8.3 mm, f/8",
        "double-gauss, f = 8.3 mm, f/11, image plane +5 \N{MICRO SIGN}m",
    ]
    assert {one["frequency_cy_mm"] for one in found["lenses"]} == {60.0}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("f-number=4", ("gauss", Setting(8.3, 4.0))),
        ("tessar", ("tessar", Setting())),
        ("tessar, focal-length=20,focus-shift=-5", ("tessar", Setting(20.0, focus_shift=-5.0))),
    ],
)
def test_a_second_lens_or_setting_is_understood(text: str, wanted: tuple[str, Setting]):
    assert second(text, "gauss", Setting(8.3, 2.8)) == wanted


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--with", "f-number=4"), ("--with", "--figures")),
        (("--with", "f-number=wide", "--json", "a.json"), ("--with f-number", "wide")),
        (("--with", "tessar,phone", "--json", "a.json"), ("--with", "tessar,phone")),
        (("--with", "no-such-lens", "--json", "a.json"), ("no-such-lens", "tessar")),
        (("--with", "f-number=0.5", "--json", "a.json"), ("f_number", "0.5")),
        (("--with", "diffraction-limited", "--json", "a.json"), ("--with", "no surfaces")),
        (("--frequency", "-3", "--json", "a.json"), ("--frequency", "-3")),
        (("--json", "a.txt"), ("--json", "a.txt", ".json")),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments, said, tmp_path, monkeypatch, small_bank):
    monkeypatch.chdir(tmp_path)
    assert_refused(gpusim("lens", "double-gauss", *arguments), *said)
    assert list(tmp_path.iterdir()) == []


def test_a_ready_made_lens_has_no_figures_of_rays():
    for option in ("--figures", "--csv"):
        assert_refused(gpusim("lens", "diffraction-limited", option, "x"), option, "no surfaces")
