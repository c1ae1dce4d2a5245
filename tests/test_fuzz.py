"""Every reader, given damaged files: it reads them, or says one clear thing, soon and in bounds.

Text files lose lines and gain words; structured ones gain values of other kinds; of binary files
bytes change, vanish and double. The readers of lens designs have their own in
``tests/formats/test_imports.py``.
"""

from __future__ import annotations

import copy
import json
import logging
import os
import sys
import time
import warnings
import zlib
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
import yaml
from formats import isetcam_files, speos_files
from formats.exports import write_isetcam, write_zemax
from formats.test_ready import arrays
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from optics.made import bank as made_bank
from PIL import Image
from scene import picture_files

from gpusim.batch.sweep import Sweep
from gpusim.camera import Camera, load_camera
from gpusim.errors import UserError
from gpusim.formats.isetcam_sensor import read_isetcam
from gpusim.formats.label_map import read_labels
from gpusim.formats.ready import load_ready
from gpusim.formats.speos import read_speos
from gpusim.heap import trim_heap
from gpusim.isp.develop import _read as read_development
from gpusim.isp.dng import write_dng
from gpusim.isp.files import write_picture
from gpusim.isp.lens_tags import Optics
from gpusim.isp.settings import read_settings
from gpusim.library.again import read_recipe
from gpusim.library.expose import expose
from gpusim.library.irradiance import Irradiance
from gpusim.library.light import Light
from gpusim.library.recipe import recipe_of_frame
from gpusim.metrics.frames import find_frames, measure
from gpusim.metrics.picture import read_picture
from gpusim.preview.script import read_script
from gpusim.scene import make_scene
from gpusim.scene.exr import write_exr
from gpusim.scene.illumination import read_illumination
from gpusim.scene.patterns import Frame
from gpusim.sensor.eqe_model import read_eqe
from gpusim.sensor.load import PRESETS, load_sensor
from gpusim.tolerance.budget import Budget

DATA = Path(__file__).resolve().parents[1] / "gpusim" / "data"
SECONDS = 2.0  # of processor time for one file; whole ones take 0.05
MEBIBYTES = 200  # that the process may grow by at its highest, over all files of a reader
EXAMPLES = int(os.environ.get("GPUSIM_FUZZ", "25"))  # more of them by hand


def sensor_files(at: Path) -> list[Path]:
    """Write a sensor file with what may stand beside it."""
    data = yaml.safe_load((PRESETS / "imx477.yaml").read_text())
    data |= {"rows": 24, "cols": 36, "masks": {"gain": "gain.npy", "offset_e": "offset.tif"}}
    data |= {"defects": {"hot_fraction": 1e-3, "hot_e_per_s": 9.0, "pixels": []}}
    data["defects"]["pixels"] = [{"row": 3, "col": 4, "kind": "stuck", "value": 5.0}]
    data["sources"] = {key: data.get("sources", {}).get(key, "made up") for key in ("masks",)}
    filters = [f"{nm},{0.9}" for nm in range(400, 701, 50)]
    (at / "cut.csv").write_text("# nm, transmission\n" + "\n".join(filters))
    data["filters"] = [{"name": "cut", "file": "cut.csv"}]
    np.save(at / "gain.npy", np.ones((24, 36), np.float32))
    tifffile.imwrite(at / "offset.tif", np.ones((24, 36), np.float32), compression="zlib")
    (at / "sensor.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    return [at / name for name in ("sensor.yaml", "cut.csv", "gain.npy", "offset.tif")]


def eqe_file(at: Path) -> list[Path]:
    """Write a small quantum efficiency by angle."""
    cube = np.full((2, 3, 2), 0.4).tolist()
    data = {
        "wavelengths_nm": [400, 700],
        "theta_deg": [0, 20, 40],
        "phi_deg": [0, 180],
        "channels": {"G": {"eqe": cube}},
    }
    (at / "eqe.json").write_text(json.dumps(data, indent=1))
    return [at / "eqe.json"]


def camera_file(at: Path) -> list[Path]:
    """Write a camera file of a few pixels."""
    (at / "camera.yaml").write_text(
        "title: a camera\n"
        "lens: {prescription: double-gauss, f_number: 4, max_field_deg: 3, focus_shift_um: 1.0}\n"
        "sensor: {preset: imx477, rows: 96, cols: 128}\n"
        "filters: [{name: cut, wavelengths_nm: [400, 700], transmission: [0.5, 0.9]}]\n"
    )
    return [at / "camera.yaml"]


def npz_file(at: Path) -> list[Path]:
    """Write a bank as arrays, and a text beside it."""
    found = arrays(made_bank(size=16))
    title = {name: found.pop(name) for name in ("title", "source")}
    np.savez_compressed(at / "lens.npz", **found)
    (at / "lens.yaml").write_text(yaml.safe_dump(title | {"exit_pupil_mm": 20.0}))
    return [at / "lens.npz", at / "lens.yaml"]


def saved_bank(at: Path) -> list[Path]:
    """Write a bank as NetCDF."""
    made_bank(size=16).save(at / "lens.nc")
    return [at / "lens.nc"]


def mtf_file(at: Path) -> list[Path]:
    """Write a table of the MTF."""
    data = yaml.safe_load((DATA / "mtf" / "diffraction-limited.yaml").read_text())
    (at / "lens.yaml").write_text(yaml.safe_dump(data))
    return [at / "lens.yaml"]


def exr_files(at: Path) -> list[Path]:
    """Write a photograph."""
    rgb = np.random.default_rng(1).uniform(0, 2, (24, 20, 3)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    more = {"chromaticities": (0.7, 0.29, 0.2, 0.8, 0.13, 0.05, 0.3127, 0.329)}
    OpenEXR.File(header | more | {"whiteLuminance": 80.0}, {"RGB": rgb}).write(str(at / "a.exr"))
    return [at / "a.exr"]


def chart_files(at: Path) -> list[Path]:
    """Write a chart of shapes, with a spectrum beside it."""
    (at / "leaf.csv").write_text("nm,reflectance\n400,0.1\n500,0.3\n700,0.4\n")
    (at / "chart.yaml").write_text(
        "title: a chart\nunit: mm\nheight: 100\nfills: {leaf: {spectrum: leaf.csv}, dark: 0.05}\n"
        "background: 0.5\nshapes:\n"
        "- {shape: polygon, at: [0, 30], corners: [[0, 0], [9, 9], [0, 5], [-9, 9]], fill: red}\n"
        "- {shape: edge, at: [30, 0], size: [20, 20], angle_deg: 5, fills: [leaf, dark]}\n"
        "- {shape: star, at: [-40, 0], sectors: 9, diameter: 20, inner_diameter: 2, fill: dark}\n"
        "- {shape: patches, at: [0, -30], pitch: 9, patch: 8, carrier: dark, rows: [[0.3, cyan]]}\n"
        "- shape: grid\n  pitch: [9, 9]\n  count: [5, 3]\n  clear: 1\n"
        "  of: {shape: disc, diameter: 4, fill: {density: 1.2}}\n"
    )
    return [at / "chart.yaml", at / "leaf.csv"]


def pattern_file(at: Path) -> list[Path]:
    """Write a chart that is drawn on samples."""
    (at / "chart.yaml").write_text(
        "title: a pattern\nbackground: 0.5\n"
        "pattern: {pattern: dead-leaves, radii: [0.05, 0.5], seed: 3, samples: 64, fills: [0, 1]}\n"
    )
    return [at / "chart.yaml"]


def scene_of(name: str, **given: object) -> Callable[[Path], object]:
    """Return a function that reads the scene of that name in a folder."""
    return lambda at: make_scene(at / name, **given)


def raw_file(at: Path) -> list[Path]:
    """Write a small raw of ours."""
    sensor = load_sensor("imx477").model_copy(update={"rows": 32, "cols": 48})
    raw = np.random.default_rng(1).integers(260, 900, (32, 48)).astype(np.uint16)
    white = dict.fromkeys(sensor.channels, 1000.0)
    write_dng(at / "raw.dng", raw, sensor, exposure_s=0.01, white_e=white)
    return [at / "raw.dng"]


def envi_files(at: Path) -> list[Path]:
    """Write a cube."""
    header = picture_files.write_envi(at / "a", picture_files.cube(), "bil")
    return [header, header.with_suffix(".img")]


def picture(name: str, values: np.ndarray, how: str = "") -> Callable[[Path], list[Path]]:
    """Return a function that writes a picture into a folder."""
    write = getattr(picture_files, f"write_{how}")
    return lambda at: [write(at / name, values)]


def lamp_files(at: Path) -> list[Path]:
    """Write a light in three formats."""
    nm = range(380, 781, 40)
    (at / "a.csv").write_text("nm,power\n" + "".join(f"{one},{one / 500}\n" for one in nm))
    (at / "a.json").write_text(json.dumps({str(one): one / 500 for one in nm}, indent=1))
    rows = "".join(f'<SpectralData wavelength="{one}">1.5</SpectralData>\n' for one in nm)
    (at / "a.spdx").write_text(f"<IESTM2714>\n{rows}</IESTM2714>\n")
    return [at / "a.csv", at / "a.json", at / "a.spdx"]


def all_lamps(at: Path) -> None:
    """Read them."""
    for end in ("csv", "json", "spdx"):
        make_scene("grey", illuminant=str(at / f"a.{end}"))


def zemax_files(at: Path) -> list[Path]:
    """Write Zemax's exports."""
    write_zemax(at)
    return [at / "lens.yaml", *sorted(at.glob("*.txt"))[:2]]


def isetcam_folder(at: Path) -> list[Path]:
    """Write the folder of ISETCam's macro."""
    write_isetcam(at)
    return sorted(at.glob("ISETPARMS.*")) + sorted(at.glob("*.dat"))[:3]


def speos_folder(at: Path) -> list[Path]:
    """Write a sensor of Speos and its spectrum."""
    file = speos_files.written(at)
    speos_files.spectrum(at / "qe.spectrum", {380: 40.0, 550: 60.0, 720: 30.0})
    return [file, at / "qe.spectrum"]


def frames_folder(at: Path) -> list[Path]:
    """Write frames and their list."""
    rng = np.random.default_rng(1)
    frames = rng.integers(90, 110, (4, 16, 16)).astype(np.uint16)
    names = ["0.npy", "1.npy", "2.tif", "3.tif"]
    for name, frame in zip(names, frames, strict=True):
        (np.save if name.endswith("npy") else tifffile.imwrite)(at / name, frame)
    rows = [f"{name},0.01,{200 * (n > 1)},{550 if n > 1 else ''}" for n, name in enumerate(names)]
    (at / "frames.csv").write_text(
        "\n".join(["file,exposure_s,photons,wavelength_nm", *rows]) + "\n"
    )
    (at / "camera.json").write_text('{"name": "cam", "pattern": [["G"]], "pixel_pitch_um": 2.0}')
    return [at / name for name in ("frames.csv", "camera.json", *names[::3])]


def irradiance_file(name: str) -> Callable[[Path], list[Path]]:
    """Return a function that writes an irradiance of three bands into a folder."""
    seen = Irradiance(np.full((6, 8, 3), 2e-3, np.float32), np.array([450.0, 550.0, 650.0]))

    def write(at: Path) -> list[Path]:
        seen.save(at / name)
        return [at / name]

    return write


def labels_npy(at: Path) -> list[Path]:
    """Write a map of labels."""
    np.save(at / "a.npy", np.arange(60, dtype=np.int32).reshape(6, 10))
    return [at / "a.npy"]


def wide_png(at: Path) -> list[Path]:
    """Write a PNG of 16 bits a colour."""
    picture = np.random.default_rng(1).integers(0, 1 << 16, (9, 12, 3)).astype(np.uint16)
    write_picture(at / "a.png", picture)
    return [at / "a.png"]


def light_map(at: Path) -> list[Path]:
    """Write a map of uneven light."""
    write_exr(at / "map.exr", {"Y": np.full((6, 8), 0.8, np.float32)})
    return [at / "map.exr"]


def light_file(at: Path) -> list[Path]:
    """Write a light of a few pixels."""
    sensor = load_sensor("imx477").model_copy(update={"rows": 6, "cols": 8})
    whole, lens = (0, 0, 6, 8), Optics("a lens", 8.0, 2.8, *np.zeros((3, 0)))
    rates, white = np.ones((4, 3, 4), np.float32), dict.fromkeys(sensor.channels, 1000.0)
    glare, transmission = np.zeros(4, np.float32), np.ones(61)
    Light(
        *("a camera", "a scene", sensor, whole, whole, rates, glare, white, transmission, lens),
        tolerance="1e-3",
        recipe={"format": 1},
    ).save(at / "light.npz")
    return [at / "light.npz"]


def cube_files(at: Path) -> list[Path]:
    """Write a picture, and the table of the medium that it was on."""
    rows = "\n".join(f"{r} {g} {b}" for b in (0, 1) for g in (0, 1) for r in (0, 1))
    (at / "film.cube").write_text(f"TITLE film\nLUT_3D_SIZE 2\n{rows}\n")
    return [
        picture_files.write_png(at / "a.png", np.full((9, 12, 3), 77, np.uint8)),
        at / "film.cube",
    ]


def script_file(at: Path) -> list[Path]:
    """Write a script of the preview."""
    steps = [{"zoom": [2, 3, 4]}, {"turn": {"ev": 1.5}}, {"wait": "picture"}]
    (at / "steps.json").write_text(json.dumps(steps))
    return [at / "steps.json"]


def settings_file(at: Path) -> list[Path]:
    """Write settings of a development."""
    (at / "look.yaml").write_text(
        "demosaic: malvar\nwhite_balance: patch:1,2,3,4\nspace: p3\nev: 1.5\nroll_off: 0.2\n"
        "curve: [[0, 0], [0.5, 0.6], [1, 1]]\ndefects: true\n"
    )
    return [at / "look.yaml"]


def sweep_file(at: Path) -> list[Path]:
    """Write a sweep of a batch."""
    (at / "sweep.yaml").write_text(
        "camera: mtf-only\nscenes: [colorchecker, grey]\nsamples: 4\ncombine: sample\n"
        "axes: {seed: {range: [0, 40]}, exposure_s: {log_uniform: [0.001, 0.1]}}\n"
        "outputs: [raw, npz]\n"
    )
    return [at / "sweep.yaml"]


def budget_file(at: Path) -> list[Path]:
    """Write a budget of tolerances."""
    (at / "budget.yaml").write_text(
        "samples: 20\ntolerances:\n  all.radius: {normal: [0, 0.1]}\n"
        "  element.1-2.tilt_x_deg: {uniform: [-0.05, 0.05]}\n"
    )
    return [at / "budget.yaml"]


def measured_files(at: Path) -> list[Path]:
    """Write a picture in the formats in which sharpness is measured."""
    values = np.arange(12 * 9, dtype=np.uint8).reshape(12, 9)
    for end in ("png", "jpg"):
        Image.fromarray(values).save(at / f"a.{end}")
    tifffile.imwrite(at / "a.tif", values)
    np.save(at / "a.npy", values)
    return [at / f"a.{end}" for end in ("png", "jpg", "tif", "npy")]


def all_pictures(at: Path) -> None:
    """Read them."""
    for end in ("png", "jpg", "tif", "npy"):
        read_picture(at / f"a.{end}")


def recipe_files(at: Path) -> list[Path]:
    """Write the recipe of a raw, and beside it that of its light."""
    made = load_camera("mtf-only")
    made = Camera(made.lens, made.sensor.roi(24, 32), "small")
    light = expose(made, make_scene("grey"), 1e-1, probes=0)
    frame, raw = light.capture(0.01), at / "raw.dng"
    frame.save(raw)
    (at / "light.json").write_text(json.dumps(light.recipe))
    said = {"recipe": recipe_of_frame(frame, raw, datetime.now(UTC), light="light.json")}
    (at / "raw.json").write_text(json.dumps(said))
    return [at / "raw.json", at / "light.json"]


READERS: dict[str, tuple[Callable[[Path], list[Path]], Callable[[Path], object]]] = {
    "sensor": (sensor_files, lambda at: load_sensor(at / "sensor.yaml")),
    "quantum efficiency": (eqe_file, lambda at: read_eqe(at / "eqe.json")),
    "camera": (camera_file, lambda at: load_camera(at / "camera.yaml")),
    "npz": (npz_file, lambda at: load_ready(at / "lens.npz").bank()),
    "bank": (saved_bank, lambda at: load_ready(at / "lens.nc").bank()),
    "mtf": (mtf_file, lambda at: load_ready(at / "lens.yaml").bank()),
    "zemax": (zemax_files, lambda at: load_ready(at / "lens.yaml").bank()),
    "isetcam lens": (isetcam_folder, lambda at: load_ready(at).bank()),
    "photograph": (exr_files, lambda at: make_scene(at / "a.exr")),
    "chart": (chart_files, lambda at: make_scene(at / "chart.yaml")),
    "pattern": (pattern_file, lambda at: make_scene(at / "chart.yaml", frame=Frame(48, 1.5))),
    "envi": (envi_files, scene_of("a.hdr")),
    "spectral exr": (picture("a.exr", picture_files.cube(), "spectral_exr"), scene_of("a.exr")),
    "radiance": (picture("a.hdr", np.ones((9, 40, 3)), "hdr"), scene_of("a.hdr")),
    "isetcam scene": (picture("a.mat", picture_files.cube(), "isetcam"), scene_of("a.mat")),
    "isetcam scene 7.3": (
        lambda at: [picture_files.write_isetcam(at / "a.mat", picture_files.cube(), "7.3")],
        scene_of("a.mat"),
    ),
    "tiff": (
        picture("a.tif", np.full((9, 12, 3), 77, np.uint16), "tiff"),
        scene_of("a.tif", transfer="srgb"),
    ),
    "png": (
        picture("a.png", np.full((9, 12, 3), 77, np.uint8), "png"),
        scene_of("a.png", transfer="srgb"),
    ),
    "jpeg": (
        picture("a.jpg", np.full((9, 12, 3), 77, np.uint8), "jpeg"),
        scene_of("a.jpg", transfer="srgb"),
    ),
    "png of 16 bits": (wide_png, scene_of("a.png", transfer="srgb")),
    "table": (cube_files, lambda at: make_scene(at / "a.png", transfer=str(at / "film.cube"))),
    "spectrum": (lamp_files, all_lamps),
    "raw": (raw_file, scene_of("raw.dng")),
    "speos": (speos_folder, lambda at: read_speos(at / "camera.yaml").sensor({})),
    "isetcam": (
        lambda at: [isetcam_files.written(at)],
        lambda at: read_isetcam(at / "sensor.json").sensor({}),
    ),
    "isetcam mat": (
        lambda at: [isetcam_files.written(at, kind=".mat")],
        lambda at: read_isetcam(at / "sensor.mat").sensor({}),
    ),
    "development": (raw_file, lambda at: read_development(at / "raw.dng", binned=False)),
    "settings": (settings_file, lambda at: read_settings(at / "look.yaml")),
    "irradiance": (irradiance_file("e.npz"), lambda at: Irradiance.load(at / "e.npz")),
    "irradiance exr": (irradiance_file("e.exr"), lambda at: Irradiance.load(at / "e.exr")),
    "labels npy": (labels_npy, lambda at: read_labels(at / "a.npy")),
    "labels png": (
        picture("a.png", np.full((9, 12), 3, np.uint8), "png"),
        lambda at: read_labels(at / "a.png"),
    ),
    "illumination": (light_map, lambda at: read_illumination(at / "map.exr")),
    "light": (light_file, lambda at: Light.load(at / "light.npz")),
    "script": (script_file, lambda at: read_script(at / "steps.json")),
    "sweep": (sweep_file, lambda at: Sweep.load(at / "sweep.yaml")),
    "measured picture": (measured_files, all_pictures),
    "recipe": (recipe_files, lambda at: read_recipe(at / "raw.json")),
    "budget": (budget_file, lambda at: Budget.load(at / "budget.yaml")),
    "frames": (frames_folder, lambda at: list(measure(find_frames(at)))),
}

ODD = st.sampled_from(
    [
        *(None, True, False, 0, 1, -1, 2, 4096, 1e308, -1e-308, 1e38, 10**18, "", "nan", ".inf"),
        *("a", "\x1b[2J", "../..", "/dev/zero", "x" * 300, [], [[]], {}, {"a": 1}, [1, [2]], [0]),
        *([1e300] * 3, ["a", None], {"file": "/dev/zero"}, "1e-3", [float("nan")]),
    ]
)
WHERE = st.floats(0, 1, exclude_max=True)


def places(data: object) -> list[tuple]:
    """List where the values of a structure stand."""
    found = []
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in items:
        found.append((data, key))
        if isinstance(value, dict | list):
            found += places(value)
    return found


def with_other_values(text: str, edits: list, load: Callable, dump: Callable) -> str:
    """Return a structured text after edits: a value becomes another, or is gone, or doubles."""
    data = load(text)
    for where, what, value in edits:
        found = places(data)
        if not found:
            break
        inside, key = found[int(where * len(found))]
        if what == "drop":
            del inside[key]
        elif what == "rename" and isinstance(inside, dict):
            inside[f"{key}s"] = inside.pop(key)
        else:
            inside[key] = copy.deepcopy(value)  # hypothesis hands out the same list again
    return dump(data)


def with_other_bytes(content: bytes, edits: list) -> bytes:
    """Return a file after edits of its bytes."""
    content = bytearray(content)
    for where, what, value in edits:
        at = int(where * len(content))
        if what == "drop":
            del content[at : at + 7]
        elif what == "cut":
            del content[at:]
        elif what == "double":
            content[at:at] = content[at : at + 40]
        else:
            content[at : at + 4] = zlib.crc32(repr(value).encode()).to_bytes(4, "little")
    return bytes(content)


EDITS = st.lists(
    st.tuples(WHERE, st.sampled_from(["drop", "rename", "cut", "double", *5 * ["value"]]), ODD),
    min_size=1,
    max_size=4,
)
DUMPS = {".yaml": (yaml.safe_load, yaml.safe_dump), ".json": (json.loads, json.dumps)}


class Highest:
    """The memory that the process takes at its highest from here on, whatever it took before.

    The kernel's own mark (VmHWM, the same as ``ru_maxrss``) is that of the whole life of a process:
    after a larger test nothing would raise it. It is set back to what is taken now (proc(5),
    clear_refs, 5), once what the heap still holds is given back.
    """

    def __init__(self) -> None:
        trim_heap()
        Path("/proc/self/clear_refs").write_text("5")
        self.start = self._mark()

    def grown(self) -> float:
        """Return how much more than at the start, MiB."""
        return self._mark() - self.start

    def _mark(self) -> float:
        lines = Path("/proc/self/status").read_text().splitlines()
        return int(next(line for line in lines if line.startswith("VmHWM")).split()[1]) / 1024


@pytest.mark.skipif(sys.platform != "linux", reason="the mark is the Linux kernel's")
def test_the_bar_of_memory_sees_what_a_reader_takes_for_a_moment():
    """After a test that took more."""
    np.ones(96 << 20, np.uint8)  # freed at once
    highest = Highest()
    assert highest.grown() < 8  # what else the process does meanwhile
    np.ones(64 << 20, np.uint8)
    assert highest.grown() > 64 - 8


@pytest.mark.skipif(sys.platform != "linux", reason="the mark is the Linux kernel's")
@pytest.mark.parametrize("reader", READERS)
def test_a_damaged_file_is_read_or_is_one_clear_error(
    tmp_path: Path, reader: str, capfd: pytest.CaptureFixture, caplog: pytest.LogCaptureFixture
):
    make, read = READERS[reader]
    whole = {file: file.read_bytes() for file in make(tmp_path)}
    read(tmp_path)  # as it is, it is read
    highest = Highest()
    capfd.readouterr()
    caplog.clear()
    outcomes = {"read": 0, "refused": 0}

    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        derandomize=EXAMPLES == 25,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(which=WHERE, structured=st.booleans(), edits=EDITS)
    def damage(which: float, structured: bool, edits: list) -> None:
        for file, content in whole.items():
            file.write_bytes(content)
        file = list(whole)[int(which * len(whole))]
        if structured and file.suffix in DUMPS:
            file.write_text(with_other_values(whole[file].decode(), edits, *DUMPS[file.suffix]))
        else:
            file.write_bytes(with_other_bytes(whole[file], edits))
        started = time.process_time()
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read(tmp_path)
            outcomes["read"] += 1
        except UserError as error:
            screen = error.screen()
            assert len(screen.splitlines()) <= 8 and len(screen) < 10_000
            assert all(sign.isprintable() or sign == "\n" for sign in screen)
            outcomes["refused"] += 1
        assert time.process_time() - started < SECONDS

    damage()
    assert outcomes["refused"] > 0
    assert highest.grown() < MEBIBYTES
    # The error is all that a user sees: no library prints, or logs what Python prints by itself.
    assert tuple(capfd.readouterr()) == ("", "")
    assert not [one.getMessage() for one in caplog.records if one.levelno >= logging.WARNING]
