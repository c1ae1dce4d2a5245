"""What notebooks show: pictures of what is there, facts beside them, and nothing that runs."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
import pytest
from library.test_light import SENSORS, light_of
from PIL import Image

import gpusim as gs


def pictures(html: str) -> list[np.ndarray]:
    """Return the pictures within a page."""
    found = re.findall(r"data:image/png;base64,([^']+)", html)
    return [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(one))).convert("RGB")) for one in found
    ]


def test_a_sensor_shows_a_curve_for_each_channel_and_its_figures():
    sensor = gs.Sensor.load("imx477")
    shown = sensor._repr_html_()
    assert shown.count("<polyline") == len(sensor.channels) == 3
    assert "4056 x 3040" in shown and "8180 e-" in shown and "B G / G R" in shown
    # The highest curve ends two of the figure's 80 px below its top.
    tops = re.findall(r",([\d.]+)[ ']", shown)
    assert min(map(float, tops)) == pytest.approx(2, abs=0.05)


def test_a_camera_shows_its_lens_and_its_sensor():
    shown = gs.Camera.load("demo")._repr_html_()
    (section,) = pictures(shown)
    assert max(section.shape) == 480 and section.std() > 5 and "f-number 2.8" in shown
    assert shown.count("<polyline") == 3
    without = gs.Camera.load("mtf-only")._repr_html_()
    assert pictures(without) == [] and "<polyline" in without


def test_a_scene_shows_what_the_eye_sees():
    rgb = np.zeros((40, 60, 3))
    rgb[:20] = 1.0  # white above, red below
    rgb[20:, :, 0] = 1.0
    (seen,) = pictures(gs.Scene.from_rgb(rgb)._repr_html_())
    # White is sRGB's white within a code of rounding; the spectrum of red is red within 8 codes,
    # for the planes' spectra are defined on 5 nm.
    assert np.abs(seen[:20].astype(int) - 255).max() <= 1
    assert np.abs(seen[20:].astype(int) - [255, 0, 0]).max() <= 8
    (chart,) = pictures(gs.Scene.load("checkerboard")._repr_html_())
    assert chart.shape == (180, 240, 3) and chart.std() > 50


def test_a_burst_shows_the_first_frame_of_each_setting():
    light, renderer = light_of(SENSORS["Bayer"])
    renderer.release()
    burst = light.burst(6, [0.01, 0.02], iso=[100, 400], seed=1)
    shown = burst._repr_html_()
    assert len(pictures(shown)) == shown.count("<svg") == 4
    assert "frame 3" in shown and "frame 4" not in shown and "1/50 s" in shown
    many = light.burst(5, [0.01, 0.011, 0.012, 0.013, 0.014])._repr_html_()
    assert len(pictures(many)) == 4 and "4 of 5 settings" in many


def test_names_are_text_and_no_page():
    fields = gs.Sensor.load("imx477").model_dump() | {"name": "<script>"}
    scene = gs.Scene.from_rgb(np.ones((4, 4, 3)), name="<script>")
    for shown in (gs.Sensor(**fields)._repr_html_(), scene._repr_html_()):
        assert "<script>" not in shown and "&lt;script&gt;" in shown
