"""The ColorChecker as dcraw, RawTherapee and darktable develop it, beside LibRaw and ourselves.

Each as it is without a look of its own: as-shot white balance, no tone curve, no automatic
brightness.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from isp.test_libraw import true_rgb

from gpusim.isp.develop import develop
from gpusim.isp.dng import write_dng
from gpusim.isp.settings import Settings
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, rgb_to_xyz
from gpusim.sensor.cfa import PATTERNS

pytestmark = pytest.mark.slow
PATCH = 132  # pixels: LibRaw develops X-Trans from 512 rows on
WHITE = 0.6  # of saturation
METHOD = "CIE 2000"
SRGB = (2.4, 12.92)  # power and slope at black
DARKTABLE = (
    "plugins/darkroom/workflow=none",
    "plugins/darkroom/chromatic-adaptation=legacy",
    "plugins/imageio/format/tiff/bpp=16",
    "write_sidecar_files=never",
)


def dcraw(path: Path, out: Path) -> None:
    curve = [str(number) for number in SRGB]
    subprocess.run(["dcraw", "-w", "-W", "-6", "-T", "-g", *curve, path], check=True)
    path.with_suffix(".tiff").replace(out)


def rawtherapee(path: Path, out: Path) -> None:
    run("rawtherapee-cli", "-o", out, "-tz", "-b16", "-Y", "-c", path, home=out.parent)


def darktable(path: Path, out: Path) -> None:
    settings = [word for one in DARKTABLE for word in ("--conf", one)]
    own = ["--configdir", out.parent / "darktable", "--library", ":memory:"]
    command = ["darktable-cli", path, out, "--icc-type", "SRGB", "--core", *own, *settings]
    run(*command, home=out.parent)


def run(*command: object, home: Path) -> None:
    place = {"HOME": str(home), "XDG_RUNTIME_DIR": str(home)}
    words = [str(word) for word in command]
    # RawTherapee's exit code says nothing; a picture that is missing does.
    subprocess.run(words, check=False, capture_output=True, env=os.environ | place, timeout=200)


PROGRAMS = {"dcraw": dcraw, "rawtherapee-cli": rawtherapee, "darktable-cli": darktable}


def light_of(picture: np.ndarray) -> np.ndarray:
    """Return the patches' linear sRGB (24, 3) in a picture of 16 bits."""
    shown = patches_of(picture.astype(np.float64))
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def lab_of(light: np.ndarray) -> np.ndarray:
    colour = pytest.importorskip("colour", reason="for dE2000")
    xyz = np.clip(light, 0, 1) @ rgb_to_xyz(REC709_CHROMATICITIES).T
    return colour.XYZ_to_Lab(xyz, np.array(REC709_CHROMATICITIES[6:]))


def patches_of(picture: np.ndarray) -> np.ndarray:
    """Return the mean of the inner part of each patch, of a picture that may lack its rim."""
    if picture.ndim == 2:
        picture = np.repeat(picture[:, :, None], 3, axis=2)
    rim = (4 * PATCH - picture.shape[0]) // 2, (6 * PATCH - picture.shape[1]) // 2
    found = []
    for number in range(24):
        row, col = (PATCH * at + 40 - off for at, off in zip(divmod(number, 6), rim, strict=True))
        found.append(picture[row : row + 52, col : col + 52, :3].mean(axis=(0, 1)))
    return np.array(found) / 65535


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("pattern", ["BGGR", "X-Trans"])
def test_other_programs_agree_on_the_colorchecker(tmp_path, shoot, program, pattern):
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    colour = pytest.importorskip("colour", reason="for dE2000")
    shot = shoot("D65", [list(row) for row in PATTERNS[pattern]], patch_px=PATCH)
    path, out = tmp_path / "a.dng", tmp_path / "out.tif"
    write_dng(path, shot.raw, shot.sensor, white_e=shot.white_e, exposure_s=0.01)
    with rawpy.imread(str(path)) as raw:
        ours = raw.postprocess(
            use_camera_wb=True,
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            gamma=SRGB,
            output_bps=16,
        )
    PROGRAMS[program](path, out)
    ours, theirs = (lab_of(light_of(one)) for one in (ours, tifffile.imread(out)))
    error = colour.delta_E(ours, theirs, method=METHOD)
    print(f"{program}, {pattern}: dE2000 mean {error.mean():.3f}, max {error.max():.3f}")
    assert error.max() < 0.1


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("illuminant", ["D50", "D65", "A"])
def test_our_colours_are_as_true_as_theirs(tmp_path, shoot, program, illuminant):
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    colour = pytest.importorskip("colour", reason="for dE2000")
    shot = shoot(illuminant, patch_px=PATCH, white_share=WHITE)
    path, out = tmp_path / "a.dng", tmp_path / "out.tif"
    write_dng(path, shot.raw, shot.sensor, white_e=shot.white_e, exposure_s=0.01)
    PROGRAMS[program](path, out)
    ours = develop(path, Settings(space="srgb"), bits=16).picture
    true = lab_of(true_rgb(illuminant))
    mean, largest = np.transpose(
        [
            (error.mean(), error.max())
            for picture in (ours, tifffile.imread(out))
            for error in [colour.delta_E(true, lab_of(light_of(picture) / WHITE), method=METHOD)]
        ]
    )
    print(
        f"{illuminant}: dE2000 mean {mean[0]:.2f}, max {largest[0]:.2f}; "
        f"{program} {mean[1]:.2f}, {largest[1]:.2f}"
    )
    assert mean[0] <= 1.5 and largest[0] <= 5
    # What LibRaw's conversions agree to with one another above.
    assert mean[0] <= mean[1] + 0.1
