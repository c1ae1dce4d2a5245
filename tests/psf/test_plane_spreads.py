"""Line spreads of a lens without an axis: the sums of its PSFs, by the shaders and in float64."""

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription
from gpusim.psf.plane_spreads import PlaneSpreads, cached_plane_spreads, plane_spreads

LINES = np.array([450.0, 550.0])
LENS = load_prescription("cooke-triplet").with_element_moved(3, 4, (0.05, 0.03))
FIELDS = {"field_x_deg": np.array([0.0, 9.0]), "field_y_deg": np.array([0.0, -6.0])}


@pytest.fixture(scope="module")
def found():
    return plane_spreads(LENS, LINES, **FIELDS)


def test_they_are_those_of_the_float64_path(found):
    true = plane_spreads(LENS, LINES, **FIELDS, traced=True)
    # As of edges in whole PSFs (test_plane_generator), and what sampling the rim loses of a core:
    # lambda N / (pi^2 r) of the light at half the window's radius, 16 um, a fifth of it.
    steps = np.cumsum(found.spread - true.spread, axis=-1)
    assert np.abs(steps).max() < 4e-4
    np.testing.assert_allclose(found.light_sr, true.light_sr, rtol=9e-5)
    np.testing.assert_allclose(found.chief_um, true.chief_um, atol=1e-5)
    # Along x is not along y.
    assert np.abs(np.cumsum(found.spread[1, :, ::-1] - true.spread[1], axis=-1)).max() > 0.01


def test_half_of_the_cells_change_what_is_common_to_all_fields(found):
    """A survey compares fields with one another: what its coarser rim errs by drops out."""
    coarse = plane_spreads(LENS, LINES, **FIELDS, transform=512)
    off = np.cumsum(coarse.spread - found.spread, axis=-1)
    assert np.abs(off).max() < 1.6e-3
    np.testing.assert_allclose(coarse.light_sr, found.light_sr, rtol=2e-4)


def test_they_survive_their_file(found, tmp_path, monkeypatch):
    found.save(tmp_path / "spreads.nc")
    again = PlaneSpreads.load(tmp_path / "spreads.nc")
    np.testing.assert_array_equal(again.spread, found.spread)
    np.testing.assert_array_equal(again.chief_um, found.chief_um)
    assert again.provenance == found.provenance
    assert again.reference == 1
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    kept = cached_plane_spreads(LENS, wavelengths_nm=LINES[1:], **FIELDS, progress=None)
    monkeypatch.setattr("gpusim.psf.plane_spreads.build", None)
    same = cached_plane_spreads(LENS, wavelengths_nm=LINES[1:], **FIELDS, progress=None)
    np.testing.assert_array_equal(same.spread, kept.spread)
