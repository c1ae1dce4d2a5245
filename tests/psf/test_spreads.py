"""The survey of line spreads is kept: a second render of a lens reads it from the cache."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription, presets
from gpusim.psf import spreads as module

LINES_NM = np.array([550.0])
FIELDS_DEG = np.array([0.0, 5.0])


@pytest.mark.parametrize("of", ["spreads", "traced_spreads"])
def test_a_second_survey_is_read_from_the_cache(monkeypatch, tmp_path, of):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    lens = load_prescription(presets()["double-gauss"])
    cached = getattr(module, f"cached_{of}")
    first = cached(lens, LINES_NM, FIELDS_DEG)

    def computed_again(*_, **__):
        raise AssertionError("the survey was computed again")

    # The key knows a function by its name, not by what it does; so the second call finds the file.
    monkeypatch.setattr(module, of, computed_again)
    second = cached(lens, LINES_NM, FIELDS_DEG)
    np.testing.assert_array_equal(first.spread, second.spread)
    assert second.efl_mm == first.efl_mm


def test_a_survey_with_half_of_the_cells_sees_what_the_whole_one_sees():
    # Light of a PSF from beyond 512 samples comes back on its other side: under 1e-3 of it here.
    lens = load_prescription(presets()["compact-6mm"])
    whole, half = (
        module.spreads(lens, LINES_NM, FIELDS_DEG, transform=transform) for transform in (1024, 512)
    )
    peak = whole.spread.max()
    np.testing.assert_allclose(half.spread, whole.spread, atol=1e-3 * peak)
    assert abs(half.spread - whole.spread).max() > 0
    np.testing.assert_allclose(half.light_sr, whole.light_sr, rtol=1e-3)


@pytest.mark.parametrize("name", ["compact-6mm", "double-gauss"])
def test_a_survey_misses_little_without_what_a_rim_loses(name):
    """Less than 1e-4 of a line spread's peak; what fields leave half-way is less by far.

    Measured 5e-6 and 4e-5. A tolerance of 1e-3 leaves more than that to the fields of a bank.
    """
    lens = load_prescription(presets()[name])
    whole, alone = (module.spreads(lens, LINES_NM, FIELDS_DEG, rim=rim) for rim in (True, False))
    lost = np.abs(whole.spread - alone.spread).max() / whole.spread.max()
    assert 0 < lost < 1e-4


def test_a_survey_never_takes_fewer_cells_than_two_for_each_sample():
    lens = load_prescription(presets()["double-gauss"])
    whole, half = (
        module.spreads(lens, LINES_NM, FIELDS_DEG, transform=transform) for transform in (1024, 512)
    )
    assert whole.spread.shape[-1] > 256
    np.testing.assert_array_equal(half.spread, whole.spread)
