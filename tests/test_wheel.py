"""The wheel alone gives a working gpusim: built, installed outside the checkout, and used there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rawpy

ROOT = Path(__file__).parent.parent
# A lens that nothing need be traced for: the package is new to the cache on disk.
CAMERA = """
title: a small camera
lens: {mtf: diffraction-limited}
sensor: {preset: imx477, rows: 32, cols: 48}
"""


def run(*command: str | Path, cwd: Path) -> str:
    """Return what a command prints, run where nothing of the checkout can be imported from."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "GPUSIM"))}
    done = subprocess.run(
        command, cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    # hatchling is one of the test packages: without isolation the build needs no network.
    build = (sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, ROOT)
    run(*build, cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a new environment that holds the wheel, and sees the packages that it needs."""
    folder = tmp_path_factory.mktemp("installed")
    run(sys.executable, "-m", "venv", "--without-pip", folder / "env", cwd=folder)
    python = folder / "env/bin/python"
    pip = (sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index")
    run(*pip, wheel, cwd=folder)
    # A .pth file adds the packages of this environment, 0.5 GB, behind those of the new one; the
    # .pth files among them, which could lead back to the checkout, are not read.
    purelib = "import sysconfig; print(sysconfig.get_path('purelib'))"
    target = Path(run(python, "-c", purelib, cwd=folder).strip())
    (target / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "env"


def tracked(folder: str, *suffixes: str) -> set[str]:
    files = (ROOT / folder).rglob("*")
    return {file.relative_to(ROOT).as_posix() for file in files if file.suffix in suffixes}


def test_every_shader_and_data_file_is_in_the_wheel(wheel: Path):
    names = set(zipfile.ZipFile(wheel).namelist())
    shaders = {f"gpusim/{name}" for name in tracked("shaders", ".wgsl")}
    data = tracked("gpusim", ".py", ".css", ".js", ".html", ".yaml", ".csv", ".zmx")
    assert shaders and data
    assert shaders | data <= names


def test_only_the_package_is_in_the_wheel(wheel: Path):
    tops = {name.split("/")[0] for name in zipfile.ZipFile(wheel).namelist()}
    assert {top.split("-")[0] for top in tops} == {"gpusim"}


def test_package_and_shaders_come_from_the_wheel(installed: Path, tmp_path: Path):
    where = (
        "import gpusim; from gpusim.gpu.wgsl import shaders_root as s; print(gpusim.__file__, s())"
    )
    for place in run(installed / "bin/python", "-c", where, cwd=tmp_path).split():
        assert Path(place).is_relative_to(installed)


def test_it_renders_outside_the_checkout(installed: Path, tmp_path: Path):
    (tmp_path / "camera.yaml").write_text(CAMERA)
    render = ("render", "camera.yaml", "demo", "--out", "out", "--certify", "0")
    shown = run(installed / "bin/gpusim", *render, cwd=tmp_path)
    assert "raw.dng" in shown
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert (report["capture"]["rows"], report["capture"]["cols"]) == (32, 48)
    with rawpy.imread(str(tmp_path / "out/raw.dng")) as raw:
        samples = raw.raw_image
        # The scene has a white of 300 cd/m^2: the picture is neither all black nor all white.
        assert raw.black_level_per_channel[0] + 10 < np.median(samples) < raw.white_level - 10


def test_the_licence_is_in_the_wheel(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_a_checkout_uses_the_shaders_beside_the_package():
    from gpusim.gpu.wgsl import shaders_root

    assert shaders_root() == ROOT / "shaders"
