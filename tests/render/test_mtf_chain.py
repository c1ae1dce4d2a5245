"""A capture through an MTF-only lens: its edge has the table's contrast, and all of its light."""

from pathlib import Path

import numpy as np
import pytest
from optics.made import FLAT, monochrome, scene, sensor, shapes
from scipy.interpolate import CubicSpline

from gpusim.camera import Camera
from gpusim.formats.mtf import Curve
from gpusim.formats.ready import load_ready
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.chart import Rect

PITCH_UM = 1.55
FREQUENCIES = [0, 40, 80, 120, 160, 200, 240, 280, 320, 400, 480]
VALUES = [1, 0.95, 0.87, 0.77, 0.66, 0.55, 0.44, 0.34, 0.25, 0.1, 0]
BLURRED = [1, 0.9, 0.76, 0.62, 0.5, 0.39, 0.29, 0.2, 0.13, 0.04, 0]
HEAD = f"""
title: a table
source: made up
efl_mm: 8.0
f_number: 4.0
working_f_number: 4.0
transmission: 0.9
mtf:
  frequencies_cy_mm: {FREQUENCIES}
  fields:
"""


def lens(folder: Path, wavelengths: str, fields: list[str]):
    file = folder / "lens.yaml"
    lines = "".join(f"    - {{{field}}}\n" for field in fields)
    file.write_text(f"{HEAD}{lines}wavelengths_nm: {wavelengths}\n")
    return load_ready(file)


def shot(camera: Camera, subject, accuracy: Accuracy):
    renderer = Renderer(camera, subject, accuracy)
    try:
        return renderer.capture(0.01, keep=("rate",))
    finally:
        renderer.release()


@pytest.fixture(scope="module")
def alike(tmp_path_factory):
    """Give a lens that is the same at all fields and colours."""
    fields = [f"height_mm: {h}, relative_illumination: 1, values: [{VALUES}]" for h in (0, 0.17)]
    return lens(tmp_path_factory.mktemp("alike"), "[[400, 700]]", fields)


@pytest.fixture(scope="module")
def varied(tmp_path_factory):
    """Give a lens that blurs, darkens and bends towards the rim, and blurs red more.

    A quarter of its field is used: a PSF that changes within its own width makes the light of an
    even field uneven, which is another matter.
    """
    fields = [
        f"height_mm: 0, relative_illumination: 1, values: [{VALUES}, {BLURRED}]",
        f"height_mm: 0.25, relative_illumination: 0.97, values: [{VALUES}, {BLURRED}], "
        "distortion_percent: -0.3",
        f"height_mm: 0.5, relative_illumination: [0.88, 0.86], values: [{BLURRED}], "
        "distortion_percent: -1.2",
    ]
    return lens(tmp_path_factory.mktemp("varied"), "[[400, 500], 650]", fields)


def test_an_edge_has_the_contrast_of_the_table(alike):
    camera = Camera(alike, monochrome(), "a camera")
    accuracy = Accuracy(tolerance=2e-3, probes=4)
    half_um = 96 * PITCH_UM / 2
    # The left side of the bar goes through the centre, at 6 degrees to the columns.
    angle = np.radians(6.0)
    bar = scene((Rect(1.0, 0.0, 1.0, 2.5, angle, 1),), np.stack([FLAT, 0.2 * FLAT]))
    found = shot(camera, bar, accuracy)
    assert found.certificate.met and found.certificate.rms_relative < accuracy.tolerance

    cos, sin = np.cos(angle), np.sin(angle)
    rows, cols = found.rate.shape
    y, x = (np.indices(found.rate.shape) + 0.5 - np.array([[[rows / 2]], [[cols / 2]]])) * PITCH_UM
    distance = (x - half_um) * cos + y * sin + half_um
    used = np.abs(distance) < 60
    order = np.argsort(distance[used])
    d = distance[used][order]
    white = (spectral_weights(alike.bank(), camera.sensor).sum(axis=1) @ FLAT)[0]
    edge = (1 - found.rate.astype(float)[used][order] / white) / 0.8
    # The transform of the derivative of the edge, by parts: 1 for an ideal step, which is taken off
    # and its jump kept on the step, plus 2 pi i f times that of what is left.
    middle = np.interp(0.0, d, edge)
    d = np.concatenate([d[d <= 0], [0.0, 0.0], d[d > 0]])
    left = np.concatenate([edge[: np.sum(d < 0) + 0], [middle, middle - 1]])
    rest = np.concatenate([left, edge[np.sum(d < 0) :] - 1])
    f = 1e-3 * np.array([20, 40, 80, 120, 160, 200, 240, 280, 320])
    waves = np.exp(-2j * np.pi * f[:, None] * d)
    measured = 1 + 2j * np.pi * f * np.trapezoid(rest * waves, d, axis=1)
    side_um = PITCH_UM * np.sqrt(camera.sensor.fill_factor)
    aperture = np.sinc(f * side_um * cos) * np.sinc(f * side_um * sin)
    table = Curve(1e-3 * np.array(FREQUENCIES, float), np.array(VALUES, float))(f)

    # The window misses a share o of the light: the bank's MTF is (MTF - tail) / (1 - o), the tail's
    # below o. The render errs by at most the plan's tolerance.
    missed = alike.bank().outside_energy.max()
    tolerance = missed * (1 + table) / (1 - missed) + accuracy.tolerance
    assert missed < 3e-3
    assert (np.abs(np.abs(measured) / aperture - table) < tolerance).all()
    # It is a check: with the pixel's aperture left in, or 3 % off, it fails.
    assert (np.abs(np.abs(measured) - table) > tolerance)[3:].all()
    assert (np.abs(np.abs(measured) / aperture - 0.97 * table) > tolerance)[:5].all()


def test_a_lens_that_varies_meets_the_certificate(varied):
    camera = Camera(varied, sensor(), "a camera")
    found = shot(camera, scene(shapes()), Accuracy(tolerance=1e-2, probes=6))
    assert found.certificate.met and found.certificate.rms_relative > 1e-6


def test_an_even_field_keeps_its_light(tmp_path):
    """PSFs of an MTF dip below zero; no light goes with it, and it falls off as the table says."""
    fields = [
        f"height_mm: {h}, relative_illumination: {k}, values: [{VALUES}, {BLURRED}], "
        f"distortion_percent: {d}"
        for h, k, d in ((0, 1, 0), (0.08, 0.97, -0.3), (0.17, 0.88, -1.2))
    ]
    ready = lens(tmp_path, "[[400, 500], 650]", fields)
    camera = Camera(ready, monochrome(), "a camera")
    accuracy = Accuracy(tolerance=3e-3, probes=0)
    found = shot(camera, scene(spectra=FLAT[None]), accuracy).rate.astype(float)
    y, x = (np.indices(found.shape) + 0.5 - np.array([[[48]], [[64]]])) * PITCH_UM
    radius = np.hypot(x, y)
    bank = ready.bank()
    assert bank.psf.min() < 0
    weights = (spectral_weights(bank, camera.sensor) @ FLAT)[0]
    # Smooth between the bank's fields, and even in the height.
    height, table = bank.real_height_um[:, bank.reference], bank.relative_illumination
    both = np.append(-height[:0:-1], height), np.concatenate([table[:0:-1], table])
    expected = CubicSpline(*both)(radius) @ weights
    # What a tolerance promises: the root mean square, and no pixel beyond ten times it.
    error = found / expected - 1
    assert np.sqrt(np.mean(error**2)) < accuracy.tolerance
    assert np.abs(error).max() < 10 * accuracy.tolerance
    # It is a check: without the fall-off it fails.
    assert np.sqrt(np.mean((found / weights.sum() - 1) ** 2)) > 5 * accuracy.tolerance
