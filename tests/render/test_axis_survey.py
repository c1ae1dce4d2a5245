"""How densely a bank is sampled: where the lens asks for it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from optics.made import FLAT, monochrome, scene

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.plan import Accuracy
from gpusim.psf.compute import compute_bank
from gpusim.psf.places import half_turned
from gpusim.psf.sampling import default_fields_deg
from gpusim.psf.spreads import even_lines_nm, middles_deg
from gpusim.render.axis_survey import FIELDS_SHARE, LINES_SHARE, bank_density
from gpusim.render.survey import Survey
from gpusim.scene.chart import Rect
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene

SENSOR = monochrome(1520, 2028)
GREY = scene((), FLAT[None])
EDGE = scene((Rect(0.0, 0.0, 0.5, 0.5, 0.08, 1),), np.stack([FLAT, FLAT / 16]))


@pytest.fixture(scope="module")
def lens():
    return load_prescription("double-gauss").scaled(8.3).stopped(2.8).limited(14.3)


@pytest.fixture(scope="module")
def loose(lens):
    return bank_density(lens, SENSOR, EDGE, Accuracy(3e-2))


@pytest.fixture(scope="module")
def tight(lens):
    return bank_density(lens, SENSOR, EDGE, Accuracy(3e-4, best_effort=True))


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_lines_are_even_in_the_inverse_wavelength_and_550_nm_is_one(steps):
    lines = even_lines_nm(steps)
    assert 550.0 in lines and lines[0] == 400.0 and lines[-1] == 700.0
    # To the picometre that they are rounded to.
    np.testing.assert_allclose(np.diff(1 / lines), np.diff(1 / lines)[0], rtol=1e-5)


def test_a_loose_tolerance_takes_the_thinnest_bank(lens, loose):
    assert len(loose.wavelengths_nm) == 12
    np.testing.assert_array_equal(loose.field_deg, default_fields_deg(lens))


def test_a_tight_one_takes_more_fields_and_errs_by_less(loose, tight):
    assert set(loose.field_deg) < set(tight.field_deg)
    assert tight.fields_error.max() < loose.fields_error.max() / 2
    assert tight.lines_error.max() <= LINES_SHARE * 3e-4


def test_lines_are_as_many_as_the_tolerance_asks(lens, loose, monkeypatch):
    monkeypatch.setattr("gpusim.render.axis_survey.ROUNDS", 0)
    found = bank_density(lens, SENSOR, EDGE, Accuracy(3e-5, best_effort=True))
    steps = (len(found.wavelengths_nm) - 1) / 11
    assert steps > 1 and found.lines_error.max() <= LINES_SHARE * 3e-5
    np.testing.assert_allclose(found.lines_error, loose.lines_error / steps**4)
    assert loose.lines_error.max() / (steps - 1) ** 4 > LINES_SHARE * 3e-5


def test_points_of_light_ask_for_lines_that_tell_their_fringes(lens, loose):
    sky = np.ones((1, 40, 50), np.float32)
    sky[0, 5, 5] = 1e9
    stars = Scene("stars", FLAT[None], Raster(sky), "E", FLAT)
    found = bank_density(lens, SENSOR, stars, Accuracy(3e-2))
    # 24.5 fringes at 64 um, of which lines are to be 1.6 times as many: 4 in each eleventh.
    assert (len(loose.wavelengths_nm), len(found.wavelengths_nm)) == (12, 45)


def test_a_grey_needs_no_more_than_its_illumination(lens, tight):
    grey = bank_density(lens, SENSOR, GREY, Accuracy(3e-4, best_effort=True))
    assert grey.contrast == 1
    assert len(grey.field_deg) < len(tight.field_deg)
    # What fields may leave of the tolerance; fewer of them may leave more than the edge's many.
    assert grey.fields_error.max() <= FIELDS_SHARE * 3e-4


def test_the_error_between_fields_is_that_of_a_bank_there(lens, loose):
    """PSFs that the bank has at the middles, against those traced there: edge responses."""
    middles = middles_deg(lens, loose.field_deg)[[7, 10]]
    lines = np.array([450.0, 550.0, 650.0])
    fields = np.sort(np.concatenate([loose.field_deg, middles]))
    bank = compute_bank(lens, lines, fields, size=96)
    numbers = np.searchsorted(fields, middles)
    kept = np.setdiff1d(np.arange(len(fields)), numbers)
    rows = {
        name: getattr(bank, name)[kept]
        for name in (
            "field_deg", "ideal_height_um", "real_height_um", "psf", "relative_illumination",
            "outside_energy", "folded_energy", "fit_residual_waves", "failed_rays", "chief", "cone",
        )
    }  # fmt: skip
    thin = replace(bank, **rows, halo=None, halo_pitch_um=None)
    used, places = thin.places(thin.image_circle_um)
    blends, weights = places.blended(bank.real_height_um[numbers, bank.reference])
    kernels = np.stack([thin.psf[one] for one in used[:-1]] + [half_turned(thin.psf[1])])
    made = np.einsum("pnlyx,pn->plyx", kernels[blends], weights)
    off = (made - bank.psf[numbers]).sum(axis=1, dtype=float) / len(lines)
    for place, change in zip((7, 10), off, strict=True):
        steps = [np.cumsum(change.sum(axis=axis)) for axis in (0, 1)]
        # A step beside a black pixel, some tenths of the white: relative to it, two to ten times.
        worst = np.abs(steps).max()
        assert 0.5 * worst < loose.fields_error[place] < 20 * worst


def test_a_lens_without_a_prescription_is_not_asked():
    assert bank_density(object(), SENSOR, EDGE, Accuracy(1e-3)) is None


def test_what_cannot_be_met_is_refused_with_the_nearest_that_can(lens, monkeypatch):
    monkeypatch.setattr("gpusim.render.axis_survey.ROUNDS", 0)
    monkeypatch.setattr("gpusim.render.axis_survey.STEPS", (1,))
    with pytest.raises(UserError, match="fields and 12 wavelengths") as refused:
        bank_density(lens, SENSOR, EDGE, Accuracy(1e-4))
    nearest = float(refused.value.allowed.split()[0])
    assert bank_density(lens, SENSOR, EDGE, Accuracy(nearest)).worst <= 0.85 * nearest
    best = bank_density(lens, SENSOR, EDGE, Accuracy(1e-4, best_effort=True))
    assert best.worst > 0.85e-4


def test_what_wide_psfs_do_to_black_far_from_an_edge_counts():
    """Light that lands 40 to 44 um off in place of nowhere: seen by black pixels there alone."""
    size, pitch_um, contrast, share = 256, 0.5, 20.0, 1e-3
    own, off = np.zeros((2, 1, 2, size))
    own[..., size // 2] = 1.0
    off[..., size // 2 + 80], off[..., size // 2 + 88] = share, -share
    middle = (-1.0) ** np.arange(size // 2 + 1)
    survey = SimpleNamespace(
        contrast=contrast,
        size=size,
        sensor=SENSOR,
        pitch_um=pitch_um,
        points=False,
    )
    found = Survey.error(survey, np.fft.rfft(off) * middle, np.fft.rfft(own) * middle)
    # 8 of the 2 x 128 samples of the widest stretch, black one way round and white the other.
    black, white = (share * (1 - 1 / contrast) / level for level in (1 / contrast, 1.0))
    assert found == pytest.approx(np.sqrt((black**2 + white**2) / 2 * 8 / size), rel=1e-6)
