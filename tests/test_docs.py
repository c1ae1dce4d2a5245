"""Files that the pages for developers name are there, and so is what README links to."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

PROJECT = Path(__file__).resolve().parents[1]
FOLDERS = ("gpusim", "shaders", "tests", "tools", "docs")


def lacking(text: str, folder: Path = PROJECT) -> list[str]:
    """Return the files of the project that a text names or links to, and that are not there."""
    named = [one for one in re.findall(r"`([\w./-]+/[\w./-]*)`", text) if one.startswith(FOLDERS)]
    named = [one for one in named if "FOLDER" not in one and "WORD" not in one]
    linked = [one for one in re.findall(r"\]\(([^)#:]+)\)", text)]
    found = [one for one in named if not (PROJECT / one).exists()]
    return found + [one for one in linked if not (folder / one).exists()]


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md", "README.md"])
def test_what_a_page_names_is_there(page: str):
    path = PROJECT / page
    assert not lacking(path.read_text(encoding="utf-8"), path.parent)


def test_a_file_that_is_gone_is_found():
    text = "see `gpusim/camera.py`, `gpusim/gone.py`, `any/other.py` and [a page](docs/none.md)"
    assert lacking(text) == ["gpusim/gone.py", "docs/none.md"]


def test_the_citation_names_the_version_of_the_package():
    import gpusim

    cited = yaml.safe_load((PROJECT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == gpusim.__version__ and cited["cff-version"] == "1.2.0"
