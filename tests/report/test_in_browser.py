"""The report in Chromium, as wide as a phone and dark: its figures, its loupe and its PSFs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from browser import chromium
from fake_capture import fake_capture
from optics.angled import angled, lens, unlike
from PIL import Image

from gpusim import report
from gpusim.optics.angular import AngularResponse
from gpusim.psf.local import LocalPsfs

pytestmark = pytest.mark.slow
PHONE = {"width": 390, "height": 844}
ROWS, COLS = 48, 64
COLOURS = np.array([[[220, 30, 30], [30, 200, 30]], [[30, 30, 220], [210, 210, 40]]], np.uint8)
# Contrast of WCAG 2.1 of each text of the figures drawn in the page with the page's ground.
CONTRASTS = """
() => {
  const light = (colour) => {
    const [r, g, b] = colour.match(/[0-9.]+/g).map((one) => {
      const share = one / 255;
      return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
    });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05;
  };
  const ground = light(getComputedStyle(document.body).backgroundColor);
  return [...document.querySelectorAll("svg text")].map((text) => {
    const ink = light(getComputedStyle(text).fill);
    return Math.max(ink, ground) / Math.min(ink, ground);
  });
}
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return a report with every part it may have, open in a browser."""
    camera = angled(unlike())
    plain = fake_capture()
    response = AngularResponse(lens(falloff=0.0), camera)
    plain.plan.basis.elsewhere = SimpleNamespace(response=response)
    capture = replace(plain, camera=replace(plain.camera, sensor=camera))
    facts = report.facts(capture, files=["raw.dng", "a_" * 60], command=["gpusim", "x" * 200])
    light = np.zeros((2, 16, 16))
    light[0, 8, 8], light[1, 8, 1:-1] = 1.0, 1.0
    # The frame lies left of and above the axis: its pixels of 1.55 um reach to -99 and -74 um.
    psfs = LocalPsfs(np.array([[0.0, 0.0], [-90.0, -70.0]]), False, light, 12.0)
    picture = COLOURS.repeat(ROWS // 2, axis=0).repeat(COLS // 2, axis=1)
    folder = tmp_path_factory.mktemp("report")
    Image.fromarray(picture).save(folder / "developed.png")
    (folder / "report.html").write_text(report.page(facts, picture, psfs))
    with chromium() as launch:
        page = launch().new_page(viewport=PHONE, color_scheme="dark")
        page.said = []
        page.on("pageerror", lambda error: page.said.append(str(error)))
        page.goto((folder / "report.html").as_uri())
        yield page
        assert page.said == []


def colour_at(page: Any, x: float, y: float) -> np.ndarray:
    """Return what is shown at a place of the window."""
    shot = page.screenshot(clip={"x": x, "y": y, "width": 1, "height": 1})
    return np.array(Image.open(io.BytesIO(shot)))[0, 0, :3].astype(int)


def test_no_line_is_wider_than_a_phone(page: Any):
    for opened in ("false", "true"):
        every = "document.querySelectorAll('details')"
        page.evaluate(f"{every}.forEach((one) => one.open = {opened})")
        assert page.evaluate("document.scrollingElement.scrollWidth") <= PHONE["width"]
    boxes = [one.bounding_box() for one in page.query_selector_all("img.sheet, svg.map")]
    assert len(boxes) == 3  # quantum efficiency, histogram, probes
    assert all(0 < one["x"] and one["x"] + one["width"] <= PHONE["width"] for one in boxes)
    # Of a figure of 4.8 by 3.6 inches, to a pixel.
    card = page.query_selector("img.sheet").bounding_box()
    assert card["height"] == pytest.approx(card["width"] * 3.6 / 4.8, abs=1)


def test_figures_are_legible_in_the_dark(page: Any):
    ground = "getComputedStyle({}).backgroundColor"
    assert page.evaluate(ground.format("document.body")) == "rgb(18, 21, 25)"
    card = "document.querySelector('img.sheet')"
    assert page.evaluate(ground.format(card)) == "rgb(255, 255, 255)"
    assert page.evaluate(f"{card}.decode().then(() => {card}.naturalWidth)") > 0
    contrasts = page.evaluate(CONTRASTS)
    assert len(contrasts) >= 2
    assert min(contrasts) >= 4.5  # WCAG 2.1, 1.4.3, level AA


def test_the_loupe_follows_the_pointer(page: Any):
    page.evaluate("scrollTo(0, 0)")
    loupe, said = page.query_selector(".loupe"), page.query_selector(".loupe-at")
    assert not loupe.is_visible()
    box = page.query_selector(".overview img").bounding_box()
    for row, col in np.ndindex(2, 2):
        down, across = 0.25 + 0.5 * row, 0.25 + 0.5 * col
        page.mouse.move(box["x"] + across * box["width"], box["y"] + down * box["height"])
        assert loupe.is_visible()
        # Half of a pixel of the window is less than one of the picture.
        assert said.inner_text() == f"row {12 + 24 * row}, column {16 + 32 * col}, 4 times"
        shown = loupe.bounding_box()
        middle = shown["x"] + shown["width"] / 2, shown["y"] + shown["height"] / 2
        assert np.abs(colour_at(page, *middle) - COLOURS[row, col]).max() <= 2
    page.mouse.wheel(0, -100)
    page.wait_for_function("document.querySelector('.loupe-at').textContent.endsWith('8 times')")
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] + 60)
    assert not loupe.is_visible()


def test_a_click_shows_the_psf_of_its_place(page: Any):
    box = page.query_selector(".overview img").bounding_box()
    said = page.query_selector(".psf-at")
    pane = "document.querySelector('[data-psf]')"
    light = f"{pane}.getContext('2d').getImageData(30, 120, 1, 1).data[0]"
    seen = []
    for share in (0.975, 0.02):
        page.mouse.click(box["x"] + share * box["width"], box["y"] + share * box["height"])
        seen.append((said.inner_text(), page.evaluate(light)))
    assert seen[0][0].startswith("Row 46, column 62: 0.00 mm from the axis, PSF of 0.00 mm;")
    assert seen[1][0].startswith("Row 0, column 1: 0.12 mm from the axis, PSF of 0.11 mm;")
    # The second PSF is a line across, the first a point in the middle.
    assert seen[0][1] < 80 < 200 < seen[1][1]
