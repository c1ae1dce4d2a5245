"""An uneven light on a photograph: what the map says, at every sample and in the raw."""

from dataclasses import replace

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, RED, StubCamera, bank, sensor

from gpusim.errors import UserError
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene import make_scene
from gpusim.scene.exr import write_exr
from gpusim.scene.illumination import illuminated, read_illumination
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene


def photograph(rows: int = 30, cols: int = 40) -> Scene:
    planes = np.random.default_rng(2).uniform(0.1, 1, (2, rows, cols)).astype(np.float32)
    return Scene("photograph", np.stack([FLAT, RED]), Raster(planes), "D65", FLAT)


def by_hand(values: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Return a map at the samples of a picture, straight between its cells' middles, over 1."""
    down, across = ((np.arange(n) + 0.5) / n for n in values.shape)
    y, x = ((np.arange(n) + 0.5) / n for n in (rows, cols))
    lines = np.array([np.interp(x, across, row) for row in values])
    found = np.array([np.interp(y, down, column) for column in lines.T]).T
    middle = np.array([np.interp(0.5, across, row) for row in values])
    return found / np.interp(0.5, down, middle)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (31, 17), (60, 80), (2, 1)])
def test_radiance_is_multiplied_by_the_map_which_is_1_in_the_middle(shape):
    values = np.random.default_rng(1).uniform(0.2, 3, shape)
    before = photograph()
    after = illuminated(before, values, "lamp.exr")
    share = by_hand(values, 30, 40)
    # A product and its rounding to f32: 2 x 2^-24.
    assert_close(after.source.planes, before.source.planes * share, rtol=2.0**-23)
    assert after.white_luminance_cd_m2 == before.white_luminance_cd_m2
    assert "lamp.exr" in after.illumination and f"{share.max():.3g}" in after.illumination
    again = illuminated(before, 7 * values)  # relative
    assert_close(again.source.planes, after.source.planes, rtol=2.0**-22)


def test_a_function_of_place_lies_upright_in_half_heights():
    before = photograph(rows=300)  # of more rows than are multiplied at once
    after = illuminated(before, lambda x, y: 5 * np.exp(0.3 * x - 0.8 * y**2 + 0.1 * y))
    x = (np.arange(40) + 0.5 - 20) / 150
    y = (np.arange(300)[:, None] + 0.5 - 150) / 150
    share = np.exp(0.3 * x - 0.8 * y**2 + 0.1 * y)
    assert_close(after.source.planes, before.source.planes * share, rtol=2.0**-23)


def test_an_even_map_changes_no_bit():
    before = photograph()
    after = illuminated(before, np.full((4, 6), 0.37))
    assert np.array_equal(after.source.planes, before.source.planes)


def test_a_grey_exr_is_read_and_one_with_colours_refused(tmp_path):
    values = np.linspace(0.5, 2, 12, dtype=np.float32).reshape(3, 4)
    write_exr(tmp_path / "y.exr", {"Y": values})
    assert_close(read_illumination(tmp_path / "y.exr"), values.astype(float), rtol=1e-6)
    write_exr(tmp_path / "rgb.exr", {"R": values, "G": values, "B": 1.1 * values})
    with pytest.raises(UserError, match="has colours"):
        read_illumination(tmp_path / "rgb.exr")


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ([[1.0, 1.0, -0.1, 1.0]], "finite, 0 or more"),
        ([[1.0, np.nan, 1.0, 1.0]], "above 0|finite"),
        ([[1.0, 0.0, 0.0, 1.0]], "above 0"),
    ],
)
def test_a_map_that_no_light_has_is_refused(values, what):
    with pytest.raises(UserError, match=what):
        illuminated(photograph(), np.array(values))


def test_a_chart_is_refused():
    with pytest.raises(UserError, match="a chart is lit evenly"):
        illuminated(make_scene("grey"), np.ones((2, 2)))


def test_pixels_see_the_light_and_the_plan_says_so():
    camera = StubCamera(bank(size=48, falloff=0.0, distortion=0.0), sensor(32, 48))
    even = replace(photograph(), source=Raster(np.ones((2, 64, 96), np.float32)))
    lit = illuminated(even, lambda x, y: 1 + 0.4 * x + 0.2 * y, "a ramp")
    rates, stages = [], []
    for scene in (even, lit):
        one = Renderer(camera, scene, Accuracy(1e-3, 8), noise=False)
        try:
            made = one.capture(0.01, keep=("rate",))
        finally:
            one.release()
        rates.append(made.rate.astype(float))
        stages.append(next(s for s in made.plan.stages if s.name == "illumination"))
        assert made.certificate.engine_rms < 1e-3
    assert [stage.runs for stage in stages] == [False, True]
    assert stages[1].reason.startswith("a ramp")
    x = (np.arange(48) + 0.5 - 24) / 16
    y = (np.arange(32)[:, None] + 0.5 - 16) / 16
    inner = np.s_[4:-4, 4:-4]  # beyond the picture its border goes on: no ramp
    # A PSF moves its light by 0.2 um at most each way, of a half-height of 24.8 um; and each render
    # errs by the tolerance.
    ratio = rates[1] / rates[0]
    assert_close(ratio[inner], (1 + 0.4 * x + 0.2 * y)[inner], atol=0.6 * 0.2 / 24.8, rtol=2e-3)
    assert ratio[inner].max() > 1.4
