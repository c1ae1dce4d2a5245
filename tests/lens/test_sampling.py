"""The window of the PSFs fits the lens: wide enough for its rays, and no wider than need be."""

import pytest

from gpusim.errors import UserError
from gpusim.lens.bank import compute_bank
from gpusim.lens.sampling import SIZES, window
from gpusim.lens.system import build


def test_the_demonstration_lens_has_the_default_window(demo_lens):
    assert window(build(demo_lens)) == {}


def test_a_lens_whose_rays_land_farther_away_gets_a_wider_window(double_gauss):
    # At f = 100 mm rays land twelve times as far away as at 8.3 mm.
    assert window(build(double_gauss.stopped(2.8)))["size"] == SIZES[-1]
    assert window(build(double_gauss.scaled(8.3).stopped(2.8))) == {}


def test_a_fast_lens_with_wide_spots_gets_the_widest_pitch_that_the_bank_accepts(double_gauss):
    settings = window(build(double_gauss))
    # lambda / (4 sin theta') = lambda N / 2 = 0.4 um at f/2 and 400 nm; the default is 0.25.
    assert settings == {"size": SIZES[-1], "pitch_um": 0.35}
    tiny = {"wavelengths_nm": [400.0, 550.0], "field_deg": [0.0, 22.0], "size": 32}
    assert compute_bank(double_gauss, **tiny, pitch_um=0.35).pitch_um == 0.35
    with pytest.raises(UserError, match="too coarse"):
        compute_bank(double_gauss, **tiny, pitch_um=0.45)


def test_the_window_catches_the_rays(demo_lens):
    wide = demo_lens.resized(4.0)
    settings = window(build(wide))
    assert settings["size"] > SIZES[0]
    bank = compute_bank(wide, [550.0], [0.0, wide.max_field_deg], **settings)
    # The light beyond: 2 % of the rays, and what diffraction spreads.
    assert bank.outside_energy.max() < 0.04
    small = compute_bank(wide, [550.0], [0.0, wide.max_field_deg])
    assert small.outside_energy.max() > 1.5 * bank.outside_energy.max()
