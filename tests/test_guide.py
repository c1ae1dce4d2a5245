"""The Python of README and guide runs as it stands, block after block, in an empty folder."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from formats.written import zmx_text

from gpusim.lens.prescription import Prescription
from gpusim.lens.system import first_order

PROJECT = Path(__file__).resolve().parents[1]


def blocks(page: str) -> list[str]:
    """Return a page's blocks of Python, each after as many lines as stand before it there."""
    text = (PROJECT / page).read_text()
    found = re.finditer(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return ["\n" * text[: one.start(1)].count("\n") + one[1] for one in found]


def test_the_guide_has_blocks():
    assert len(blocks("README.md")) == 1 and len(blocks("docs/library.md")) >= 6


@pytest.mark.slow
@pytest.mark.parametrize("page", ["README.md", "docs/library.md"])
def test_the_python_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, double_gauss: Prescription
):
    """A mistake's traceback names the page and its line."""
    monkeypatch.chdir(tmp_path)
    lens = Path("my-lens.zmx")  # what the guide calls yours
    lens.write_text(zmx_text(double_gauss, first_order(double_gauss).bfl_mm))
    known: dict[str, object] = {}
    for block in blocks(page):
        exec(compile(block, page, "exec"), known)
    assert (tmp_path / "a.dng").stat().st_size > 1000
