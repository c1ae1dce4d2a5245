"""The survey of line spreads is kept: a second render of a lens reads it from the cache."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription, presets
from gpusim.psf import spreads as module

LINES_NM = np.array([550.0])
FIELDS_DEG = np.array([0.0, 5.0])


@pytest.mark.parametrize("traced", [False, True], ids=["generated", "traced"])
def test_a_second_survey_is_read_from_the_cache(monkeypatch, tmp_path, traced):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    lens = load_prescription(presets()["double-gauss"])
    first = module.cached_spreads(lens, LINES_NM, FIELDS_DEG, traced=traced)

    def computed_again(*_, **__):
        raise AssertionError("the survey was computed again")

    # The key knows a function by its name, not by what it does; so the second call finds the file.
    monkeypatch.setattr(module, "traced_spreads" if traced else "spreads", computed_again)
    second = module.cached_spreads(lens, LINES_NM, FIELDS_DEG, traced=traced)
    np.testing.assert_array_equal(first.spread, second.spread)
    assert second.efl_mm == first.efl_mm
