"""The plan of highlights: angles and squares as the tolerance and the memory ask for."""

from dataclasses import replace

import numpy as np
import pytest
from optics.lamps import LENS, PITCH, PLACES, SPECTRA
from optics.made import bank, monochrome, plane_bank, sensor

from gpusim.optics import highlight_plan
from gpusim.optics.highlight_plan import CHANGE, FEWEST, plan_highlights
from gpusim.optics.highlight_squares import squares_on_sensor
from gpusim.optics.highlight_tables import TRIED, Tables, mixing_errors
from gpusim.scene.highlights import Highlights

WIDE = Highlights(PLACES[:1], 4 * PITCH, np.ones((1, 1)))  # of a lens that does not change
STILL = bank(coma_um=0.0)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-4, 1e-5])
def test_angles_are_as_many_as_the_tolerance_asks(tolerance: float):
    stage = plan_highlights(STILL, monochrome(), WIDE, SPECTRA[:1], tolerance)
    assert stage.tables.shape == (1, 16) and len(stage.squares.light) == 1
    error = mixing_errors(stage.kernels, [STILL.field(n) for n in range(len(STILL.psf))]).cubic
    errs = error * (TRIED / stage.bins) ** 4  # as the test above says
    # Half of the tolerance is MIXING; one angle fewer would not hold it.
    assert errs <= tolerance / 2
    assert stage.bins == FEWEST or errs * (stage.bins / (stage.bins - 1)) ** 4 > tolerance / 2
    assert (stage.bins == FEWEST) == (tolerance > 1e-2)


def test_squares_are_cut_up_where_the_memory_does_not_hold_the_angles(monkeypatch):
    """Until few angles are enough, and no further; then there are few, whatever they take."""
    few = plan_highlights(STILL, monochrome(), WIDE, SPECTRA[:1], 1e-3)
    monkeypatch.setattr(highlight_plan, "TABLE_BYTES", 1)
    cut = plan_highlights(STILL, monochrome(), WIDE, SPECTRA[:1], 1e-3)
    assert few.bins > cut.bins == FEWEST
    parts = len(cut.squares.light)
    assert parts > 1
    error = mixing_errors(cut.kernels, [STILL.field(n) for n in range(len(STILL.psf))]).cubic
    assert error * (TRIED / FEWEST) ** 4 <= 1e-3 / 2
    light = [one.squares.light.sum() for one in (few, cut)]
    assert light[0] == pytest.approx(light[1], rel=1e-3)  # of the map's slope
    strict = plan_highlights(STILL, monochrome(), WIDE, SPECTRA[:1], 1e-6)
    assert strict.bins == FEWEST and strict.squares.size_um.max() <= PITCH


def test_squares_of_a_lens_without_an_axis_need_no_angles(monkeypatch):
    """Its PSFs are not turned: nothing is mixed, and nothing cut up for want of memory."""
    monkeypatch.setattr(highlight_plan, "TABLE_BYTES", 1)
    stage = plan_highlights(plane_bank(coma_um=0.0), monochrome(), WIDE, SPECTRA[:1], 1e-5)
    whole = squares_on_sensor(stage.bank, monochrome(), WIDE, 200.0, change=CHANGE / 10)
    assert len(stage.squares.light) == len(whole.light)
    assert stage.bins == FEWEST and set(stage.used[:, 1]) == {0}


def test_the_work_is_counted():
    """One highlight takes the tables of its fields and angles, and the pixels within its reach."""
    one = plan_highlights(
        LENS, sensor(960, 1280), Highlights(PLACES[:1], 0.1, np.ones((1, 3))), SPECTRA, 1e-3
    )
    work = one.work()
    assert work["tables"] == 16 * 3 * one.kernels.side**2
    assert work["point sources"] == pytest.approx(np.pi * (one.kernels.reach_um / PITCH) ** 2)
    far = plan_highlights(
        LENS,
        sensor(),
        Highlights(np.array([[1e6, 0.0]]), 0.1, np.ones((1, 3))),
        SPECTRA,
        1e-3,
    )
    assert far is None


def test_highlights_that_no_pixel_sees_are_left_out():
    camera = sensor()
    far = Highlights(np.array([[300.0, 0.0], [1e6, 1e6]]), PITCH, np.ones((2, 3)))
    assert plan_highlights(LENS, camera, far, SPECTRA, 1e-3) is None
    assert len(squares_on_sensor(LENS, camera, far, 20.0).light) == 0


@pytest.mark.parametrize("size", [257, 400])
def test_a_window_much_wider_than_its_light_changes_nothing(size: int):
    """A table is as wide as the light, and may be narrower than the window."""
    before = size // 2 - STILL.psf.shape[-1] // 2
    after = size - STILL.psf.shape[-1] - before
    wide = replace(STILL, psf=np.pad(STILL.psf, ((0, 0), (0, 0), *[(before, after)] * 2)))
    one, other = (Tables(of, monochrome(), SPECTRA[:1], 2 * PITCH) for of in (STILL, wide))
    assert one.side == other.side < size
    for number in range(len(STILL.psf)):
        assert np.array_equal(*(of.spectra(of.bank.field(number)) for of in (one, other)))
    planned = plan_highlights(wide, monochrome(), WIDE, SPECTRA[:1], 1e-3)
    assert planned.kernels.side < size
