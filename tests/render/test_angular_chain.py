"""The whole chain with a quantum efficiency that goes with the angle of the light."""

from __future__ import annotations

import numpy as np
import pytest
from optics.angled import angled, eqe_map, following, lens, plane_lens, round_pixel, unlike
from optics.made import FLAT, RED, StubCamera, bank, scene, sensor, shapes

from gpusim.optics.angular import AngularResponse, TurnedHeights
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.plan.signal import brightest_e
from gpusim.render import Capture, Renderer
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

EXPOSURE_S = 0.01
COARSE = Accuracy(tolerance=1e-2, probes=0)
CERTIFIED = Accuracy(tolerance=1e-2, probes=4)
# Small, so that the exact model is quick: 48 pixels across see 37 um of the field, where its light
# still turns by 5 degrees.
SMALL = {"size": 32, "circle_um": 60.0, "fields": 3, "coma_um": 0.6, "falloff": 0.1}
NEAR_MM = 0.1
LENS = lens(NEAR_MM, **SMALL)
CAMERA = angled(unlike(), 32, 48)
STILL = {"falloff": 0.0, "distortion": 0.0, "coma_um": 0.0, "lateral": (0.0, 0.0, 0.0)}


def shot(found, camera, subject=None, accuracy=COARSE, **more) -> Capture:
    # By transforms: the modes' decomposition takes longer than all the rest of so small a frame.
    lens_and_sensor, subject = StubCamera(found, camera), subject or scene(shapes())
    one = Renderer(lens_and_sensor, subject, accuracy, method="fft")
    try:
        return one.capture(EXPOSURE_S, keep=("rate",), **more)
    finally:
        one.release()


@pytest.mark.parametrize("plane", [False, True])
def test_the_certificate_is_met(plane):
    on_plane = {name: value for name, value in SMALL.items() if name != "fields"}
    lens_there = plane_lens(NEAR_MM, side=5, **on_plane) if plane else LENS
    found = shot(lens_there, CAMERA, accuracy=CERTIFIED).certificate
    assert found.met
    assert 1e-6 < found.rms_relative < 1e-2


def test_tiles_change_not_one_bit():
    whole = shot(LENS, CAMERA, seed=5)
    tiled = shot(LENS, CAMERA, seed=5, tile_px=18)
    assert np.array_equal(tiled.rate, whole.rate)
    assert np.array_equal(tiled.raw, whole.raw)


def on_the_axis(self, number):
    """Return what the axis sees for every field."""
    return TRUE_QE(self, self.bank.probes[0])


def swapped(self, x_um, y_um):
    """Take the sides of the field the wrong way round."""
    blend = TRUE_AT(self, x_um, y_um)
    return blend._replace(weights=TRUE_AT(self, -x_um, -y_um).weights)


TRUE_QE, TRUE_AT = AngularResponse.qe, TurnedHeights.at


@pytest.mark.parametrize(
    ("kind", "name", "planted"),
    [(AngularResponse, "qe", on_the_axis), (TurnedHeights, "at", swapped)],
)
def test_wrong_angles_are_seen_by_the_certificate(monkeypatch, kind, name, planted):
    monkeypatch.setattr(kind, name, planted)
    assert not shot(LENS, CAMERA, accuracy=CERTIFIED).certificate.met


def test_a_flat_field_falls_and_greens_part():
    camera = angled(unlike(), 96, 128, veiling_glare=0.0)
    rate = shot(lens(**STILL), camera, scene()).rate.astype(float)
    gr, gb = rate[0::2, 1::2], rate[1::2, 0::2]
    imbalance = (gr - gb) / (gr + gb)
    rows, cols = imbalance.shape
    # The lean, 0.5 sin(theta), times what the spectrum makes of it, at both ends of the middle.
    ends = imbalance[rows // 2 - 4 : rows // 2 + 4, [2, -3]].mean(axis=0)
    assert ends[0] == pytest.approx(-ends[1], rel=0.05)
    assert ends[1] > 0.08
    assert abs(imbalance[:, cols // 2 - 1 : cols // 2 + 1].mean()) < 2e-3
    # Red, cos^3, at the ends of a line through the middle, against the middle.
    red = rate[0::2, 0::2]
    x_um = (128 / 2 - 5) * 1.55
    expected = np.cos(np.arctan(x_um / 400)) ** 3
    edge = red[rows // 2, [2, -3]].mean() / red[rows // 2, cols // 2]
    assert edge == pytest.approx(expected, rel=0.01)


def test_micro_lenses_that_follow_the_lens_flatten_the_field():
    found = lens(**STILL)
    camera = angled(unlike(), 64, 96, micro_lens=following(found))
    rate = shot(found, camera, scene()).rate.astype(float)
    for row, col in np.ndindex(2, 2):
        of_site = rate[row::2, col::2]
        assert np.ptp(of_site) < 1e-4 * of_site.mean()


def test_a_photograph_with_the_sun_meets_the_certificate():
    planes = np.random.default_rng(6).uniform(0.2, 1, (2, 16, 24)).astype(np.float32)
    planes[:, 4, 20] = 1e4
    photograph = Scene("photograph", np.stack([FLAT, RED]), Raster(planes), "D65", FLAT)
    found = shot(LENS, CAMERA, photograph, CERTIFIED)
    assert found.plan.runs("point sources")
    assert found.certificate.met


def test_veiling_glare_is_of_the_mean_quantum_efficiency():
    """A flat scene: the glare of each site is its share of the mean of its own rates."""
    plain = lens(**STILL | {"falloff": 0.3})
    still, camera = (angled(unlike(), 96, 128, veiling_glare=g) for g in (0.0, 0.05))
    rate = shot(plain, still, scene()).rate.astype(float)
    one = Renderer(StubCamera(plain, camera), scene(), COARSE, method="fft")
    found = one.glare
    one.release()
    expected = [0.05 * rate[row::2, col::2].mean() for row, col in np.ndindex(2, 2)]
    assert found == pytest.approx(expected, rel=2e-3)


def test_no_pixel_is_brighter_than_the_brightest():
    camera = CAMERA
    found = shot(LENS, camera, scene())
    most = brightest_e(LENS, camera, scene(), EXPOSURE_S)
    assert found.rate.max() * EXPOSURE_S < most * (1 + COARSE.tolerance)
    assert most < 1.3 * found.rate.max() * EXPOSURE_S
    middle = spectral_weights(LENS, camera).sum(axis=1) @ FLAT * EXPOSURE_S
    assert list(found.white_e.values()) == pytest.approx(middle)


def test_an_even_quantum_efficiency_is_that_of_a_sensor_without_angles():
    """The same numbers through all of the angles, to the rounding of sums."""
    plain = sensor(32, 48)
    curves = plain.quantum_efficiency
    shape = (1, 3, 4)
    channels = {
        name: (np.ones(shape) * np.array(curve)[:, None, None]).tolist()
        for name, curve in curves.channels.items()
    }
    even = type(unlike())(
        wavelengths_nm=curves.wavelengths_nm,
        theta_deg=[0, 30, 60],
        phi_deg=[0, 90, 180, 270],
        channels=channels,
    )
    camera = plain.model_copy(update={"eqe_map": even})
    assert not AngularResponse(LENS, camera).turning
    with_map, without = (shot(LENS, one).rate.astype(float) for one in (camera, plain))
    # Cones are float32: shares that sum to 1 within 1e-7.
    assert np.abs(with_map / without - 1).max() < 1e-5


def test_a_sensor_without_angles_renders_the_same_bits_whatever_the_lens_knows():
    plain = sensor(32, 48)
    pair = [shot(one, plain).rate for one in (bank(), lens())]
    assert np.array_equal(*pair)
    assert round_pixel(0.0)(550.0, 10.0, 0.0) == 1
    assert len(eqe_map(W=round_pixel()).channels) == 1
