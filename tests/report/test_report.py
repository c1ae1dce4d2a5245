"""The report: report.json holds every fact, report.html shows them and no markup of others."""

from __future__ import annotations

import base64
import io
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from fake_capture import COLS, POINTS, ROWS, RUNNERS_UP, STAGES, fake_capture
from PIL import Image

from gpusim import report
from gpusim.config.plain import plain
from gpusim.gpu.wgsl import shaders_sha256
from gpusim.plan import Accuracy
from gpusim.report.histogram import histogram_facts
from gpusim.report.probes import probe_map
from gpusim.report.words import duration, error, exposure, mebibytes

FILES = ["raw.dng", "report.json"]
COMMAND = ["gpusim", "render", "<i>camera</i>", "demo"]
SIZE = {"rows": ROWS, "cols": COLS}
VOID = {"meta", "img", "br"}


@pytest.fixture(scope="module")
def facts() -> dict:
    return report.facts(fake_capture(), files=FILES, command=COMMAND)


@pytest.fixture(scope="module")
def developed() -> np.ndarray:
    return np.random.default_rng(2).integers(0, 256, (800, 1200, 3)).astype(np.uint8)


@pytest.fixture(scope="module")
def page(facts: dict, developed: np.ndarray) -> str:
    return report.page(facts, developed)


class Tags(HTMLParser):
    """Collects text and attributes; fails where tags do not close in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.texts: list[str] = []
        self.attributes: list[tuple[str, str, str | None]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember a tag and its attributes."""
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember the attributes of a tag that closes itself."""
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        """Check the order."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Remember a text."""
        self.texts.append(data)


# facts


def test_facts_are_json_and_have_every_parameter(facts: dict):
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts
    assert (
        facts["capture"]
        | {
            "rows": ROWS,
            "cols": COLS,
            "exposure_s": 1 / 60,
            "seed": 7,
            "frame": 3,
            "wall_s": 2.25,
            "tolerance": 1e-3,
            "tolerance_unit": "relative",
        }
        == facts["capture"]
    )
    assert facts["camera"]["sensor"]["pixel_pitch_um"] == 1.55
    assert facts["camera"]["lens"]["patent"] == "US 2,673,491"
    assert facts["scene"]["name"] == "demo"
    assert facts["device"]["driver"] == "a driver"
    assert facts["versions"]["wgpu"] == "0.32.0"
    assert [stage["reason"] for stage in facts["plan"]["stages"]] == [s.reason for s in STAGES]
    assert facts["plan"]["scales"][0]["length"] == 256
    assert facts["plan"]["runners_up"] == plain(RUNNERS_UP)
    assert (facts["plan"]["predicted_s"], facts["plan"]["rates"]) == (1.75, "rates of a test")
    assert facts["times_s"]["fft rows"] == 1.5
    assert [point["truth"] for point in facts["certificate"]["points"]] == [100.0, 50.0]
    assert facts["files"] == FILES
    assert facts["command"] == COMMAND


def test_the_digest_of_the_raw_changes_with_one_sample(facts: dict):
    capture = fake_capture()
    raw = capture.raw.copy()
    raw[0, 0] ^= 1
    changed = report.facts(replace(capture, raw=raw), files=FILES, command=COMMAND)
    assert changed["capture"]["raw_sha256"] != facts["capture"]["raw_sha256"]


def test_the_digest_of_the_shaders_changes_with_text_and_name(tmp_path, monkeypatch):
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(tmp_path))
    seen = set()
    for name, text in (("a", "1"), ("a", "2"), ("b", "2")):
        for file in tmp_path.iterdir():
            file.unlink()
        (tmp_path / f"{name}.wgsl").write_text(text)
        seen.add(shaders_sha256())
    assert len(seen) == 3


def test_what_is_not_finite_becomes_null():
    assert plain({"a": math.nan, "b": (np.float32(math.inf), np.array([1.5, -math.inf]))}) == {
        "a": None,
        "b": [None, [1.5, None]],
    }


# page


def test_the_page_is_well_formed_and_loads_nothing(page: str):
    for tag, name, value in Tags(page).attributes:
        if name in ("src", "href") and tag != "a":
            assert value.startswith("data:image/")
    assert "url(" not in page
    # The scripts are those of loupe and PSF, and take nothing but the picture beside the page.
    assert page.count("<script") == 2
    script = page[page.index("<script>") :]
    for word in ("fetch", "import", "http", "XMLHttp", "eval", "localStorage"):
        assert word not in script
    assert script.count(".src = ") == 2 and 'data-whole="developed.png"' in page


def test_the_picture_comes_first_and_the_engine_is_folded(page: str):
    order = ["The picture", "The raw", "Certificate", "What was done", "Parameters, versions"]
    places = [page.index(f">{title}") for title in order]
    assert places == sorted(places)
    assert page.index('class="cards"') > places[1]
    assert page.count('<details class="part">') == 2


def test_the_raws_histogram_counts_every_lit_pixel():
    capture = fake_capture()
    found = histogram_facts(capture)
    assert list(found["channels"]) == ["R", "G", "B"]
    counted = {name: sum(one["counts"]) for name, one in found["channels"].items()}
    assert counted == {"R": ROWS * COLS // 4, "G": ROWS * COLS // 2, "B": ROWS * COLS // 4}
    letters = np.array(capture.camera.sensor.cfa.letters)
    row, col = np.argwhere(letters == "R")[0]
    red = capture.raw[row::2, col::2]
    assert found["channels"]["R"]["median_dn"] == np.median(red)
    top = found["saturation_dn"]
    assert found["channels"]["R"]["saturated_share"] == np.mean(red >= top)
    # EMVA 1288's model: read noise and shot noise of the median's electrons, and rounding.
    sensor, one = capture.camera.sensor, found["channels"]["G"]
    signal = (one["median_dn"] - sensor.black_level_dn) / sensor.system_gain_dn_per_e
    rounding = 1 / 12 / sensor.system_gain_dn_per_e**2
    noise = np.sqrt(sensor.temporal_dark_noise_e**2 + signal + rounding)
    assert one["median_snr_db"] == pytest.approx(20 * np.log10(signal / noise), abs=0.1)


def test_the_page_shows_stages_times_reasons_and_certificate(page: str):
    text = " ".join(Tags(page).texts)
    for words in (
        "250 ms",
        "left out: the scene is a <chart> & needs none",
        "2.0e-04",
        "1.4e-03",
        "beyond the tolerance of 0.001",
        "a word on confidence",
        "a word on how the bank was measured",
        "window: light that no PSF holds",
        "5.0e-05",
        "lens 125 ms",
        "US 2,673,491",
        "fft & <whole> PSFs",
        "rates of a test",
        "1.75 s",  # predicted, of all
        "too dear: 3.25 s against 1.75 s",
        "error of its cut",
        "gpusim render <i>camera</i> demo",
    ):
        assert words in text, words


def test_the_error_budget_fits_a_phone(page: str):
    """Its words take lines, so that the numbers beside them stay on the page at 390 px."""
    assert page.count('<td class="words">') == 5
    assert '<td class="words">engine: ' in page and '<td class="words">total</td>' in page
    assert "td.words, th.words { white-space: normal; }" in page


def test_a_tolerance_in_sigmas_is_judged_in_sigmas():
    capture = replace(fake_capture(), accuracy=Accuracy(0.1, 2, "sigma"))
    judged = {"unit": "sigma", "engine_rms": 1e-2, "total_rms": 1.1e-2, "total_worst": 1.5e-2}
    capture = replace(capture, certificate=replace(capture.certificate, **judged))
    facts = report.facts(capture, files=FILES, command=COMMAND)
    text = " ".join(Tags(report.page(facts, np.zeros((ROWS, COLS, 3), np.uint8))).texts)
    for words in (
        "0.011 sigma",
        "RMS error in sigmas of the noise, all parts, beyond the tolerance of 0.1 sigma",
        "0.015 sigma",
        "worst of 2 probes, at row 40, column 60",
    ):
        assert words in text, words


def test_what_others_wrote_is_escaped(page: str):
    assert "<chart>" not in page and "<whole>" not in page and "<4>" not in page
    assert "<i>camera" not in page


def test_the_crops_are_the_pixels_of_the_picture(page: str, developed: np.ndarray):
    found = re.findall(r"data:image/png;base64,([^\"]+)", page)
    crops = [np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))) for data in found]
    assert len(crops) == 3
    # The centre, half way to the upper right corner, and the corner.
    for crop, (top, left) in zip(crops, ((240, 440), (40, 740), (0, 880)), strict=True):
        np.testing.assert_array_equal(crop, developed[top : top + 320, left : left + 320])


def test_the_overview_is_the_reduced_picture(facts: dict):
    # A ramp of 2800 columns: the overview of 1400 px averages pairs.
    ramp = np.broadcast_to(np.linspace(0, 255, 2800), (64, 2800))
    picture = np.repeat(ramp[..., None], 3, axis=2).astype(np.uint8)
    (data,) = re.findall(r"data:image/jpeg;base64,([^\"]+)", report.page(facts, picture))
    overview = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    assert overview.shape == (32, 1400, 3)
    # JPEG at quality 88 keeps a ramp to 2 levels.
    assert np.abs(overview.astype(int) - picture[::2, ::2].astype(int)).max() <= 2


def test_a_picture_smaller_than_a_crop_is_shown_whole_and_once(facts: dict):
    small = np.zeros((3, 5, 3), np.uint8)
    page = report.page(facts, small)
    assert 'width="5" height="3"' in page
    assert len(re.findall(r"<figcaption>[^<]+: from row 0, column 0", page)) == 1


def test_without_certificate_the_page_says_so(developed: np.ndarray):
    facts = report.facts(fake_capture(certified=False), files=FILES, command=COMMAND)
    assert facts["certificate"] is None
    text = " ".join(Tags(report.page(facts, developed)).texts)
    assert "not certified" in text


# the map of probes


def test_each_probe_lies_on_its_pixel_and_the_worst_is_ringed():
    probes = plain(sorted(POINTS, key=lambda probe: -probe.relative))
    places = np.array([(5.5, 3.5), (60.5, 40.5), (60.5, 40.5)])
    for row, col in ((0, 0), (2, 4)):  # a rectangle that begins there
        drawn = probe_map(probes, {**SIZE, "first_row": row, "first_col": col})
        circles = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"[^>]*?fill="([^"]+)"', drawn)
        found = [(float(x), float(y)) for x, y, _ in circles]
        assert found == [(x - col, y - row) for x, y in places]
        assert circles[-1][2] == "none"


@pytest.mark.parametrize(
    ("relative", "colour"),
    [(0.0, "#440154"), (1e-9, "#440154"), (1e-4, "#21918c"), (1e-2, "#fde725"), (1.0, "#fde725")],
)
def test_colours_run_over_viridis_from_1e_6_to_1e_2(relative: float, colour: str):
    probes = [{"row": 0, "col": 0, "relative": relative}]
    assert f'fill="{colour}"><title>' in probe_map(probes, SIZE | {"first_row": 0, "first_col": 0})


# words


def test_exposures_read_as_photographers_write_them():
    assert [exposure(s) for s in (1 / 60, 0.3, 1.0, 2.5)] == ["1/60 s", "0.3 s", "1 s", "2.5 s"]


def test_memory_is_rounded_up_to_whole_mebibytes():
    sizes = (0, 1, 2**20, 2**20 + 1, 2**30)
    assert [mebibytes(n) for n in sizes] == ["0 MiB", "1 MiB", "1 MiB", "2 MiB", "1024 MiB"]


def test_durations_keep_three_digits():
    assert [duration(s) for s in (None, 12.34, 1.0, 0.01234, 1.5e-5)] == [
        "\N{EN DASH}",
        "12.3 s",
        "1 s",
        "12.3 ms",
        "15 us",
    ]


def test_errors_keep_two_digits():
    assert [error(e) for e in (None, 0.0, 1.234e-3)] == ["\N{EN DASH}", "0", "1.2e-03"]
