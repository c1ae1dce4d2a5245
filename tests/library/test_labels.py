"""Labels of a scene on the pixels that see them: where the light goes, and unmixed."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_refused, gpusim
from optics.made import bank, monochrome
from PIL import Image

import gpusim as gs
from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.formats.label_map import read_labels
from gpusim.library.labels import labels_on_sensor

SENSOR = monochrome(96, 128)
BEND = -0.12


@dataclass(frozen=True)
class Bent:
    """A lens that distorts much."""

    title: str = "bent"

    def bank(self, progress: object = None, **sampling: object):
        """Return its Gaussians."""
        return bank(coma_um=0.0, distortion=BEND, lateral=(0.0, 0.0, 0.0), falloff=0.0, fields=9)


@dataclass(frozen=True)
class Straight:
    """A lens that does not distort."""

    title: str = "straight"

    def bank(self, progress: object = None, **sampling: object):
        """Return its Gaussians."""
        return bank(coma_um=0.0, distortion=0.0, lateral=(0.0, 0.0, 0.0), falloff=0.0, fields=9)


CAMERA = Camera(Bent(), SENSOR, "a camera")


def test_a_label_is_that_of_the_point_the_chief_ray_comes_from():
    """Planted: the map of the distortion the other way round, which is 4 pixels off at the rim."""
    side = 960, 1280  # ten samples a pixel
    row, col = np.mgrid[: side[0], : side[1]]
    found = labels_on_sensor(CAMERA, np.stack([row, col], axis=-1), -1).astype(float)
    pitch = SENSOR.pixel_pitch_um
    y, x = np.mgrid[:96, :128]
    y, x = (y + 0.5 - 48) * pitch, (x + 0.5 - 64) * pitch
    ideal = np.linspace(0, 165, 20001)
    away = np.interp(np.hypot(x, y), ideal * (1 + BEND * (ideal / 165) ** 2), ideal)
    scale = away / np.hypot(x, y)
    expected = np.stack([y * scale, x * scale], axis=-1) / (pitch / 10) + (480, 640) - 0.5
    inside = (found[..., 0] >= 0) & (found[..., 1] >= 0)
    assert 0.5 < inside.mean() < 1  # barrel: the corners see beyond the map
    # To the middle of a sample, and what a lens of nine fields has between these.
    assert np.abs(found - expected)[inside].max() < 0.5 + 0.5


def test_labels_lie_where_the_light_does():
    step = np.zeros((96, 128), np.uint8)
    step[:, 40:] = 1
    step[70:] = 0
    scene = gs.Scene.from_rgb(np.repeat(step[..., None].astype(float), 3, axis=2))
    light = gs.expose(CAMERA, scene, 1e-2, probes=0).rates[0]
    lit = light > light.max() / 2
    seen = labels_on_sensor(CAMERA, step, 2)
    apart = (lit != (seen == 1)) & (seen < 2)  # beyond the map the light is that of its rim
    # A pixel on an edge may be either.
    assert apart.mean() < 0.01
    assert not apart[:, 60:70][20:50].any()
    assert set(np.unique(seen)) == {0, 1, 2}


@pytest.mark.parametrize("projection", ["angular", "equirectangular"])
def test_labels_of_scenes_by_angle_lie_where_their_directions_are_seen(projection: str):
    """A lens that does not distort: x = f tan(theta) along each axis of the sensor."""
    camera = Camera(Straight(), SENSOR, "a camera")
    f_um = 1e3 * camera.bank().principal_distance_mm
    high, wide = (480, 960) if projection == "equirectangular" else (960, 1280)
    row, col = np.mgrid[:high, :wide]
    found = labels_on_sensor(camera, np.stack([row, col], -1), -1, projection).astype(float)
    y, x = (
        (np.arange(count) + 0.5 - count / 2) * SENSOR.pixel_pitch_um for count in found.shape[:2]
    )
    x, y = np.meshgrid(x, y)
    if projection == "equirectangular":
        longitude, latitude = np.arctan(x / f_um), np.arctan(y / np.hypot(x, f_um))
        expected = (latitude / np.pi + 0.5) * high, (longitude / (2 * np.pi) + 0.5) * wide
    else:
        # As a photograph: the larger of the two pitches covers the sensor, here both alike.
        pitch_um, height = SENSOR.rows * SENSOR.pixel_pitch_um / high, np.hypot(x, y)
        share = f_um * np.arctan(height / f_um) / height / pitch_um
        expected = y * share + high / 2, x * share + wide / 2
    # A sample is half of one off its middle at most; the spline of the map, 1e-4 um (FIT_ERROR_UM).
    for number, place in enumerate(expected):
        assert np.abs(found[..., number] + 0.5 - place).max() <= 0.5 + 1e-3
    assert found.min() >= 0


def test_labels_of_a_panorama_are_one(tmp_path: Path):
    with pytest.raises(UserError, match="no panorama"):
        labels_on_sensor(CAMERA, np.ones((4, 4)), 0, "equirectangular")
    with pytest.raises(UserError, match="no such projection"):
        labels_on_sensor(CAMERA, np.ones((4, 4)), 0, "round")


@pytest.mark.parametrize("kind", [np.uint8, np.int32, np.float64, bool])
def test_labels_keep_their_type(kind: type):
    found = labels_on_sensor(CAMERA, np.ones((12, 16), kind), 0)
    assert found.dtype == kind
    assert set(np.unique(found)) <= {0, 1}


def test_what_is_no_map_of_labels_is_refused():
    for labels in (np.zeros(3), np.zeros((0, 4)), np.array([["a"]])):
        with pytest.raises(UserError, match="no map of labels"):
            labels_on_sensor(CAMERA, labels)
    with pytest.raises(UserError, match="no label of this type"):
        labels_on_sensor(CAMERA, np.zeros((4, 4), np.uint8), -1)
    assert np.isnan(labels_on_sensor(CAMERA, np.ones((4, 4)), np.nan)).any()


def png(values: np.ndarray) -> bytes:
    """Return a PNG's bytes."""
    file = BytesIO()
    Image.fromarray(values).save(file, "PNG")
    return file.getvalue()


def npy(values: np.ndarray) -> bytes:
    """Return a .npy file's bytes."""
    file = BytesIO()
    np.save(file, values)
    return file.getvalue()


NOISE = png(np.random.default_rng(1).integers(0, 9, (64, 64)).astype(np.uint8))
DATA = NOISE.index(b"IDAT")
DAMAGED = {
    # What a library raises of each, which is none of OSError and ValueError.
    "DecompressionBombError.png": NOISE[:16] + (10**5).to_bytes(4, "big") * 2 + NOISE[24:],
    "SyntaxError.png": NOISE[: DATA - 4] + (50).to_bytes(4, "big") + NOISE[DATA:],
    "TokenError.npy": npy(np.zeros((3, 4))).replace(b"}", b" "),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_map_of_labels_is_one_clear_error(tmp_path: Path, name: str):
    (tmp_path / name).write_bytes(DAMAGED[name])
    with pytest.raises(UserError, match=r"no map of labels: \S") as caught:
        read_labels(tmp_path / name)
    assert caught.value.file == tmp_path / name


@pytest.mark.parametrize(
    "values",
    [
        np.arange(12, dtype=np.uint8).reshape(3, 4),
        1000 * np.arange(12, dtype=np.uint16).reshape(3, 4),
        np.eye(4) > 0,
        np.arange(36, dtype=np.uint8).reshape(3, 4, 3),
    ],
)
def test_pictures_of_labels_keep_their_numbers(tmp_path: Path, values: np.ndarray):
    (tmp_path / "a.png").write_bytes(png(values))
    found = read_labels(tmp_path / "a.png")
    assert found.dtype == values.dtype
    np.testing.assert_array_equal(found, values)


def test_labels_of_a_palette_are_its_indices(tmp_path: Path):
    classes = np.arange(12, dtype=np.uint8).reshape(3, 4)
    picture = Image.fromarray(classes, "L").convert("P")
    picture.putpalette([255 - n // 3 for n in range(3 * 12)])
    picture.save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_labels(tmp_path / "a.png"), classes)


def test_the_command_takes_arrays_and_pictures(tmp_path: Path):
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "title: a camera\nlens: {mtf: diffraction-limited}\n"
        "sensor: {preset: imx477, rows: 18, cols: 24}\n"
    )
    classes = np.repeat(np.arange(4, dtype=np.uint8), 6)[None].repeat(18, axis=0)
    np.save(tmp_path / "a.npy", classes)
    Image.fromarray(classes).save(tmp_path / "a.png")
    for given, out in (("a.npy", "b.npy"), ("a.png", "b.png")):
        ran = gpusim("labels", camera, tmp_path / given, "--out", tmp_path / out)
        assert ran.code == 0, ran.err
    found = np.load(tmp_path / "b.npy")
    np.testing.assert_array_equal(found, classes)  # this lens does not distort
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "b.png")), found)
    assert_refused(gpusim("labels", camera, "none.npy", "--out", tmp_path / "c.npy"), "none.npy")
    assert_refused(gpusim("labels", camera, tmp_path / "a.npy", "--out", "c.txt"), ".npy")


def test_a_render_has_the_labels_of_its_scene_beside_its_raw(tmp_path: Path):
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        "title: a camera\nlens: {mtf: diffraction-limited}\n"
        "sensor: {preset: imx477, rows: 30, cols: 44}\n"
    )
    depth = np.random.default_rng(5).uniform(0.5, 9, (60, 88))
    kinds = np.random.default_rng(6).integers(1, 9, (60, 88)).astype(np.uint8)
    np.save(tmp_path / "depth.npy", depth)
    (tmp_path / "kinds.png").write_bytes(png(kinds))
    maps = "--labels", tmp_path / "depth.npy", "--labels", tmp_path / "kinds.png"
    plain = "render", camera, "grey", "--tolerance", "1e-2", "--certify", 0, "-q"
    ran = gpusim(*plain, "--out", tmp_path / "a", *maps)
    assert ran.code == 0, ran.err
    loaded = gs.Camera.load(camera)
    whole = np.load(tmp_path / "a" / "labels-depth.npy")
    np.testing.assert_array_equal(whole, labels_on_sensor(loaded, depth))
    seen = np.asarray(Image.open(tmp_path / "a" / "labels-kinds.png"))
    np.testing.assert_array_equal(seen, labels_on_sensor(loaded, kinds))
    # A rectangle has its own part.
    ran = gpusim(*plain, "--out", tmp_path / "b", *maps, "--tile", "8,6,20,10")
    assert ran.code == 0, ran.err
    np.testing.assert_array_equal(np.load(tmp_path / "b" / "labels-depth.npy"), whole[6:16, 8:28])
    assert_refused(gpusim(*plain, "--out", tmp_path / "c", *maps[:2] * 2), "--labels", "depth.npy")
    np.save(tmp_path / "line.npy", np.zeros(3))
    assert_refused(
        gpusim(*plain, "--out", tmp_path / "c", "--labels", tmp_path / "line.npy"), "line"
    )
