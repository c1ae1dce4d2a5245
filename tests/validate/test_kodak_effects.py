"""Each effect of the Kodak report keeps its law; a planted error of a few per cent turns it red.

A small region of the sensor behind a lens without prescription stands for the whole frame.
"""

import numpy as np
import pytest

from gpusim.camera import Camera, load_camera
from gpusim.library.expose import expose
from gpusim.reference.cti import cti
from gpusim.scene import make_scene
from gpusim.sensor.load import load_sensor
from gpusim.validate import kodak_effects as effects

SMALL = {"rows": 48, "cols": 64}  # a chip of that size: charge has no farther to go


@pytest.fixture(scope="module")
def light():
    camera = load_camera("mtf-only")
    seen = Camera(camera.lens, effects.plain_sensor().model_copy(update=SMALL), "small")
    return expose(seen, make_scene("colorchecker"), 1e-2, probes=0)


@pytest.fixture(scope="module")
def own():
    """Return what effects are taken from; over 48 rows alone the file's smear is one of float32."""
    sensor = load_sensor(effects.SENSOR)
    smear = sensor.smear.model_copy(update={"leak": 10 * sensor.smear.leak})
    return sensor.model_copy(update={**SMALL, "smear": smear})


def all_of(light, own):
    off = effects.read(light, light.sensor)
    return {
        one.name: one
        for one in (
            *effects.charge_effects(light, off, own),
            effects.noise_effect(light, off, own),
            effects.mask_effect(light, off),
            effects.adc_effect(light, off),
        )
    }


def test_effects_of_the_read_out_keep_their_laws(light, own):
    found = all_of(light, own)
    assert len(found) == 7
    assert all(one.bar.held for one in found.values()), [one.bar for one in found.values()]


def test_an_effect_that_is_two_hundredths_too_strong_is_seen(light, own, monkeypatch):
    off = effects.read(light, light.sensor)

    def stronger(light, sensor, *, noise=False, plane="electrons", read=effects.read):
        on = read(light, sensor, noise=noise, plane=plane)
        if plane == "dn":
            return on + 1.0
        # Noise is judged by its variance: three thousand pixels tell a third more from chance.
        return off + (1.15 if noise and sensor.masks is None else 1.02) * (on - off)

    monkeypatch.setattr(effects, "read", stronger)
    found = all_of(light, own)
    assert not any(one.bar.held for one in found.values()), [one.bar for one in found.values()]


def test_packets_leave_their_share_once_for_each_transfer():
    charge = np.array([1000.0, 0.0, 400.0, 0.0, 0.0, 50.0])
    assert effects.transferred(charge, 0.01) == pytest.approx(cti(charge, 0.01), rel=1e-12)
    # By hand: the first leaves a hundredth once, and the second, which has it, once more.
    assert effects.transferred(charge, 0.01)[:2] == pytest.approx([990.0, 9.9])


@pytest.fixture
def corner():
    """Return full images of the bands, and what the sensor's pixels keep of them."""
    drawn = np.random.default_rng(7)
    sensor = effects.plain_sensor()
    bands = drawn.uniform(1000, 20000, (40, 48, 3))
    own = effects.sites(sensor, bands.shape[:2])
    return sensor, bands, np.take_along_axis(bands, own[..., None], axis=2)[..., 0]


def test_flare_is_a_share_of_the_mean_of_its_channel(corner):
    sensor, _, seen = corner
    own = effects.sites(sensor, seen.shape)
    means = np.array([seen[own == k].mean() for k in range(3)])
    sound = effects.flare_effect(seen, seen, seen + 0.02 * means[own], sensor, 0.02)
    assert sound.bar.held
    weak = effects.flare_effect(seen, seen, seen + 0.0198 * means[own], sensor, 0.02)
    assert not weak.bar.held
    of_all = effects.flare_effect(seen, seen, seen + 0.02 * seen.mean(), sensor, 0.02)
    assert not of_all.bar.held


def test_sites_keep_the_band_of_their_filter(corner):
    sensor, bands, seen = corner
    assert effects.filter_effect(seen, bands, sensor).bar.held
    assert not effects.filter_effect(np.roll(seen, 1, axis=1), bands, sensor).bar.held


def test_shifted_filters_cover_the_aperture_by_their_share(corner, monkeypatch):
    sensor, bands, seen = corner
    # An aperture of 0.9 px under filters 0.1 px to the right: 0.05 px of it is below the left one.
    own = effects.sites(sensor, seen.shape)
    left = np.take_along_axis(bands, np.roll(own, 1, axis=1)[..., None], axis=2)[..., 0]
    monkeypatch.setattr(effects, "SHIFT_PX", (0.1, 0.0))
    share = 0.05 / 0.9
    mixed = (1 - share) * seen + share * left
    assert effects.misregistration_effect(seen, bands, mixed, sensor).bar.value < 1e-12
    assert not effects.misregistration_effect(seen, bands, seen, sensor).bar.held
