"""The page on a lens: its numbers are right, its labels readable, its files whole in themselves."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from labels import overlaps, words
from matplotlib.figure import Figure
from PIL import Image

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.checks import checked
from gpusim.lens.system import build, first_order
from gpusim.psf.bank import Bank
from gpusim.psf.compute import compute_bank
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.psf.otf import diffraction_mtf
from gpusim.psf.sampling import default_fields_deg
from gpusim.report import drawing
from gpusim.report import lens_page as page_numbers
from gpusim.report.drawing import png, svg
from gpusim.report.lens import colours, spread
from gpusim.report.lens.sheet import draw, draw_ready
from gpusim.report.lens.spread import colour_image
from gpusim.report.lens_facts import (
    distortions,
    lens_facts,
    ready_facts,
    t_stop,
    working_f_number,
)
from gpusim.report.lens_html import lens_html
from gpusim.report.lens_page import BankPage, LensPage, lens_page, ready_page
from gpusim.report.plane_figure import _psfs, draw_plane
from gpusim.report.plane_page import PlanePage, plane_page


@pytest.fixture(scope="module")
def demo_lens():
    return load_prescription("double-gauss").scaled(8.3).stopped(2.8).limited(14.3)


@pytest.fixture(scope="module")
def page(demo_lens) -> LensPage:
    lines = [450.0, 500.0, 550.0, 600.0, 650.0]
    # In 64 samples a caustic of the corner's blue is cut: 6.7 % of its light would count as lost.
    bank = compute_bank(demo_lens, lines, default_fields_deg(demo_lens, 5), size=96)
    return lens_page(bank, build(demo_lens))


# numbers


def test_mtf_begins_at_1_and_stays_below_the_diffraction_limit_on_axis(page: LensPage):
    for curves in page.curves:
        assert curves.against_frequency.shape == (2, len(page.frequency))
        # The rim's rounding, see line_spread.
        np.testing.assert_allclose(curves.against_frequency[:, 0], 1, rtol=0, atol=3e-3)
    axis = page.curves[0].against_frequency
    assert (axis <= page.limit + 2e-3).all()
    np.testing.assert_allclose(axis[0], axis[1], rtol=0, atol=1e-3)  # round


def test_through_focus_passes_through_the_mtf_at_its_frequency(page: LensPage):
    here = np.flatnonzero(np.isclose(page.focus_mm, 0, atol=1e-12))
    assert len(here) == 1
    for curves, pair in zip(page.curves, page.through_focus, strict=True):
        for focus, frequency in zip(pair, curves.against_frequency, strict=True):
            at = np.interp(page.focus_frequency, page.frequency, frequency)
            # Two grids of the pupil: 1e-3 (COARSE_NODES); a chord of the curve: 1e-3.
            assert focus[here[0]] == pytest.approx(at, abs=2e-3)


def test_the_frequencies_fit_the_lens(page: LensPage):
    axis = page.curves[0].against_frequency[0]
    assert 0.35 < np.interp(page.focus_frequency, page.frequency, axis) < 0.65
    assert axis[-1] <= 0.1


def test_progress_counts_up_to_the_end(page: LensPage):
    calls = []
    lens_page(page.bank, page.system, lambda done, total: calls.append((done, total)))
    assert calls == [(k, len(calls)) for k in range(1, len(calls) + 1)]


@pytest.mark.parametrize(
    ("edge_deg", "law", "wanted"),
    [
        (20.0, np.tan, {"f tan \N{GREEK SMALL LETTER THETA}": 3.0}),
        (90.0, lambda theta: theta, {"f \N{GREEK SMALL LETTER THETA}": 3.0}),
    ],
)
def test_distortion_is_what_was_planted(edge_deg, law, wanted):
    field_deg = np.linspace(0, edge_deg, 15)
    theta = np.radians(field_deg)
    # 3 % at the edge, growing with theta^2; a scale of 1.01 is no distortion.
    height = 1.01 * 8.3e3 * law(theta) * (1 + 0.03 * (theta / theta[-1]) ** 2)
    found = distortions(field_deg, height)
    assert found.keys() == wanted.keys()
    for name, percent in found.items():
        np.testing.assert_allclose(
            percent, wanted[name] * (field_deg / edge_deg) ** 2, rtol=0, atol=1e-9
        )


def test_a_wide_lens_shows_both_laws_of_projection():
    field_deg = np.linspace(0, 60, 121)
    tangent, angle = distortions(field_deg, np.tan(np.radians(field_deg))).values()
    np.testing.assert_allclose(tangent, 0, atol=1e-9)
    exact = 100 * (np.tan(np.radians(60)) / np.radians(60) - 1)
    assert angle[-1] == pytest.approx(exact, abs=0.01)  # the scale on axis: theta^4 left out


def test_t_stop_and_working_f_number_are_those_of_the_axial_pupil(page: LensPage):
    bank = page.bank
    # An aplanatic lens at infinity works at its f-number; this one is within 1 %.
    assert working_f_number(bank) == pytest.approx(2.8, rel=0.01)
    bright = bank.projected_solid_angle_sr[bank.reference] * bank.transmission[bank.reference]
    assert np.pi / (4 * t_stop(bank) ** 2) == pytest.approx(bright, rel=1e-12)


def test_facts_have_the_first_order_data(page: LensPage, demo_lens):
    facts = dict(lens_facts(page.bank, page.system))
    order = first_order(demo_lens)
    assert facts["focal length"] == "8.3000 mm"
    assert facts["back focal length"] == f"{order.bfl_mm:.4f} mm"
    assert facts["f-number"] == "f/2.8"
    assert "NA 0.17" in facts["working f-number, NA"]
    beyond = re.fullmatch(
        r"up to (.*) %; past the period 0 %", facts["light beyond the PSFs' window"]
    )
    assert float(beyond[1]) == pytest.approx(100 * page.bank.outside_energy.max(), rel=0.05)
    assert facts["rays that failed"] == "0"
    for name in ("T-stop", "entrance pupil", "exit pupil", "image circle", "transmission"):
        assert facts[name]


def test_round_numbers_are_near_or_above():
    assert [page_numbers.round_near(v) for v in (0.95, 9.4, 47.0, 130.0)] == [1, 10, 50, 100]
    assert [page_numbers.round_above(v) for v in (0.93, 1.0, 11.0, 410.0)] == [1, 1, 15, 500]


# pictures


def test_the_radius_points_up():
    image = np.zeros((8, 8, 3))
    image[4, 7] = 1.0  # eta 0, xi at its greatest
    axes = Figure().add_subplot()
    spread.psf_image(axes, image, 1.0, 4.0)
    (shown,) = axes.get_images()
    row, col = np.argwhere(shown.get_array()[..., 0] == 1)[0]
    left, right, low, high = shown.get_extent()
    assert shown.origin == "lower"
    assert low + (row + 0.5) * (high - low) / 8 == 3.0  # up
    assert left + (col + 0.5) * (right - left) / 8 == 0.0


def test_equal_psfs_of_all_wavelengths_are_grey_and_unequal_ones_have_colour(page: LensPage):
    bank = page.bank
    spot = np.zeros((16, 16))
    spot[6:10, 6:10] = 1.0
    same = np.tile(spot, (len(bank.wavelengths_nm), 1, 1))
    picture = colour_image(same, bank)
    np.testing.assert_allclose(picture - picture[..., :1], 0, atol=1e-12)
    assert picture.max() == pytest.approx(1)
    apart = same.copy()
    apart[-2] = np.roll(spot, 3, axis=1)  # 650 nm
    red, green, _ = colour_image(apart, bank)[8, 11]
    assert red > 2 * green


def test_brightness_is_stretched_over_the_decades_that_the_page_states():
    light = np.array([1.0, 10**-1.5, 1e-3, 1e-9])
    np.testing.assert_allclose(spread.stretched(light), [1, 0.5, 0, 0], atol=1e-12)


@pytest.mark.parametrize("wavelength", [400.0, 425, 475, 500, 550, 600, 650, 700])
def test_wavelengths_have_colours_that_read_on_white(wavelength: float):
    colour = np.array(colours.wavelength_colour(wavelength))
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    # WCAG 2.2, 1.4.11: graphics need a contrast of 3 : 1.
    assert 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) >= 3
    hue = {400.0: 2, 425: 2, 475: 2, 550: 1, 650: 0, 700: 0}
    if wavelength in hue:
        assert colour.argmax() == hue[wavelength]


def test_no_two_labels_overlap_and_none_leaves_the_page(page: LensPage):
    figure = draw(page)
    shown = words(figure)
    assert len(shown) > 80
    assert overlaps(shown) == []
    width, height = figure.get_size_inches() * figure.dpi
    for text, box in shown:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


def test_labels_that_overlap_would_be_found():
    figure = Figure()
    figure.text(0.5, 0.5, "one")
    figure.text(0.51, 0.5, "two")
    assert overlaps(words(figure)) == [("one", "two")]


def test_names_at_the_ends_of_curves_keep_apart_and_inside():
    axes = Figure().add_subplot()
    axes.set_ylim(0, 1)
    drawing.end_labels(axes, [(0.99, "a", "k"), (1.0, "b", "k"), (0.985, "c", "k")])
    at = {text.get_text(): text.xy[1] for text in axes.texts}
    assert at["c"] < at["a"] < at["b"] <= 1
    height = axes.get_position().height * axes.figure.get_size_inches()[1] * 72
    assert min(at["a"] - at["c"], at["b"] - at["a"]) * height >= 9.9  # points


# a ready-made bank, and one without an axis


@pytest.fixture(scope="module")
def ready(page: LensPage) -> BankPage:
    return ready_page(page.bank)


def test_a_banks_own_mtf_is_that_of_its_pupils_but_for_the_window(page: LensPage, ready: BankPage):
    beyond = page.bank.outside_energy.max()
    assert beyond < 0.03
    for own, traced in zip(ready.curves, page.curves, strict=True):
        assert (own.name, own.field_deg) == (traced.name, traced.field_deg)
        for one, other in zip(own.against_frequency, traced.against_frequency, strict=True):
            there = page.frequency < ready.frequency[-1]
            found = np.interp(page.frequency[there], ready.frequency, one)
            # What the window has lost of the light counts at low frequencies; the wavelengths
            # between are every other one here.
            np.testing.assert_allclose(found, other[there], rtol=0, atol=2 * beyond)
        # With the halo, all but what lands beyond it.
        lost = page.bank.beyond_energy.max()
        np.testing.assert_allclose(own.against_frequency[:, 0], 1, atol=lost + 1e-6)
        assert lost < 1e-4
    np.testing.assert_allclose(ready.limit[0], 1)
    assert (ready.limit >= ready.curves[0].against_frequency - 2 * beyond).all()
    # Tangential and sagittal taken for one another would be seen.
    off_axis = page.curves[2].against_frequency
    assert np.abs(off_axis[0] - off_axis[1]).max() > 4 * beyond


def test_chief_rays_of_a_bank_are_those_of_its_map(page: LensPage, ready: BankPage):
    assert ready.chief_nm[0] == 550
    # Nearest to those that a lens's page draws.
    np.testing.assert_array_equal(np.sort(ready.chief_nm), [450.0, 550.0, 600.0, 650.0])
    traced = dict(zip(page.chief_nm, page.chief_um.T, strict=True))
    for line in (550.0, 600.0, 650.0):
        found = ready.chief_um[:, list(ready.chief_nm).index(line)]
        np.testing.assert_allclose(found, traced[line], rtol=0, atol=0.05)


def narrow(bank: Bank, fields: slice, lines: slice) -> Bank:
    """Return a part of a bank; the reference is its first wavelength."""
    both = {
        name: getattr(bank, name)[fields, lines]
        for name in (
            *("real_height_um", "psf", "relative_illumination", "outside_energy"),
            *("folded_energy", "fit_residual_waves", "failed_rays"),
        )
    }
    return replace(
        bank,
        **{name: getattr(bank, name)[fields, lines] for name in ("beyond_energy", "halo_misfit")},
        halo=bank.halo[:, fields, lines],
        ray_deg=None,
        ray_um=None,
        wavelengths_nm=bank.wavelengths_nm[lines],
        reference_nm=float(bank.wavelengths_nm[lines][0]),
        field_deg=bank.field_deg[fields],
        ideal_height_um=bank.ideal_height_um[fields],
        projected_solid_angle_sr=bank.projected_solid_angle_sr[lines],
        transmission=bank.transmission[lines],
        **both,
    )


@pytest.mark.parametrize(
    ("fields", "lines", "curves"),
    [
        (slice(None), slice(None), ["axis", "half field", "full field"]),
        (slice(None, 2), slice(2, 3), ["axis", "full field"]),
        (slice(None, 3), slice(1, 3), ["axis", "half field", "full field"]),
    ],
)
def test_the_page_of_any_bank_is_readable(ready: BankPage, fields, lines, curves):
    few = ready_page(narrow(ready.bank, fields, lines))
    assert [one.name for one in few.curves] == curves
    figure = draw_ready(few)
    shown = words(figure)
    assert overlaps(shown) == []
    said = " ".join(text for text, _ in shown)
    assert "Not drawn" in said
    assert ("the bank has one wavelength" in said) == (len(few.chief_nm) == 1)
    width, height = figure.get_size_inches() * figure.dpi
    for text, box in shown:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


def test_what_a_bank_does_not_know_is_said(ready: BankPage):
    unknown = np.full_like(ready.bank.folded_energy, np.nan)
    bank = replace(ready.bank, folded_energy=unknown, failed_rays=unknown)
    facts = dict(ready_facts(bank))
    assert facts["rays that failed"] == "not known"
    assert "past the period not known" in facts["light beyond the PSFs' window"]
    assert facts["fields, wavelengths"] == "5, 5"
    assert "length, vertex to vertex" not in facts


@pytest.fixture(scope="module")
def plane(demo_lens) -> PlanePage:
    # Symmetric, so that what it must show is known; and over more of y than of x.
    bank = compute_plane_bank(
        demo_lens, [500.0, 550.0, 600.0], [-6.0, 0.0, 6.0], [-6.0, 0.0, 6.0, 12.0], size=64
    )
    return plane_page(bank, build(demo_lens))


def test_maps_of_a_lens_with_an_axis_are_symmetric(plane: PlanePage):
    along_x, along_y = plane.mtf
    np.testing.assert_allclose(along_x[:3], along_y[:3].T, rtol=0, atol=2e-3)
    np.testing.assert_allclose(plane.lateral_um[:3], plane.lateral_um[:3].T, atol=1e-4)
    assert 0.3 < along_x[1, 1] < 0.7
    # Off in y, x is the sagittal direction: the wrong one would be seen.
    assert abs(along_x[3, 1] - along_y[3, 1]) > 0.02


def test_arrows_show_the_distortion(plane: PlanePage, page: LensPage):
    away, ideal = plane.away_um[3, 1], plane.ideal_um[3, 1]
    height = 1e3 * plane.bank.efl_mm * np.tan(np.radians(12.0))
    np.testing.assert_allclose(ideal, [0, height], atol=1e-3)
    real, _ = page.bank.height_from_angle(12.0)
    np.testing.assert_allclose(away, [0, real - height], atol=0.05)
    assert abs(away[1]) > 1
    np.testing.assert_allclose(plane.away_um[1, 1], 0, atol=1e-9)


def test_light_to_the_right_and_up_is_shown_there(plane: PlanePage):
    psf = np.zeros_like(plane.bank.psf)
    psf[..., 32, 32] = 0.4  # rows y, columns x
    psf[..., 32 + 6, 32 + 2] = 0.6
    figure = Figure(figsize=(12, 12))
    _psfs(figure, replace(plane.bank, psf=psf), 1.0, 1.0, 6.0)
    for axes in figure.axes:
        (shown,) = axes.get_images()
        picture = np.asarray(shown.get_array()).sum(axis=-1)
        row, col = np.unravel_index(picture.argmax(), picture.shape)
        assert shown.origin == "lower"
        # Lateral colour moves the outer wavelengths by less than 2 samples.
        assert row - 32 == pytest.approx(6, abs=2)
        assert col - 32 == pytest.approx(2, abs=2)
    boxes = np.array([axes.get_position().bounds[:2] for axes in figure.axes]).reshape(4, 3, 2)
    assert (np.diff(boxes[..., 0], axis=1) > 0).all()
    assert (np.diff(boxes[..., 1], axis=0) > 0).all()  # field y rises upwards


@pytest.mark.parametrize("known", [True, False])
def test_the_page_of_a_lens_without_an_axis_is_readable(plane: PlanePage, known: bool):
    one = plane if known else plane_page(plane.bank, None)
    figure = draw_plane(one)
    shown = words(figure)
    assert overlaps(shown) == []
    said = " ".join(text for text, _ in shown)
    assert ("no surfaces" in said) != known
    assert ("back focal length" in said) == known
    width, height = figure.get_size_inches() * figure.dpi
    for text, box in shown:
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


def test_a_field_of_90_degrees_has_no_ideal_image(plane: PlanePage):
    wide = replace(plane.bank, field_y_deg=np.array([-60.0, 0.0, 60.0, 95.0]))
    page = plane_page(wide, None)
    np.testing.assert_array_equal(np.isnan(page.away_um[..., 0]).any(axis=1), [0, 0, 0, 1])
    assert overlaps(words(draw_plane(page))) == []


def test_an_apodised_stop_is_on_the_page(demo_lens):
    filtered = demo_lens.model_copy(update={"gaussian_apodisation": 1.0})
    bank = compute_bank(filtered, [500.0, 550.0, 600.0], [0.0, 7.0, 14.0], size=64)
    page = lens_page(bank, build(filtered))
    facts = dict(lens_facts(bank, page.system))
    assert "exp(-1 " in facts["apodised stop"]
    # The limit is that of the apodised pupil: above the MTF, and below that of an even one at high
    # frequency.
    axis = page.curves[0].against_frequency
    assert (axis <= page.limit + 2e-3).all()
    assert page.limit[0] == pytest.approx(1, abs=3e-3)
    even = diffraction_mtf(page.frequency, 550.0, 2.8)
    high = page.frequency > 400
    assert high.any()
    assert (page.limit[high] < even[high] - 0.02).all()


# files


def test_the_picture_has_its_size_and_is_not_empty(page: LensPage):
    picture = Image.open(io.BytesIO(png(draw(page))))
    assert picture.size == (1920, 2144)
    assert len(np.unique(np.asarray(picture.convert("L")))) > 100


def test_the_drawing_is_the_same_each_time_and_needs_nothing_from_elsewhere(page: LensPage):
    text = svg(draw(page, titled=False))
    assert text == svg(draw(page, titled=False))
    for link in re.findall(r'(?:href|src)="([^"]*)"', text):
        assert link.startswith(("#", "data:"))
    assert "<text" not in text  # letters are outlines: no font is asked for


class Links(HTMLParser):
    """Collects what a document would load, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember links."""
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        """Remember a text."""
        self.texts.append(data)


def test_the_html_page_is_whole_in_itself_and_has_all_numbers(page: LensPage, demo_lens):
    import_log = demo_lens.import_log
    text = lens_html(page, checked(demo_lens), import_log)
    document = Links(text)
    (picture,) = document.loaded
    head, _, data = picture.partition(",")
    assert head == "data:image/svg+xml;base64"
    assert base64.b64decode(data).decode().rstrip().endswith("</svg>")
    words = " ".join(document.texts)
    for expected in ("8.3000 mm", "closed to f/2.8", "N-BAF10", "6 stop", "refractiveindex"):
        assert expected in words


def test_markup_in_a_lens_file_stays_text(page: LensPage, demo_lens):
    named = demo_lens.model_copy(update={"title": "<b>lens</b>", "notes": "<script>"})
    system = replace(page.system, prescription=named)
    text = lens_html(replace(page, system=system), [], demo_lens.import_log)
    assert "<b>lens</b>" not in text
    assert "<script>" not in text
    assert "&lt;b&gt;lens&lt;/b&gt;" in text
