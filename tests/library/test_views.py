"""What one asks of a lens by hand, against the bank and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.library.lens import Lens
from gpusim.psf.otf import otf

LENS = Lens.load("double-gauss").scaled(12.0).stopped(8.0)


def test_the_psf_and_the_mtf_are_those_of_one_wavefront():
    """At one wavelength the MTF is the modulus of the PSF's transform, less the window's loss."""
    psf = LENS.psf(field=0.7, wavelength_nm=550.0, samples=320)
    assert psf.values.sum() == pytest.approx(1 - psf.outside, abs=1e-12)
    assert psf.field_deg == pytest.approx(0.7 * LENS.max_field_deg) and psf.outside < 0.03
    frequency = np.array([20.0, 60.0])
    # The Airy pattern of f/8 at 550 nm: the lens is near its diffraction limit on the axis.
    axis = LENS.psf(wavelength_nm=550.0, samples=320)
    found = np.abs(otf(axis.values, axis.pitch_um, frequency, "sagittal"))
    s = frequency * 550e-6 * 8.0
    limit = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    # The window loses up to `outside` of the light; aberrations only lower the MTF.
    assert (found <= limit + axis.outside).all() and (found > 0.85 * limit).all()


def test_the_mtf_lies_below_the_limit_and_is_one_at_rest():
    mtf = LENS.mtf(field=0.5)
    # Beyond the window of the fine pupils lies a share of the light, 0.3 % here.
    assert mtf.tangential[0] == pytest.approx(1, abs=5e-3) == mtf.sagittal[0]
    assert (mtf.sagittal <= mtf.limit + 0.02).all()
    low, high = mtf.at(10.0), mtf.at(60.0)
    assert low[0] > high[0] and low[1] > high[1]


def test_each_draws_itself():
    for figure in (LENS.psf().plot(), LENS.mtf().plot(), LENS.layout().plot()):
        assert figure.axes and figure.axes[0].has_data()


def test_a_notebook_shows_a_lens_as_its_layout():
    assert LENS._repr_png_() == LENS.layout()._repr_png_()


def test_each_says_what_it_is_in_a_line():
    psf, mtf, layout = LENS.psf(samples=32), LENS.mtf(frequency_cy_mm=[10.0, 40.0]), LENS.layout()
    assert repr(psf).startswith("Psf(32 x 32 samples of ")
    assert repr(mtf) == "Mtf(2 frequencies up to 40 cy/mm, field 0 deg)"
    assert LENS.title in repr(layout) and len(repr(layout)) < 120


def test_windows_and_frequencies_that_are_none_are_refused():
    for width in (0.0, -3.0, float("nan")):
        with pytest.raises(UserError, match="window_um"):
            LENS.psf(window_um=width)
    for frequency in ([-1.0], [float("nan")], 20.0):
        with pytest.raises(UserError, match="frequency_cy_mm"):
            LENS.mtf(frequency_cy_mm=frequency)


@pytest.mark.parametrize("field", [1.5, -2.0])
def test_a_field_beyond_the_lens_is_refused(field: float):
    for ask in (LENS.psf, LENS.mtf):
        with pytest.raises(UserError, match="beyond the lens"):
            ask(field=field)
