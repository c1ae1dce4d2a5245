"""The whole chain with a lens that has no axis: closed forms, the symmetric lens, the certificate.

x right, y down; every number differs in x and y, so that neither a mirror nor a transposition goes
unseen.
"""

from __future__ import annotations

import numpy as np
import pytest
from harness import assert_close
from optics.made import (
    FLAT,
    MOVED,
    RED,
    StubCamera,
    bank,
    dots_image,
    monochrome,
    plane_bank,
    scene,
    sensor,
    shapes,
)
from sampling import one_in

from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.optics.flare import veiling_glare
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.psf.places import Blend, FieldGrid
from gpusim.render import Capture, Renderer
from gpusim.scene.chart import Disc
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.sensor.qe import QuantumEfficiency

EXPOSURE_S = 0.01
PITCH = 1.55
COARSE = Accuracy(tolerance=1e-2, probes=0)
CERTIFIED = Accuracy(tolerance=1e-2, probes=8)
LENS = plane_bank(coma_um=0.6, falloff=0.1, **MOVED)


def shot(lens, camera, subject, accuracy=COARSE, **more) -> Capture:
    renderer = Renderer(StubCamera(lens, camera), subject, accuracy)
    try:
        return renderer.capture(EXPOSURE_S, keep=("rate",), **more)
    finally:
        renderer.release()


@pytest.mark.parametrize("line", [0, 2])
def test_dots_land_and_flare_where_the_closed_form_says(line: int):
    """Coma on the axis too, keystone, boresight and lateral colour, of one wavelength at a time."""
    grey = QuantumEfficiency(wavelengths_nm=[400, 700], channels={"W": [0.5, 0.5]})
    camera = monochrome(quantum_efficiency=grey)
    places = [(0.9, 0.1), (-0.2, 0.75), (-0.8, -0.45), (0.03, -0.1)]
    laser = np.where(WAVELENGTHS_NM == LENS.wavelengths_nm[line], 1.0, 0.0)
    weights = spectral_weights(LENS, camera)[0] @ laser
    dots = tuple(Disc(*place, 0.06, 1) for place in places)
    found = shot(LENS, camera, scene(dots, np.stack([0 * laser, laser]))).rate.astype(float)
    expected = dots_image(places, 0.06, found.shape, weights)
    scale = np.pi * (0.06 * 96 / 2) ** 2  # pixels of a dot
    assert found.sum() == pytest.approx(scale * expected.sum(), rel=COARSE.tolerance)
    # The plan's tolerance is for one edge; a dot has two. PSFs are bilinear between fields 41 um
    # apart, coma and light are linear or nearly so.
    allowed = 2 * COARSE.tolerance * expected.max() * scale
    assert_close(found, scale * expected, atol=allowed)
    # The controls: the other way along x, along y, and on the diagonal.
    for flip in ((-1, 1), (1, -1), (-1, -1)):
        wrong = dots_image(places, 0.06, found.shape, weights, flip)
        assert np.abs(found - scale * wrong).max() > 5 * allowed


def test_a_symmetric_lens_renders_the_same_in_both_kinds_of_bank():
    """Against a bank of 12 fields in radius, turned; in the grid nothing is turned."""
    settings = {"coma_um": 0.6, "falloff": 0.1, "halo": 0.01}
    accuracy = Accuracy(tolerance=2e-3, probes=0)
    camera, subject = monochrome(), scene(shapes())
    turned = shot(bank(fields=24, **settings), camera, subject, accuracy).rate.astype(float)
    grid = shot(plane_bank(17, **settings), camera, subject, accuracy).rate.astype(float)
    # Two renders of that tolerance; light falls with the square of the height: between fields h
    # apart bilinear interpolation errs by 2 x 0.1 (h / 2)^2 / 165^2 = 8e-4 (h = 20.6 um), less on
    # the mean.
    relative = found_over(grid, turned)
    assert np.sqrt(np.mean(relative**2)) < 2**0.5 * 2e-3
    assert np.abs(relative).max() < 10 * 2**0.5 * 2e-3
    # A control: the same flare in one direction everywhere.
    moved = plane_bank(17, **settings, axial_coma_um=(0.3, 0.2))
    other = found_over(shot(moved, camera, subject, accuracy).rate, turned)
    assert np.sqrt(np.mean(other**2)) > 2 * 2**0.5 * 2e-3


def found_over(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one.astype(float) / other - 1


def test_the_certificate_is_met_and_tiles_change_not_one_bit():
    camera = sensor(64, 96)
    whole = shot(LENS, camera, scene(shapes()), CERTIFIED, seed=5)
    assert whole.certificate.met and 1e-6 < whole.certificate.rms_relative < 1e-2
    tiled = shot(LENS, camera, scene(shapes()), COARSE, seed=5, tile_px=34)
    assert_close(tiled.rate, whole.rate, atol=0)
    assert_close(tiled.raw, whole.raw, atol=0)


def swapped(self: FieldGrid, x_um: float, y_um: float) -> Blend:
    return AT(self, y_um, x_um)


def mirrored(self: FieldGrid, x_um: float, y_um: float) -> Blend:
    return AT(self, -x_um, y_um)


def upside_down(self: FieldGrid, x_um: float, y_um: float) -> Blend:
    return AT(self, x_um, -y_um)


AT = FieldGrid.at


@pytest.mark.parametrize("at", one_in(2, [AT, swapped, mirrored, upside_down]))
def test_a_wrong_field_grid_is_seen_by_the_certificate(monkeypatch, at):
    lens = plane_bank(coma_um=3.0, falloff=0.4)
    monkeypatch.setattr(FieldGrid, "at", at)
    found = shot(lens, monochrome(), scene(shapes()), CERTIFIED).certificate
    assert found.met is (at is AT)


def test_a_photograph_meets_the_certificate():
    rng = np.random.default_rng(6)
    planes = rng.uniform(0.2, 1, (2, 24, 32)).astype(np.float32)
    photograph = Scene("photograph", np.stack([FLAT, RED]), Raster(planes), "D65", FLAT)
    found = shot(LENS, sensor(), photograph, Accuracy(tolerance=1e-2, probes=6))
    assert found.certificate.met and 1e-6 < found.certificate.rms_relative


def test_veiling_glare_counts_the_light_that_lands():
    camera = sensor(veiling_glare=0.03)
    weights = np.random.default_rng(8).uniform(1, 9, (1, 3, 3))
    lens = plane_bank(circle_um=110.0, falloff=0.5, **MOVED)
    found = veiling_glare(lens, camera, scene().source.placed(74.4), weights, np.ones((4, 1)))
    line = (np.arange(600) + 0.5) / 600 - 0.5
    x, y = np.meshgrid(line * 128 * PITCH, line * 96 * PITCH)
    inside = np.hypot(x - 6.0, y + 3.0) <= lens.image_circle_um
    light = lens.illumination_at(x, y) * inside
    expected = 0.03 * np.einsum("lyx,jcl->c", light, weights) / x.size
    assert 0.5 < inside.mean() < 0.99
    # The circle's arcs counted in points: see optics/test_flare.
    assert_close(found, expected[[2, 1, 1, 0]], rtol=2e-3)


def test_memory_is_given_back(device: Device):
    before = device.pool.in_use
    shot(LENS, sensor(48, 64), scene(shapes()))
    assert device.pool.in_use == before


def test_distortion_that_no_polynomial_follows_is_refused():
    lens = plane_bank()
    lens.ray_x_um[1::2] += 0.05
    with pytest.raises(UserError, match="not smooth enough"):
        shot(lens, sensor(48, 64), scene(shapes()))
