"""Defects that no mechanical mutator makes, planted by hand: each must turn its test red.

``tools/mutate.py --planted`` plants them one at a time in a copy of the project.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
COPIED = ("gpusim", "shaders", "tests", "tools", "pyproject.toml")
TIMEOUT_S = 600


@dataclass(frozen=True)
class Planted:
    """A defect: in a file a text becomes another, and a test (file, words of -k) should notice."""

    what: str
    file: str
    old: str
    new: str
    test: str
    words: str = ""


HAND = "tests/test_planted.py"
EXR = "tests/scene/test_exr.py"
LIST = (
    Planted(
        "a camera's filters replace its sensor's",
        "gpusim/camera.py",
        "[*sensor.filters, *load_filters(fields.filters, path)]",
        "load_filters(fields.filters, path) or sensor.filters",
        HAND,
        "filters",
    ),
    Planted(
        "hot pixels ignore temperature",
        "gpusim/sensor/defects.py",
        "scale = exposure_s * sensor.dark_current_factor(temperature_c)",
        "scale = exposure_s",
        HAND,
        "hot",
    ),
    Planted(
        "of a CCD, hot pixels are at the reference temperature",
        "gpusim/sensor/ccd.py",
        'warm = {"temperature_c": shot.temperature_c, "origin": frame.on_chip(rect)}',
        'warm = {"origin": frame.on_chip(rect)}',
        HAND,
        "hot",
    ),
    Planted(
        "of a CCD, hot pixels are the same in each frame",
        "gpusim/sensor/ccd.py",
        'frame=shot.frame,\n            origin=frame.on_chip(read),\n            label="charge",',
        'frame=0,\n            origin=frame.on_chip(read),\n            label="charge",',
        HAND,
        "hot",
    ),
    Planted(
        "of a CMOS sensor, hot pixels are the same in each frame",
        "gpusim/sensor/readout.py",
        '"frame": shot.frame, "runs": once',
        '"frame": 0, "runs": once',
        HAND,
        "hot",
    ),
    Planted(
        "the top border moves a defect's column",
        "gpusim/sensor/sensor.py",
        "origin[1] + col + self.first_col",
        "origin[1] + row + self.first_col",
        HAND,
        "border",
    ),
    Planted(
        "a region loses the phase of patterns longer than 2",
        "gpusim/sensor/sensor.py",
        "self.first_col + first_col // 2 // px * px",
        "self.first_col + first_col // 2 // 2 * 2",
        HAND,
        "phase",
    ),
    Planted(
        "a low-passed raster of odd size lies half a sample off",
        "gpusim/scene/raster.py",
        "            -width / 2,\n            -height / 2,",
        "            -width / 2 + (planes is not split.planes) * (cols % 2) * pitch / 2,\n"
        "            -height / 2,",
        HAND,
        "low_passed",
    ),
    Planted(
        "primaries near Rec. 709 are taken for it",
        "gpusim/scene/exr.py",
        "REC709_CHROMATICITIES).max() <= 1e-4",
        "REC709_CHROMATICITIES).max() <= 1e-2",
        EXR,
        "near_rec709",
    ),
    Planted(
        "a negative data window is taken as positive",
        "gpusim/scene/exr.py",
        'left, top = np.asarray(header["dataWindow"][0], int)',
        'left, top = np.abs(np.asarray(header["dataWindow"][0], int))',
        EXR,
        "window",
    ),
    Planted(
        "grey files have no luminance of white",
        "gpusim/scene/exr.py",
        '_number(header, "whiteLuminance", None)',
        '_number(header if "R" in channels else {}, "whiteLuminance", None)',
        EXR,
        "luminance_of_white",
    ),
    Planted(
        "of luminance and chroma, the two chromas are exchanged",
        "gpusim/scene/exr.py",
        'planes[name]) for name in ("RY", "BY"))',
        'planes[name]) for name in ("BY", "RY"))',
        EXR,
        "chroma",
    ),
    Planted(
        "the sRGB curve near black has another slope",
        "gpusim/scene/colorimetry.py",
        "12.92 * linear",
        "10.3 * linear",
        HAND,
        "srgb",
    ),
    Planted(
        "dark current stops falling 30 K below its reference",
        "gpusim/sensor/sensor.py",
        "return 2 ** (rise / self.doubling_temperature_c)",
        "return 2 ** (max(rise, -30.0) / self.doubling_temperature_c)",
        HAND,
        "dark_current",
    ),
    Planted(
        "read noise repeats after 256 frames",
        "gpusim/sensor/noise.py",
        '"frame": frame,',
        '"frame": frame % 256,',
        HAND,
        "read_noise",
    ),
    Planted(
        "PRNU repeats after 4096 columns",
        "shaders/sensor/exposure.wgsl",
        "of_pixels(quad, row, 0u, PURPOSE_PRNU, params.serial)",
        "of_pixels(quad % 1024u, row, 0u, PURPOSE_PRNU, params.serial)",
        HAND,
        "prnu",
    ),
    Planted(
        "a mask is known by its path",
        "gpusim/sensor/noise_model.py",
        "hashlib.sha256(repr(plane.shape).encode() + plane.tobytes()).hexdigest()",
        "str(plane.shape)",
        "tests/sensor/test_noise_model.py",
        "was_when",
    ),
    Planted(
        "the next run removes the folder of one that lives",
        "gpusim/cli/files.py",
        "    except BlockingIOError:\n        return False",
        "    except BlockingIOError:\n        return True",
        "tests/cli/test_stop.py",
        "killed",
    ),
    Planted(
        "a key that stands twice counts as the last",
        "gpusim/config/text.py",
        'if key in top[2] and key != "<<":',
        'if key in top[2] and key != "<<" and False:',
        "tests/config/test_text.py",
        "doubled",
    ),
    Planted(
        "negative rates are taken from the cache",
        "gpusim/plan/costs.py",
        "if not 0 <= rate < np.inf:",
        "if not abs(rate) < np.inf:",
        "tests/plan/test_calibrate.py",
        "rate_that_is_none",
    ),
    Planted(
        "a report's rates are not those of its plan",
        "gpusim/cli/render.py",
        "                costs=costs,\n",
        "",
        "tests/cli/test_render.py",
        "report_plans",
    ),
)


def survivors(wanted: str = "") -> list[Planted]:
    """Plant each defect whose description has the words; return those that their tests miss."""
    missed = []
    with tempfile.TemporaryDirectory(prefix="gpusim-planted-") as scratch:
        copy = Path(scratch)
        for name in COPIED:
            here = PROJECT / name
            (shutil.copytree if here.is_dir() else shutil.copy)(here, copy / name)
        for one in LIST:
            if wanted not in one.what:
                continue
            file = copy / one.file
            sound = file.read_text(encoding="utf-8")
            if sound.count(one.old) != 1:
                raise SystemExit(f"{one.file} has not once what is to be changed: {one.what}")
            file.write_text(sound.replace(one.old, one.new), encoding="utf-8")
            red = _is_red(copy, one)
            file.write_text(sound, encoding="utf-8")
            print(f"{'noticed' if red else 'MISSED'}: {one.what}", flush=True)
            missed += [] if red else [one]
    return missed


def _is_red(copy: Path, one: Planted) -> bool:
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", one.test]
    command += ["-k", one.words] if one.words else []
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S
    )
    if done.returncode not in (0, 1):  # 1: tests failed; else they did not run
        raise SystemExit(f"the tests did not run for: {one.what}\n{done.stdout}{done.stderr}")
    return done.returncode == 1
