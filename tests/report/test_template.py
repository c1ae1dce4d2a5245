"""Templates: what others wrote is text on every page, and a name that nobody gave is an error."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from fake_capture import fake_capture
from jinja2 import UndefinedError
from matplotlib.figure import Figure

import gpusim
from gpusim import report
from gpusim.batch.page import batch_page
from gpusim.cli.everything import _page
from gpusim.report.sheet import Table, sheet
from gpusim.report.template import filled
from gpusim.validate.report import Report, Rows, Section

PACKAGE = Path(gpusim.__file__).parent
TEMPLATES = {
    file.relative_to(PACKAGE).as_posix(): file.read_text()
    for file in PACKAGE.rglob("*.html")
    if file.parent != PACKAGE / "web/page"  # for browsers as it is
}
MARKUP = """<script>alert(1)</script>&"'"""
TABLE = Table(MARKUP, [MARKUP, "n"], [[(MARKUP, "good"), 1.0], [MARKUP, 1.0]])
FIGURE = Figure(figsize=(1, 1))


def marked(facts: Any) -> Any:
    """Return facts with markup before every text."""
    if isinstance(facts, dict):
        return {name: marked(value) for name, value in facts.items()}
    if isinstance(facts, list):
        return [marked(value) for value in facts]
    return MARKUP + facts if isinstance(facts, str) else facts


def report_page() -> str:
    facts = report.facts(fake_capture(), files=["raw.dng"], command=["gpusim"])
    return report.page(marked(facts), np.zeros((6, 8, 3), np.uint8))


def noise_page() -> str:
    page = {"title": MARKUP, "summary": MARKUP, "figure": FIGURE, "notes": [MARKUP]}
    return filled("report/templates/noise.html", **page, tables=[TABLE], within=None)


def lens_page() -> str:
    texts = dict.fromkeys(("title", "summary", "shows", "notes", "origin"), MARKUP)
    rows = {name: [[MARKUP]] for name in ("checks", "surfaces", "import_log")}
    pairs = {name: {MARKUP: MARKUP} for name in ("data", "provenance")}
    figures = {"figure": FIGURE, "plots": [(MARKUP, FIGURE)]}
    return filled("report/templates/lens.html", **texts, **rows, **pairs, **figures)


def a_batch() -> str:
    failed = [{"number": 0, "settings": {"lens": MARKUP}, "error": MARKUP}]
    sweep = MagicMock(camera=MARKUP, axes={}, __len__=lambda _: 1)
    found = {"done": [], "failed": failed, "new": 0, "seconds": 1.0}
    return batch_page(SimpleNamespace(sweep=sweep, **found))


def tolerances() -> str:
    raw = {"camera": MARKUP, "apart_most_cy_px": 0.1, "certificate_total_rms": 0.1}
    facts = {"agreement": {"traced": 0}, "raws": [raw]}
    texts = {"title": MARKUP, "summary": MARKUP}
    return filled("tolerance/page.html", **texts, cameras=FIGURE, raws=None, facts=facts)


def validation() -> str:
    rows = Rows([MARKUP], [[MARKUP]], [(1, MARKUP)])
    section = Section(MARKUP, MARKUP, "one", FIGURE, rows)
    return Report("", MARKUP, MARKUP, MARKUP, [], [section]).html({"one": b""})


def everything() -> str:
    return _page(MARKUP, PACKAGE, [], {MARKUP: MARKUP})


PAGES = {
    "batch/page.html": a_batch,
    "cli/everything.html": everything,
    "report/templates/lens.html": lens_page,
    "report/templates/noise.html": noise_page,
    "report/templates/report.html": report_page,
    "report/templates/sheet.html": lambda: sheet(MARKUP, MARKUP, FIGURE, MARKUP, TABLE),
    "tolerance/page.html": tolerances,
    "validate/report.html": validation,
}


def test_every_page_is_tried():
    assert {name for name, text in TEMPLATES.items() if "{% extends" in text} == PAGES.keys()


@pytest.mark.parametrize("name", PAGES)
def test_what_others_wrote_is_text(name: str):
    page = PAGES[name]()
    assert "<script>alert" not in page and '&"' not in page
    assert page.count("&lt;script&gt;alert(1)&lt;/script&gt;&amp;&#34;&#39;") > 1


def test_only_pages_of_ours_are_taken_as_they_are():
    assert [name for name, text in TEMPLATES.items() if "safe" in text] == ["cli/everything.html"]


def test_nothing_is_escaped_by_hand():
    modules = PACKAGE.rglob("*.py")
    assert [file for file in modules if "html import escape" in file.read_text()] == []


def test_a_name_that_nobody_gave_is_an_error():
    given = {"title": "", "summary": "", "figure": FIGURE, "shows": ""}
    with pytest.raises(UndefinedError, match="tables"):
        filled("report/templates/sheet.html", **given)
    assert "</html>" in filled("report/templates/sheet.html", **given, tables=[])
