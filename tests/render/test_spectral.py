"""A spectral scene through its few planes is the sum of its bands, each rendered alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from optics.made import StubCamera, bank, sensor
from scipy.ndimage import gaussian_filter

import gpusim as gs
from gpusim.optics import spectral_basis
from gpusim.plan import Accuracy
from gpusim.render import Renderer

BANDS_NM = np.linspace(400.0, 700.0, 8)
# Colours differ in width; nothing varies over the field, so that no cells err between nodes.
LENS = bank(coma_um=0.0, falloff=0.0, halo=0.02, lateral=(0.0, 0.0, 0.0))
CAMERA = StubCamera(LENS, sensor())
TOLERANCE = 1e-5
TIGHT = Accuracy(TOLERANCE, 0, best_effort=True)


def seen(scene: gs.Scene) -> tuple[np.ndarray, int]:
    """Return electrons/s of each pixel, and the number of planes."""
    renderer = Renderer(CAMERA, scene, TIGHT)
    try:
        rate = renderer.capture(0.01, keep=("rate",)).rate
        return rate.astype(float), renderer.plan.basis.coefficients.shape[1]
    finally:
        renderer.release()


@pytest.fixture(scope="module")
def scene() -> gs.Scene:
    """Eight bands, each of a structure of its own: no pixel has the spectrum of another."""
    rng = np.random.default_rng(4)
    bands = [gaussian_filter(rng.uniform(0, 1, (96, 128)), 3) for _ in BANDS_NM]
    cube = np.moveaxis(np.array(bands), 0, -1)
    cube = 0.1 + (cube - cube.min()) / np.ptp(cube)
    return gs.Scene.from_spectra(1e-2 * cube, BANDS_NM)


@pytest.fixture(scope="module")
def band_by_band(scene: gs.Scene) -> np.ndarray:
    """Return the sum of the renders of single bands."""
    total = np.zeros((CAMERA.sensor.rows, CAMERA.sensor.cols))
    for band in range(len(BANDS_NM)):
        only = np.zeros_like(scene.spectra)
        only[band] = scene.spectra[band]
        rate, planes = seen(replace(scene, spectra=only))
        assert planes == 1
        total += rate
    return total


@pytest.mark.slow
def test_a_spectral_scene_is_the_sum_of_its_bands(scene, band_by_band):
    whole, planes = seen(scene)
    assert planes < len(BANDS_NM)
    assert np.abs(whole / band_by_band - 1).max() < TOLERANCE


def test_planes_that_are_missing_show(scene, band_by_band, monkeypatch):
    monkeypatch.setattr(spectral_basis, "MAX_PLANES", 3)
    whole, planes = seen(scene)
    assert planes == 3
    assert np.abs(whole / band_by_band - 1).max() > 10 * TOLERANCE
