"""Files that the pages for developers name are there, and so is what README links to."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer
import yaml

from gpusim.cli.app import app

PROJECT = Path(__file__).resolve().parents[1]
FOLDERS = ("gpusim", "shaders", "tests", "tools", "docs")


def lacking(text: str, folder: Path = PROJECT) -> list[str]:
    """Return the files of the project that a text names or links to, and that are not there."""
    named = [one for one in re.findall(r"`([\w./-]+/[\w./-]*)`", text) if one.startswith(FOLDERS)]
    named = [one for one in named if "FOLDER" not in one and "WORD" not in one]
    linked = [one for one in re.findall(r"\]\(([^)#:]+)\)", text)]
    found = [one for one in named if not (PROJECT / one).exists()]
    return found + [one for one in linked if not (folder / one).exists()]


@pytest.mark.parametrize(
    "page",
    [
        *("CONTRIBUTING.md", "README.md", "docs/architecture.md", "docs/glossary.md"),
        *("docs/library.md", "docs/commands.md", "docs/stages.md", "docs/index.md"),
    ],
)
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


def commands(page: str) -> list[str]:
    """Return the lines that a page tells one to type, without what they are for."""
    text = (PROJECT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    lines = [line.split("  #")[0].strip() for block in blocks for line in block.splitlines()]
    return [line for line in lines if line]


def parsed(words: list[str]) -> str:
    """Parse a command line of ours as the command would, and return the command's name."""
    command, given = typer.main.get_command(app), words
    with command.make_context("gpusim", list(given)) as context:
        while hasattr(command, "commands"):
            name, command, given = command.resolve_command(context, given)
        command.make_context(name, list(given), parent=context)  # raises for what it does not know
    return name


SHOWN = [(page, line) for page in ("README.md", "docs/commands.md") for line in commands(page)]


@pytest.mark.parametrize(("page", "line"), SHOWN, ids=lambda text: text[:40])
def test_a_command_that_a_page_shows_is_one(page: str, line: str):
    program, *words = shlex.split(line)
    if program == "make":
        targets = re.findall(r"^(\w+):", (PROJECT / "Makefile").read_text(), re.MULTILINE)
        assert words[0] in targets
    else:
        assert program == ".venv/bin/gpusim" and parsed(words)


def test_a_command_that_is_none_is_refused():
    for words in (["rendr", "demo"], ["render", "demo", "demo", "--out", "a", "--expozure", "1"]):
        with pytest.raises(Exception, match=r"(?i)no such"):
            parsed(words)


def test_the_python_of_the_readme_is_that_of_the_library():
    """Each name that it asks of `gs`, of lights, frames and lenses is there."""
    import gpusim as gs
    from gpusim.library.burst import Burst

    (code,) = re.findall(r"```python\n(.*?)```", (PROJECT / "README.md").read_text(), re.DOTALL)
    compile(code, "README.md", "exec")
    assert all(hasattr(gs, name) for name in re.findall(r"gs\.(\w+)", code))
    kinds = {"light": gs.Light, "frame": gs.Frame, "lens": gs.Lens, "burst": Burst}
    for kind, name in re.findall(r"\b(light|frame|lens|burst)\.(\w+)", code):
        if name != "npz":
            assert hasattr(kinds[kind], name) or name in kinds[kind].__dataclass_fields__


OURS = [
    ("kodak", r"by up to ([\d.]+) and ([\d.]+) px", ["R to G", "B to G"]),
    (
        "ansys",
        r"LGD within ([\d.]+) % points, sinusoids within ([\d.]+) %, SFR within ([\d.]+) of",
        ["LGD at every radius", "peaks of", "SFR of ROI"],
    ),
    (
        "samsung",
        r"edges within ([\d.]+) of the step, corners within ([\d.]+) px RMS, "
        r"QE within ([\d.e-]+), colour within ([\d.]+) xy",
        ["ESF of", "corners of", "QE by field", "chromaticity"],
    ),
]


@pytest.mark.parametrize(("report", "words", "bars"), OURS)
def test_readme_has_the_figures_of_the_validations_pages(report: str, words: str, bars: list[str]):
    page = (PROJECT / f"docs/validation-{report}.md").read_text()
    rows = re.findall(r"^\| (.+?) \| ([\d.e+-]+) \| [\d.e+-]+ \| .+ \| (yes|no) \|$", page, re.M)
    (line,) = [
        one for one in (PROJECT / "README.md").read_text().splitlines()
        if f"(docs/validation-{report}.md)" in one
    ]  # fmt: skip
    assert "all of our bars held" in line and {held for _, _, held in rows} == {"yes"}
    (figures,) = re.findall(words, line)
    for figure, bar in zip(figures, bars, strict=True):
        worst = max(float(value) for name, value, _ in rows if name.startswith(bar))
        # Two digits, or one that is the next above.
        assert worst <= 1.02 * float(figure) and float(figure) <= 1.1 * worst, (bar, worst, figure)
