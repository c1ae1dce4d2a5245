"""The sampling fits the lens: fine enough to be accepted, no finer, and wide enough."""

import pytest

from gpusim.errors import UserError
from gpusim.lens.bank import compute_bank
from gpusim.lens.sampling import PITCHES_UM, fitting
from gpusim.lens.system import build


def test_the_demonstration_lens_has_the_default_sampling(demo_lens):
    assert fitting(build(demo_lens)) == {}


def test_a_faster_lens_gets_a_finer_pitch_that_the_bank_accepts(double_gauss):
    fast = double_gauss.scaled(8.3)
    settings = fitting(build(fast))
    pitch = settings["pitch_um"]
    # lambda / (4 sin theta') = lambda N / 2 = 0.4 um at f/2 and 400 nm.
    assert pitch < 0.4
    tiny = {"wavelengths_nm": [400.0, 550.0], "field_deg": [0.0, 22.0], "size": 32}
    compute_bank(fast, **tiny, pitch_um=pitch)
    with pytest.raises(UserError, match="too coarse"):
        compute_bank(fast, **tiny, pitch_um=PITCHES_UM[0])


def test_a_lens_with_wider_spots_gets_a_wider_window(double_gauss):
    # At f = 100 mm rays land twelve times as far away as at 8.3 mm.
    assert fitting(build(double_gauss.stopped(2.8)))["size"] > 256
    small = fitting(build(double_gauss.scaled(8.3).stopped(2.8)))
    assert small.get("size", 256) == 256


def test_the_window_catches_the_rays(demo_lens):
    wide = demo_lens.resized(4.0)
    settings = fitting(build(wide))
    assert settings["size"] > 256
    bank = compute_bank(wide, [550.0], [0.0, wide.max_field_deg], **settings)
    # The light beyond: 2 % of the rays, and what diffraction spreads.
    assert bank.outside_energy.max() < 0.04
    small = compute_bank(wide, [550.0], [0.0, wide.max_field_deg])
    assert small.outside_energy.max() > 1.5 * bank.outside_energy.max()
