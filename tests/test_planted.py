"""Defects that no mechanical mutator makes, each of which once passed the suite: a test for each.

Every docstring names the defect. `tools/mutate.py --planted` plants those of `tools/planted.toml`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from colour.models import cctf_encoding
from harness import assert_close
from scipy.ndimage import center_of_mass

from gpusim.camera import load_camera
from gpusim.gpu import Device, Recording
from gpusim.isp.develop import develop
from gpusim.isp.dng import write_dng
from gpusim.isp.rawfile import read_raw
from gpusim.isp.source import Source
from gpusim.scene.raster import Raster
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.ccd import record_columns
from gpusim.sensor.cfa import PATTERNS, ColourFilterArray
from gpusim.sensor.defects import record_stuck
from gpusim.sensor.exposure import record_exposure
from gpusim.sensor.filters_model import passed
from gpusim.sensor.frame import Border
from gpusim.sensor.load import PRESETS, load_sensor
from gpusim.sensor.noise import record_noise
from gpusim.sensor.noise_model import Defects
from gpusim.sensor.planes import planes_of
from gpusim.sensor.readout import Shot, SiteLight, record_readout
from gpusim.sensor.sensor import Sensor

F32 = np.float32


def quiet(rows: int, cols: int, name: str = "imx477", **fields: object) -> Sensor:
    """Return a preset of a few pixels, with some fields changed."""
    changes = {"rows": rows, "cols": cols, "prnu_percent": 0.0, "dsnu_e": 0.0, **fields}
    return load_sensor(name).unchecked(**changes)


def test_filters_of_a_camera_are_with_those_of_its_sensor(tmp_path: Path):
    """Planted: the camera's filters replace the sensor's."""
    data = yaml.safe_load((PRESETS / "imx477.yaml").read_text())
    half, most = (
        {"name": name, "wavelengths_nm": [400, 700], "transmission": [share, share]}
        for name, share in (("half", 0.5), ("most", 0.8))
    )
    (tmp_path / "sensor.yaml").write_text(yaml.safe_dump(data | {"filters": [half]}))
    camera = {"title": "a", "lens": "double-gauss", "sensor": "sensor.yaml", "filters": [most]}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    found = passed(load_camera(tmp_path / "camera.yaml").sensor.filters)
    assert_close(found, np.full(WAVELENGTHS_NM.size, 0.4), rtol=1e-12)


HOT = {"pixels": [{"row": 3, "col": 5, "kind": "hot", "value": 200.0}]}


@pytest.mark.parametrize("kind", ["cmos", "ccd"])
def test_hot_pixels_follow_temperature_and_vary_between_frames(device: Device, kind: str):
    """Planted: hot pixels that ignore temperature or frame, of CMOS and of CCD."""
    sensor = quiet(
        16, 16, "imx477" if kind == "cmos" else "kodak-vga",
        defects=Defects(**HOT), first_row=0, first_col=0, dark_current_e_per_s=0.0,
    )  # fmt: skip

    def taken(warmer_c: float, frame: int, stages: tuple[str, ...]) -> float:
        rec = Recording(device)
        shot = Shot(0.5, 1, frame, sensor.reference_temperature_c + warmer_c)
        rect = (0, 0, 16, 16)
        runs = stages.__contains__
        if kind == "ccd":
            rate = rec.buffer("rate", (16, 16), F32)
            rec.clear(rate)
            charge = record_columns(rec, rate, sensor, rect, shot=shot, runs=runs)
        else:
            made = planes_of(sensor)
            sites = rec.buffer("sites", (len(made.channels), *[16 // made.period] * 2), F32)
            glare = rec.buffer("glare", (len(sensor.site_channels()),), F32)
            rec.clear(sites)
            rec.clear(glare)
            light = SiteLight(sites, glare, rect)
            charge = record_readout(rec, light, sensor, rect, shot=shot, runs=runs)["electrons"]
        label = rec.download(charge)
        return float(rec.run()[label][3, 5])

    doubling, mean = sensor.doubling_temperature_c, ("exposure", "defects")
    assert taken(0, 0, mean) == pytest.approx(100)
    assert taken(2 * doubling, 0, mean) == pytest.approx(400)
    assert taken(-doubling, 0, mean) == pytest.approx(50)
    assert len({taken(0, frame, (*mean, "noise")) for frame in range(4)}) > 1


def test_a_defect_lies_where_its_file_says_whatever_the_border(device: Device):
    """Planted: the top border moves a defect's column."""
    pixels = [{"row": 2, "col": 7, "kind": "stuck", "value": 50.0}]
    black = Border(top=3, left=1, right=2)
    first = {"first_row": 0, "first_col": 0}
    sensor = quiet(8, 12, defects=Defects(pixels=pixels), optical_black=black, **first)
    _, _, rows, cols = sensor.frame.read
    rec = Recording(device)
    plane = rec.buffer("plane", (rows, cols), F32)
    rec.clear(plane)
    record_stuck(rec, plane, sensor, origin=(0, 0))
    label = rec.download(plane)
    assert np.argwhere(rec.run()[label]).tolist() == [[2 + 3, 7 + 1]]


@pytest.mark.parametrize("name", ["quad Bayer", "X-Trans", "RGGB"])
@pytest.mark.parametrize("smaller", range(1, 9))
def test_a_region_keeps_the_phase_of_its_pattern(name: str, smaller: int):
    """Planted: the phase is lost where a region's size differs by 2 modulo 4."""
    pattern = [list(row) for row in PATTERNS[name]]
    whole = load_sensor("imx477").model_copy(
        update={"cfa": ColourFilterArray(pattern=pattern), "first_row": 0, "first_col": 0}
    )
    region = whole.roi(whole.rows - smaller, whole.cols - 3 * smaller)
    assert region.first_row % len(pattern) == region.first_col % len(pattern[0]) == 0
    middle = (region.first_row + region.rows / 2, region.first_col + region.cols / 2)
    assert abs(middle[0] - whole.rows / 2) < len(pattern)
    assert abs(middle[1] - whole.cols / 2) < len(pattern[0])


@pytest.mark.parametrize("name", ["RGGB", "quad Bayer", "X-Trans"])
@pytest.mark.parametrize("place", [(0, 1), (1, 0), (3, 2), (5, 10)])
def test_a_part_begins_with_the_filters_of_its_first_pixel(name: str, place: tuple[int, int]):
    """Planted: a part's columns have the phase of its row."""
    pattern = np.array([list(row) for row in PATTERNS[name]])
    cfa = ColourFilterArray(pattern=pattern.tolist())
    part = load_sensor("imx477").unchecked(cfa=cfa).cut(*place)
    assert [list(row) for row in part.cfa.pattern] == np.roll(
        pattern, [-one for one in place], (0, 1)
    ).tolist()


@pytest.mark.parametrize("name", ["RGGB", "quad Bayer", "X-Trans"])
@pytest.mark.parametrize("rect", [(0, 0, 12, 12), (5, 2, 13, 9), (1, 7, 6, 11)])
def test_the_light_of_a_patch_is_that_of_its_own_sites(name: str, rect: tuple[int, ...]):
    """Planted: the patch of a white begins with the wrong site; in a pattern of two, all do."""
    shape, (row, col, rows, cols) = (24, 24), rect
    codes = np.arange(shape[0] * shape[1], dtype=np.uint16).reshape(shape)
    sites = np.tile([list(line) for line in PATTERNS[name]], (12, 12))[: shape[0], : shape[1]]
    source = Source(codes, None, np.zeros((1, 1)), 1.0, tuple(PATTERNS[name]), None, {})
    part = np.s_[row : row + rows, col : col + cols]
    for colour in "RGB":
        found = np.sort(source.light_of(colour, rect))
        assert found.tolist() == codes[part][sites[part] == colour].tolist()


@pytest.mark.parametrize(("rows", "cols"), [(97, 131), (96, 131), (97, 130), (96, 130)])
@pytest.mark.parametrize("coarser", [1.7, 2.0, 3.3])
def test_a_low_passed_raster_stays_where_it_is(rows: int, cols: int, coarser: float):
    """Planted: a raster of odd size that is low-passed lies half a sample off."""
    at_y, at_x = np.indices((rows, cols)) + 0.5
    y, x = 0.45 * rows, 0.6 * cols
    spot = 0.5 + np.exp(-((at_y - y) ** 2 + (at_x - x) ** 2) / (2 * 6.0**2))
    raster = Raster(spot[None].astype(F32))
    placed = raster.placed(cols / 2, rows / 2, coarser)  # pitch 1: positions in samples
    _, new_rows, new_cols = placed.planes.shape
    assert placed.integrals and (new_rows, new_cols) != (rows, cols)
    found = (np.array(center_of_mass(placed.planes[0] - 0.5)) + 0.5) * placed.pitch_um
    found += placed.y0_um, placed.x0_um
    # A centre of mass is kept by any low-pass that is symmetric. What is left is the rounding of
    # 0.5 to float32 over the spot's sum: 1e4 samples of 3e-8, 65 from the middle, over 226.
    assert_close(found, np.array([y - rows / 2, x - cols / 2]), atol=2e-2)


def test_a_grey_picture_follows_the_srgb_curve_near_black(tmp_path):
    """Planted: the straight part of the curve, below 0.0031308, has another slope."""
    sensor = load_sensor("imx249-mono")
    black = sensor.site_black_dn[0]
    raw = np.linspace(black, sensor.max_dn, 2000).round().astype(np.uint16)[None]
    raw[0, :60] = black + np.arange(60)
    path = tmp_path / "ramp.dng"
    write_dng(path, raw, sensor, white_e={"W": 1e4}, exposure_s=0.01)
    light = np.clip((raw - black) / read_raw(path).span_dn, 0, 1)
    shown = develop(path).picture[..., 0]
    assert (light < 0.0031308).sum() > 10
    # Rounded to 8 bits, from light of 16 bits: half of 255 * 12.92 / 65535 at most.
    assert_close(shown.astype(float), 255 * cctf_encoding(light, "sRGB"), atol=0.5 + 0.026)


@pytest.mark.parametrize("colder", [0.0, 7.5, 30.0, 31.0, 60.0, 90.0])
def test_dark_current_falls_however_cold(colder: float):
    """Planted: it stops falling 30 K below its reference."""
    sensor = load_sensor("imx477")
    found = sensor.dark_current_at(sensor.reference_temperature_c - colder)
    expected = sensor.dark_current_e_per_s / 2 ** (colder / sensor.doubling_temperature_c)
    assert found == pytest.approx(expected, rel=1e-12) and found > 0


def frames_of(device: Device, numbers: list[int], shape: tuple[int, int], **fields) -> list:
    """Return dark frames of read noise alone."""
    found = []
    for number in numbers:
        rec = Recording(device)
        mean = rec.buffer("mean", shape, F32)
        rec.clear(mean)
        sensor = quiet(*shape, **fields)
        label = rec.download(record_noise(rec, mean, sensor, seed=5, frame=number))
        found.append(rec.run()[label])
    return found


def test_read_noise_never_repeats(device: Device):
    """Planted: it repeats after 256 frames; so might it after any power of two."""
    numbers = [0, *(2**k for k in range(4, 32, 4)), 2**32 - 1]
    frames = np.stack(frames_of(device, numbers, (32, 32))).reshape(len(numbers), -1)
    related = np.corrcoef(frames) - np.eye(len(numbers))
    assert np.abs(related).max() < 6 / 32  # six sigmas of 1024 independent pairs


@pytest.mark.parametrize("axis", [0, 1])
def test_prnu_never_repeats(device: Device, axis: int):
    """Planted: it repeats after 4096 columns; so might it after any power of two, and down."""
    shape = (8, 2**14)[:: 1 if axis else -1]
    sensor = load_sensor("imx477").model_copy(
        update={"rows": shape[0], "cols": shape[1], "prnu_percent": 2.0, "first_col": 0}
    )
    rec = Recording(device)
    rate = rec.buffer("rate", shape, F32)
    rec.upload(rate, np.full(shape, 1e3, F32))
    label = rec.download(record_exposure(rec, rate, sensor, 0.1))
    plane = np.moveaxis(rec.run()[label].astype(float), axis, 1)
    plane -= plane.mean()
    assert plane.std() > 1
    for step in (2**k for k in range(4, 14)):
        one, other = plane[:, :-step].ravel(), plane[:, step:].ravel()
        assert abs(np.corrcoef(one, other)[0, 1]) < 6 / np.sqrt(one.size)
