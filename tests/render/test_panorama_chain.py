"""A panorama before a fisheye: directions land where the tracer says, as bright as they are."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.exr import write_exr
from gpusim.scene.make import make_scene
from gpusim.sensor.load import load_sensor

pytestmark = pytest.mark.slow  # half a minute of CPU each: a bank of the fisheye, a raster
ROWS = 240  # of the panorama: 0.75 degrees a sample
PITCH_UM = 140.0
EXPOSURE_S = 0.01
COARSE = Accuracy(tolerance=1e-2, probes=0)
GREY = 0.18
PATCH_RAD = np.radians(2.0)


@pytest.fixture(scope="module")
def camera():
    sensor = load_sensor("imx249-mono").model_copy(
        update={"rows": 101, "cols": 161, "pixel_pitch_um": PITCH_UM, "veiling_glare": 0.0}
    )
    return Camera(load_prescription("fisheye"), sensor, "fisheye, 140 um")


def rate(camera, scene):
    """Return electrons per second of every pixel."""
    renderer = Renderer(camera, scene, COARSE, noise=False)
    try:
        return renderer.capture(EXPOSURE_S, keep=("rate",)).rate
    finally:
        renderer.release()


def towards(longitude, latitude):
    """Return the unit vector (right, down, ahead) of a direction, rad."""
    cos = np.cos(latitude)
    return np.array([cos * np.sin(longitude), np.sin(latitude), cos * np.cos(longitude)])


def panorama(folder, light):
    """Return the scene of a panorama (rows, cols) of greys, white being 100 cd/m^2."""
    path = folder / "world.exr"
    write_exr(path, {"RGB": np.repeat(light[..., None], 3, axis=-1)})
    return make_scene(path, luminance_cd_m2=100.0, projection="equirectangular")


def test_an_even_world_is_an_even_chart(camera, tmp_path):
    world = rate(camera, panorama(tmp_path, np.full((ROWS, 2 * ROWS), GREY)))
    chart = rate(camera, make_scene("grey", luminance_cd_m2=100.0, projection="angular"))
    ratio = world / chart
    # D65 for D50 makes the photograph darker everywhere alike.
    off = ratio / np.median(ratio) - 1
    assert np.sqrt(np.mean(off**2)) < np.hypot(COARSE.tolerance, COARSE.tolerance)


@pytest.mark.parametrize(("longitude_deg", "latitude_deg"), [(-30.0, -30.0)])
def test_a_bright_patch_lands_where_the_tracer_says(camera, tmp_path, longitude_deg, latitude_deg):
    light = np.full((ROWS, 2 * ROWS), 0.05)
    direction = towards(np.radians(longitude_deg), np.radians(latitude_deg))
    rows, cols = np.mgrid[: light.shape[0], : light.shape[1]] + 0.5
    off = np.arccos(
        np.tensordot(
            direction, towards(*(np.pi * (cols / ROWS - 1), np.pi * (rows / ROWS - 0.5))), 1
        )
    )
    patch = light + 0.9 * np.exp(-(off**2) / 2 / PATCH_RAD**2)
    seen = rate(camera, panorama(tmp_path, patch)) - rate(camera, panorama(tmp_path, light))
    # Its centroid, against the chief ray of its direction.
    at = np.indices(seen.shape).reshape(2, -1) @ seen.ravel() / seen.sum()
    found_um = (at - (np.array(seen.shape) - 1) / 2) * PITCH_UM
    right, down, ahead = direction
    theta = np.arccos(ahead)
    system = build(camera.lens)
    ray = sample_rays(system, system.index(np.array([550.0])), theta, np.zeros(1), np.zeros(1))
    radius_um = 1e3 * np.hypot(ray.chief_x_mm[0], ray.chief_y_mm[0])
    truth_um = radius_um * np.array([down, right]) / np.hypot(down, right)
    # The patch is 2.25 degrees wide; over it the relative illumination falls and the map bends.
    np.testing.assert_allclose(found_um, truth_um, atol=0.5 * PITCH_UM)
