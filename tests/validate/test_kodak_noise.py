"""Hue shift and parametric noise keep their closed forms; planted errors turn their bars red."""

import numpy as np
import pytest

from gpusim.camera import Camera, load_camera
from gpusim.library.expose import expose
from gpusim.scene import make_scene
from gpusim.validate import kodak_noise
from gpusim.validate.kodak_effects import plain_sensor

COLS = 64


@pytest.fixture(scope="module")
def light():
    camera = load_camera("mtf-only")
    seen = Camera(
        camera.lens, plain_sensor().model_copy(update={"rows": 128, "cols": COLS}), "small"
    )
    return expose(seen, make_scene("grey"), 1e-2, probes=0)


@pytest.fixture
def small(light, monkeypatch):
    """Let the sensor of the report be a small one."""
    monkeypatch.setattr(kodak_noise, "plain_sensor", lambda: light.sensor)
    return light


def test_grey_shifts_along_a_row_as_the_closed_form_has_it(small):
    found = kodak_noise.measure_hues(small)
    assert found.columns.size == COLS // 2
    assert all(bar.held for bar in found.bars()), found.bars()
    # More is left behind, and the shift grows: that bars of nothing at all would hold too.
    last = np.abs(found.ratios[:, :, -1] - 1)
    assert np.all(np.diff(last, axis=0) > 0) and last.min() > 1e-4
    assert np.all(np.diff(found.delta_e, axis=0) > 0)


def test_a_share_that_is_off_by_a_hundredth_is_seen(small, monkeypatch):
    law = kodak_noise.odd_share
    monkeypatch.setattr(kodak_noise, "odd_share", lambda column, share: law(column, 1.01 * share))
    assert not any(bar.held for bar in kodak_noise.measure_hues(small).bars())


def test_both_models_of_noise_have_one_variance_and_not_one_skewness(small, monkeypatch):
    monkeypatch.setattr(kodak_noise, "LEVELS_E", (0.0, 300.0, 20000.0))
    found = kodak_noise.measure_noises(small)
    assert all(bar.held for bar in found.bars()), found.bars()
    assert [level.expected_skewness > 0 for level in found.levels] == [True] * 3


def test_a_variance_that_is_off_by_a_twentieth_is_seen(small, monkeypatch):
    monkeypatch.setattr(kodak_noise, "LEVELS_E", (20000.0,))
    found = kodak_noise.measure_noises(small)
    assert all(bar.held for bar in found.bars())
    found.levels[0].variance["parametric"] *= 1.05
    assert not any(bar.held for bar in found.bars())


def test_noise_without_skewness_is_told_from_counting(small, monkeypatch):
    """At few electrons and without read-out noise counting is skewed by 1 / sqrt(n)."""
    quiet = small.sensor.model_copy(update={"temporal_dark_noise_e": 0.0})
    monkeypatch.setattr(kodak_noise, "load_sensor", lambda name: quiet)
    monkeypatch.setattr(kodak_noise, "LEVELS_E", (100.0,))
    found = kodak_noise.measure_noises(small)
    assert all(bar.held for bar in found.bars()), found.bars()
    level = found.levels[0]
    assert level.expected_skewness == pytest.approx(0.1)
    level.skewness["physical"] = level.skewness["parametric"]
    assert not any(bar.held for bar in found.bars())
