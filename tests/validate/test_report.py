"""A validation's report: the same bars and tables in HTML, Markdown and JSON."""

import json

import pytest
from matplotlib.figure import Figure

from gpusim.validate.bars import Bar
from gpusim.validate.report import Report, Rows, Section


@pytest.fixture
def report():
    bars = [Bar("edges", 0.004, 0.02, "px", 3), Bar("MTF <1", 0.2, 0.01, "1", 2)]
    rows = Rows(("edge", "error"), [["1", "+0.004"]], [(2, "ours")])
    sections = [
        Section("A figure", "What it shows.", name="one", figure=Figure()),
        Section("A table", rows=rows),
    ]
    return Report("paper", "Title", "Somebody (1999)", "Text", bars, sections, {"extra": [1.0]})


def test_the_numbers_hold_every_bar_with_its_verdict(report):
    facts = json.loads(json.dumps(report.facts(), allow_nan=False))
    assert [bar["held"] for bar in facts["bars"]] == [True, False]
    assert facts["extra"] == [1.0]
    assert facts["paper"] == "Somebody (1999)"


def test_the_page_shows_bars_figures_and_tables(report):
    page = report.html({"one": b"png"})
    assert page.count(">held<") == 1
    assert page.count("NOT HELD") == 1
    assert "MTF &lt;1" in page
    assert "data:image/png;base64,cG5n" in page
    assert '<th colspan="2">ours</th>' in page
    assert "+0.004" in page


def test_markdown_names_the_figures_files(report):
    page = report.markdown({"one": "figure.png"})
    assert "![A figure](figure.png)" in page
    assert "| MTF <1 | 0.2 | 0.01 | 1 | **no** |" in page
    assert "| 1 | +0.004 |" in page
