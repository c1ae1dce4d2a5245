"""Windows and fields fit the lens: wide enough for its rays, and no wider than need be."""

import numpy as np
import pytest
from lens.made import fisheye

from gpusim.errors import UserError
from gpusim.lens.system import build
from gpusim.psf.compute import compute_bank
from gpusim.psf.sampling import (
    PITCH_UM,
    SIZE,
    SIZES,
    WAVELENGTHS_NM,
    default_fields_deg,
    window,
)


def test_the_demonstration_lens_has_the_default_window(demo_lens):
    assert window(build(demo_lens), WAVELENGTHS_NM) == (SIZE, PITCH_UM)


def test_a_lens_whose_rays_land_farther_away_gets_a_wider_window(double_gauss):
    # At f = 100 mm rays land twelve times as far away as at 8.3 mm.
    assert window(build(double_gauss.stopped(2.8)), WAVELENGTHS_NM)[0] == SIZES[-1]
    small = double_gauss.scaled(8.3).stopped(2.8)
    assert window(build(small), WAVELENGTHS_NM) == (SIZE, PITCH_UM)


def test_a_fast_lens_with_wide_spots_gets_the_widest_pitch_that_the_bank_accepts(double_gauss):
    # lambda / (4 sin theta') = lambda N / 2 = 0.4 um at f/2 and 400 nm; the default is 0.25.
    assert window(build(double_gauss), WAVELENGTHS_NM) == (SIZES[-1], 0.35)
    # Red alone needs samples half as close.
    assert window(build(double_gauss), [700.0]) == (SIZES[-1], PITCH_UM)
    tiny = {"wavelengths_nm": [400.0, 550.0], "field_deg": [0.0, 22.0], "size": 32}
    assert compute_bank(double_gauss, **tiny, pitch_um=0.35).pitch_um == 0.35
    with pytest.raises(UserError, match="too coarse"):
        compute_bank(double_gauss, **tiny, pitch_um=0.45)


def test_a_bank_takes_the_window_itself(demo_lens):
    wide = demo_lens.resized(4.0)
    lines, fields = [400.0, 550.0], [0.0, wide.max_field_deg]
    size, pitch_um = window(build(wide), lines)
    assert size > SIZES[0]
    bank = compute_bank(wide, lines, fields)
    assert (bank.psf.shape[-1], bank.pitch_um) == (size, pitch_um)
    # The light beyond: 2 % of the rays, and what diffraction spreads.
    assert bank.outside_energy.max() < 0.04
    small = compute_bank(wide, lines, fields, size=SIZE)
    assert small.psf.shape[-1] == SIZE and small.pitch_um == pitch_um
    assert small.outside_energy.max() > 1.5 * bank.outside_energy.max()


def test_fields_of_a_wide_lens_are_even_in_angle_and_others_in_its_tangent(demo_lens):
    np.testing.assert_allclose(default_fields_deg(fisheye(), 8), np.arange(8) * 15.0)
    at_50 = default_fields_deg(demo_lens.model_copy(update={"max_field_deg": 50.0}), 3)
    assert np.tan(np.radians(at_50[1])) == pytest.approx(np.tan(np.radians(50)) / 2)
