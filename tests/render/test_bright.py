"""Scenes of 1e9 : 1: the sun and other bright outliers in the frame, through the whole chain."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, RED, ULP, StubCamera, bank, monochrome, sensor

from gpusim.optics import highlight_tables as tables
from gpusim.plan import Accuracy
from gpusim.reference.exact_model import ExactCore
from gpusim.render import Capture, Renderer, renderer
from gpusim.scene import highlights
from gpusim.scene.exr import write_exr
from gpusim.scene.make import make_scene
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM

LENS = bank(size=96, coma_um=0.6, falloff=0.1, halo=0.01, distortion=-0.01)
SHOWN = LENS.levels[0]  # what the chain takes of it: all of its light, as an even scene shows it
CAMERA = StubCamera(LENS, sensor())
TOLERANCE = 1e-3
SPECTRA = np.stack([FLAT, RED])
SUN = (38, 50)  # row and column
# The halo has fallen to 1e-9 of the PSF 16 pixels from its middle. In the sun, beside it and in its
# glow; and in shadows that see nothing of it.
NEAR = np.array([[38, 50], [38, 55], [39, 60], [33, 53], [31, 57]])
FAR = np.array([[38, 74], [12, 46], [62, 50], [60, 70], [10, 100], [5, 10], [88, 120]])


def scenery(peak: float, radius: int = 5, shape=(96, 128)) -> np.ndarray:
    """Return dark ramps and the sun's disc; a radius of 0 makes it one texel."""
    y, x = np.mgrid[: shape[0], : shape[1]] / (np.array(shape) - 1)[:, None, None]
    planes = np.stack([0.05 + 0.95 * x, 0.3 + 0.6 * y]).astype(np.float32)
    row, col = np.indices(shape)
    planes[:, (row - SUN[0]) ** 2 + (col - SUN[1]) ** 2 <= radius**2] = peak
    return planes


def photograph(planes: np.ndarray) -> Scene:
    return Scene("photograph", SPECTRA[: len(planes)], Raster(planes), "D65", FLAT)


@contextmanager
def rendering(
    planes, camera=CAMERA, tolerance=TOLERANCE, probes=0, **how: str
) -> Iterator[Renderer]:
    one = Renderer(camera, photograph(planes), Accuracy(tolerance, probes), **how)
    try:
        yield one
    finally:
        one.release()


def shot(planes, camera=CAMERA, **settings) -> tuple[Capture, object]:
    with rendering(planes, camera, **settings) as one:
        return one.capture(0.01, keep=("rate",)), one.placed


def errors(capture: Capture, placed: object, pixels: np.ndarray) -> np.ndarray:
    """Return the relative errors of some pixels."""
    true = ExactCore(SHOWN, CAMERA.sensor, SPECTRA, WAVELENGTHS_NM).raster(placed, pixels)
    return capture.rate[pixels[:, 0], pixels[:, 1]].astype(float) / true - 1


@pytest.fixture(scope="module", params=[0, 5], ids=["texel", "disc"])
def sunny(request) -> tuple[Capture, object]:
    return shot(scenery(1e9, request.param))


def test_shadows_beside_the_sun_are_right(sunny):
    capture, placed = sunny
    assert capture.rate.min() > 0
    assert capture.rate.max() > 1e8 * capture.rate.min()
    far = errors(capture, placed, FAR)
    assert np.sqrt(np.mean(far**2)) < TOLERANCE
    assert np.abs(far).max() < 10 * TOLERANCE
    near = errors(capture, placed, NEAR)
    assert np.sqrt(np.mean(near**2)) < TOLERANCE


def test_without_point_sources_shadows_drown(monkeypatch):
    """The planted error: no sample is an outlier."""
    monkeypatch.setattr(highlights, "OUTLIER", np.inf)
    # By transforms: a direct sum's roundings are of what it sums.
    capture, placed = shot(scenery(1e9), method="fft")
    assert len(placed.highlights) == 0
    assert capture.rate.min() == 0  # cut off below
    far = errors(capture, placed, FAR)
    assert np.sqrt(np.mean(far**2)) > 100 * TOLERANCE


def test_the_plan_and_the_notes_say_how_many(sunny):
    capture, placed = sunny
    stage = next(stage for stage in capture.plan.stages if stage.name == "point sources")
    count = len(placed.highlights)
    assert count in (1, 81)
    assert stage.runs and stage.reason.startswith(f"{count} highlights")
    assert stage.predicted_cost_s > 0
    assert any(f"{count} samples brighter" in note for note in capture.notes)
    assert capture.prepare_s["point sources"] > 0


def test_a_scene_without_outliers_has_no_point_sources():
    planes = scenery(10.0)
    capture, placed = shot(planes, tolerance=1e-2)
    assert "point sources" not in capture.prepare_s
    stage = next(stage for stage in capture.plan.stages if stage.name == "point sources")
    assert not stage.runs and stage.predicted_cost_s is None
    assert len(placed.highlights) == 0 and placed.planes is planes


def test_the_point_sources_add_to_what_the_rest_of_the_scene_gives(monkeypatch):
    """With the highlights dimmed to nothing the frame is, bit for bit, that of the filled scene."""
    planes = scenery(1e9)
    filled = Raster(planes).split.planes
    plain, _ = shot(filled, tolerance=1e-2)
    none = np.zeros((3, 3, WAVELENGTHS_NM.size))
    monkeypatch.setattr(tables, "spectral_weights", lambda *some, **grid: none)
    dimmed, placed = shot(planes, tolerance=1e-2)
    assert len(placed.highlights) == 81
    assert_close(dimmed.rate, plain.rate, atol=0)


def test_the_sum_is_linear_in_the_highlights():
    planes = scenery(1e9)
    one, _ = shot(planes, tolerance=1e-2)
    filled = Raster(planes).split.planes
    plain, _ = shot(filled, tolerance=1e-2)
    planes[:, planes[0] > 1] *= 3
    three, _ = shot(planes, tolerance=1e-2)
    sun = one.rate.astype(float) - plain.rate
    # Fills are 1e-9 of the excess; f32 sums of 81 highlights. Where these have no light, transforms
    # of their kernels leave up to 2e-11 of the brightest (measured).
    noise = 1e-10 * three.rate.max()
    assert_close(three.rate.astype(float), plain.rate + 3 * sun, rtol=200 * ULP, atol=noise)


def test_the_suns_energy_is_conserved():
    """It is that of its area, times what a point there spreads for even scenes to look even."""
    lens = bank(coma_um=0.6, falloff=0.0, distortion=0.0, lateral=(0.0, 0.0, 0.0))
    camera = StubCamera(lens, monochrome())
    planes = scenery(1e9)
    with rendering(planes, camera, tolerance=1e-2) as one:
        found = one.capture(0.01, keep=("rate",)).rate.sum(dtype=float)
        even = tables.spectral_weights(lens, camera.sensor)[0].sum(axis=0) @ SPECTRA.sum(axis=0)
    centre = (
        np.array(SUN) + 0.5 - np.array([camera.sensor.rows, camera.sensor.cols]) / 2
    ) * camera.sensor.pixel_pitch_um
    core = lens.levels[0]
    spread = np.interp(
        np.hypot(*centre), core.real_height_um[:, 1], core.relative_illumination[:, 1]
    )
    assert found == pytest.approx(81 * 1e9 * even * spread, rel=1e-4)


def test_tiles_change_not_one_bit():
    with rendering(scenery(1e9), tolerance=1e-2) as one:
        whole = one.capture(0.01, keep=("rate",))
        tiled = one.capture(0.01, keep=("rate",), tile_px=52)
    assert_close(tiled.rate, whole.rate, atol=0)
    assert_close(tiled.raw, whole.raw, atol=0)


def test_a_further_frame_costs_the_sensor_alone():
    """The light is that of the first, bit for bit, until it is dropped or asked for elsewhere."""
    with rendering(scenery(1e9), tolerance=1e-2) as one:
        first, second = (one.capture(0.01, seed=3, keep=("rate",)) for _ in range(2))
        assert first.work["blocks"] > 0 and "warp" in first.times_s
        assert second.work["blocks"] == 0
        assert (
            second.times_s.keys() & {"warp", "fft rows", "fft columns", "inverse fft", "direct"}
            == set()
        )
        assert_close(second.raw, first.raw.copy(), atol=0)
        brighter = one.capture(0.02, keep=("rate",))
        assert brighter.work["blocks"] == 0
        assert_close(brighter.rate, first.rate, atol=0)
        part = one.capture(0.01, tile=(30, 20, 41, 33), keep=("rate",))
        assert part.work["blocks"] > 0
        assert_close(part.rate, first.rate[20:53, 30:71].copy(), atol=0)
        one.drop_light()
        again = one.capture(0.01, seed=3)
        assert again.work["blocks"] > 0
        assert_close(again.raw, first.raw.copy(), atol=0)


def test_light_is_kept_only_as_far_as_a_share_of_the_budget_goes(monkeypatch):
    monkeypatch.setattr(renderer, "KEPT_SHARE", 1 << 20)
    with rendering(scenery(1e9), tolerance=1e-2) as one:
        assert [one.capture(0.01).work["blocks"] > 0 for _ in range(2)] == [True, True]
        assert not one.kept


def test_the_certificate_holds_with_the_sun_in_the_frame():
    capture, _ = shot(scenery(1e9), tolerance=5e-3, probes=8)
    assert capture.certificate.met
    assert max(point.truth for point in capture.certificate.points) > 1e9


def test_the_sun_saturates_and_shadows_do_not(sunny):
    capture, _ = sunny
    top = 2**CAMERA.sensor.bit_depth - 1
    assert capture.raw[SUN] == top
    assert capture.raw[5, 10] < top


def dusk(rows: int, cols: int, sun: float) -> np.ndarray:
    """Return RGB (rows, cols, 3) of an evening: sun, sky, a street lamp, glints, shadows."""
    y, x = np.mgrid[:rows, :cols] / rows
    sky = (1.2 - 1.3 * y[..., None]) * [0.25, 0.35, 0.6]
    street = (0.3 + 0.5 * y[..., None]) * [0.06, 0.05, 0.04]
    stripes = 0.01 + 0.15 * (np.floor(16 * x) % 2)
    street[(y > 0.75) & (x < 0.5)] += stripes[(y > 0.75) & (x < 0.5), None]
    rgb = np.where(y[..., None] < 0.6, sky, street)
    rgb[np.hypot(y - 0.25, x - 0.9) < 0.03] = sun * np.array([1.0, 0.95, 0.85])
    rgb[int(0.8 * rows), int(0.6 * cols)] = [2e4, 1.2e4, 4e3]
    glints = np.random.default_rng(1)
    at = glints.integers([int(0.65 * rows), 0], [rows, cols], (6, 2))
    rgb[at[:, 0], at[:, 1]] = glints.uniform(300, 5000, (6, 1))
    return rgb


def test_an_exr_with_the_sun_goes_from_file_to_raw(tmp_path):
    write_exr(tmp_path / "dusk.exr", {"RGB": dusk(96, 128, 1e9)})
    scene = make_scene(tmp_path / "dusk.exr")
    assert 20 < len(scene.source.split.rows) < 50
    renderer = Renderer(CAMERA, scene, Accuracy(1e-2, 0))
    try:
        capture = renderer.capture(0.01, keep=("rate",))
    finally:
        renderer.release()
    assert capture.rate.min() > 0
    assert capture.raw.max() == 2**CAMERA.sensor.bit_depth - 1 and capture.raw.min() < 400
    assert any("held as squares" in note for note in capture.notes)


# Scenes of odd kinds


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (7, 3)])
def test_scenes_of_few_samples(shape):
    planes = np.full((2, *shape), 0.5, np.float32)
    planes[:, -1, -1] = 1e9
    capture, placed = shot(planes, StubCamera(LENS, sensor(32, 44)), tolerance=1e-2)
    assert len(placed.highlights) == (shape != (1, 1))
    assert np.isfinite(capture.rate).all() and capture.rate.min() > 0


@pytest.mark.parametrize("size", [(2, 2), (5, 9)])
def test_frames_smaller_than_the_psf(size):
    """Odd sizes too; a PSF of 96 samples spans 31 pixels."""
    camera = StubCamera(LENS, sensor(*size))
    planes = np.full((2, *size), 0.5, np.float32)
    planes[:, size[0] // 2, size[1] // 2] = 1e9
    capture, placed = shot(planes, camera, tolerance=1e-2)
    assert len(placed.highlights) == 1
    corners = np.array([[0, 0], [size[0] - 1, 0]])
    true = ExactCore(SHOWN, camera.sensor, SPECTRA, WAVELENGTHS_NM).raster(placed, corners)
    assert_close(capture.rate[corners[:, 0], corners[:, 1]].astype(float), true, rtol=1e-2)


def test_a_black_scene_is_black():
    capture, placed = shot(np.zeros((2, 9, 11), np.float32), tolerance=1e-2)
    assert_close(capture.rate, np.zeros((96, 128)), atol=0)
    assert len(placed.highlights) == 0


def test_one_star_in_the_dark():
    """A scene of one lit sample: no outlier, for there is nothing that it outshines."""
    planes = np.zeros((2, 96, 128), np.float32)
    planes[:, 40, 50] = 1e9
    capture, _ = shot(planes, tolerance=1e-2)
    assert capture.rate.min() == 0
    assert capture.rate.argmax() in (40 * 128 + 50, 40 * 128 + 51, 41 * 128 + 50, 39 * 128 + 50)
