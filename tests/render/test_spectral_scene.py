"""A scene of many bands through the whole chain: what its planes make is what its bands make."""

from dataclasses import replace

import numpy as np
import pytest
from optics.made import FLAT, StubCamera, bank, sensor

from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.spectral_basis import camera_basis
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import WAVELENGTHS_NM

BANDS = 31
LENS = bank(
    size=48,
    sigma_um=tuple(np.linspace(0.95, 1.15, 13)),
    lateral=tuple(np.linspace(-0.004, 0.003, 13)),
    coma_um=0.6,
    falloff=0.1,
)
CAMERA = StubCamera(LENS, sensor(32, 32))
SPECTRA = 1e-3 * np.maximum(
    1 - np.abs(WAVELENGTHS_NM - np.linspace(400, 700, BANDS)[:, None]) / 10, 0
)


def cube() -> np.ndarray:
    """Return smooth spectra (31, 40, 40) of six colours that pass into one another."""
    rng = np.random.default_rng(5)
    bumps = np.exp(-((np.linspace(0, 1, BANDS) - rng.uniform(0, 1, (6, 1))) ** 2) / 0.02)
    y, x = np.mgrid[:40, :40] / 40
    phase = rng.uniform(0, 6, (6, 3))
    shares = [1.1 + np.sin(a + 9 * x) * np.sin(b + 7 * y) + 0.2 * (c > 3) for a, b, c in phase]
    return np.einsum("sb,syx->byx", bumps, shares).astype(np.float32)


def subject(planes: np.ndarray, spectra: np.ndarray) -> Scene:
    return Scene("bands", spectra, Raster(planes), "D65", FLAT)


def rate(renderer: Renderer) -> np.ndarray:
    """Return electrons/s of the pixels, without the scene's glare."""
    try:
        return renderer.capture(0.01, keep=("rate",)).rate.astype(float)
    finally:
        renderer.release()


def band_by_band(plan, planes: np.ndarray) -> np.ndarray:
    """Return the sum of the renders of each band by itself, a plane each, on the grid of a plan."""
    total = 0.0
    (scale,) = plan.scales
    core = LENS.levels[0]
    for number in range(BANDS):
        spectra = SPECTRA[number : number + 1]
        basis = camera_basis(core, CAMERA.sensor, spectra, 1e-9, np.array([0]), place_error=0.0)
        images, places = field_images(core, basis.rates, 1e9)
        part = np.ones(images.shape[-2:])
        kernels = field_kernels(images, places, core.pitch_um, scale.pitch_um, part)
        own = replace(plan, basis=basis, scales=(replace(scale, kernels=kernels),))
        scene = subject(planes[number : number + 1], spectra)
        total = total + rate(Renderer(CAMERA, scene, Accuracy(1e-3, 0), plan=own, noise=False))
    return total


@pytest.fixture(scope="module")
def planned() -> tuple[object, np.ndarray, np.ndarray]:
    """Return a plan for 1e-3, its render, and that of all planes that the camera tells apart."""
    planes = cube()
    one = Renderer(CAMERA, subject(planes, SPECTRA), Accuracy(1e-3, 0), method="fft", noise=False)
    plan, few = one.plan, rate(one)
    return plan, few, planes


def test_a_scene_of_31_bands_is_planned_at_1e_3_in_signed_planes(planned):
    plan, _, _ = planned
    count = plan.basis.coefficients.shape[1]
    # The scene has six colours, though a camera of three channels tells twelve of the bands apart
    # at 1e-3.
    assert 3 < count <= 6
    assert (plan.basis.coefficients < 0).any()
    assert plan.shortfall == ""
    # Accounted for: the stage that makes the planes says what they leave out.
    stage = next(one for one in plan.stages if one.name == "warp")
    assert stage.predicted_error == plan.basis.residual <= 5e-3
    assert plan.basis.rms <= 0.1 * 5e-3


def test_the_exact_model_which_has_the_bands_themselves_certifies_the_planes():
    scene = subject(cube(), SPECTRA)
    one = Renderer(CAMERA, scene, Accuracy(1e-3, 8), method="fft", noise=False)
    try:
        certificate = one.capture(0.01).certificate
    finally:
        one.release()
    assert certificate.engine_rms < 1e-3


def test_planes_make_what_the_bands_make(planned):
    plan, few, planes = planned
    true = band_by_band(plan, planes)
    # All planes that three channels and 31 bands tell apart, on the same grid.
    core = LENS.levels[0]
    basis = camera_basis(core, CAMERA.sensor, SPECTRA, 0.0, np.arange(BANDS), place_error=0.0)
    assert basis.coefficients.shape[1] > 8
    images, places = field_images(core, basis.rates, 1e9)
    (scale,) = plan.scales
    part = np.ones(images.shape[-2:])
    kernels = field_kernels(images, places, core.pitch_um, scale.pitch_um, part)
    own = replace(plan, basis=basis, scales=(replace(scale, kernels=kernels),))
    scene = subject(planes, SPECTRA)
    whole = rate(Renderer(CAMERA, scene, Accuracy(1e-3, 0), plan=own, noise=False))
    assert np.abs(whole / true - 1).max() < 1e-5
    # And fewer err by no more than the plan says.
    off = few / true - 1
    assert np.sqrt(np.mean(off**2)) <= plan.basis.rms + 1e-5
    assert np.abs(off).max() <= plan.basis.residual + 1e-5
