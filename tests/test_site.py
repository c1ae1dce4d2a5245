"""The pages and the notebook for users: they build without a broken link, and run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.mark.slow
def test_the_pages_build_without_a_broken_link_or_reference(tmp_path: Path):
    pytest.importorskip("mkdocstrings", reason="extra `docs`")
    command = ["-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, *command], cwd=PROJECT, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "api" / "index.html").read_text(encoding="utf-8")
    for name in ("expose", "Light.capture", "Frame", "Lens.load", "Scene.from_rgb", "Sensor.load"):
        assert f".{name}" in page


@pytest.mark.slow
def test_the_notebook_runs():
    nbclient = pytest.importorskip("nbclient", reason="extra `docs`")
    nbformat = pytest.importorskip("nbformat", reason="extra `docs`")
    notebook = nbformat.read(PROJECT / "examples" / "notebook.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "stored without outputs"
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=PROJECT)
    shown = [
        set().union(*(one.get("data", {}) for one in cell.outputs))
        for cell in notebook.cells
        if cell.cell_type == "code"
    ]
    assert sum("image/png" in kinds or "text/html" in kinds for kinds in shown) >= 5
