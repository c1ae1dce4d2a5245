"""Indices against the makers' data sheets; every doubt about a glass is an error."""

from pathlib import Path

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.lens import glass
from gpusim.lens.prescription import Surface

FILE = Path("some-lens.yaml")
LINES = np.array([glass.D_LINE_NM, glass.F_LINE_NM, glass.C_LINE_NM])


@pytest.mark.parametrize(
    ("catalogue", "name", "nd", "vd"),
    [
        # Data sheets of the makers, as printed: nd to five digits, Vd to two.
        ("SCHOTT", "N-BK7", 1.51680, 64.17),
        ("SCHOTT", "F2", 1.62004, 36.37),
        ("SCHOTT", "SF15", 1.69895, 30.07),
        ("OHARA", "S-LAH58", 1.88300, 40.76),
        ("CDGM", "H-LAK1", 1.65950, 57.35),
        ("HOYA", "FCD1", 1.49700, 81.61),
        ("LZOS", "K8", 1.51637, 64.07),
    ],
)
def test_index_and_dispersion_are_those_of_the_data_sheet(catalogue, name, nd, vd):
    d, f, c = glass.catalogue_index(catalogue, name, LINES, surface=1, file=FILE)
    assert abs(d - nd) < 0.6e-5  # half the last printed digit, and the fit of the dispersion law
    # Half the last digit, plus 1e-6 of rounding in nF - nC = 0.008 to 0.023.
    assert abs((d - 1) / (f - c) - vd) < 0.015


def test_glasses_that_are_not_optical_ones_stand_in_their_makers_catalogue():
    # Schott's data sheet of B 270 i: nd 1.5230 to four digits.
    d = glass.catalogue_index("SCHOTT", "B270", LINES[:1], surface=1, file=FILE)
    assert abs(d[0] - 1.5230) < 0.6e-4
    assert glass.resolve("zerodur", (), surface=1, file=FILE) == ("SCHOTT", "ZERODUR")


def test_model_glass_has_the_stated_index_and_abbe_number():
    d, f, c = glass.model_index(1.6, 40.0, LINES)
    assert d == pytest.approx(1.6, abs=1e-14)
    assert (d - 1) / (f - c) == pytest.approx(40.0, rel=1e-12)
    assert f > d > c


def test_a_constant_glass_has_one_index():
    surface = Surface(radius=10.0, thickness=1.0, glass="constant", nd=1.67)
    found = glass.surface_index(surface, 1, (), np.array([300.0, 2000.0]), file=FILE)
    assert found.tolist() == [1.67, 1.67]


def test_unknown_glass_names_glass_surface_file_and_near_names():
    with pytest.raises(UserError) as caught:
        glass.resolve("N-BK77", ("SCHOTT",), surface=3, file=FILE)
    text = caught.value.screen()
    for part in ("'N-BK77'", "surface 3", "SCHOTT", "some-lens.yaml", "SCHOTT/N-BK7"):
        assert part in text


def test_glass_of_another_catalogue_is_not_taken_but_named():
    with pytest.raises(UserError) as caught:
        glass.resolve("S-LAH58", ("SCHOTT", "HOYA"), surface=1, file=FILE)
    assert "OHARA/S-LAH58" in caught.value.screen()


def test_ambiguous_glass_lists_the_catalogues():
    with pytest.raises(UserError) as caught:
        glass.resolve("F2", (), surface=2, file=FILE)
    assert "several catalogues" in caught.value.screen()
    assert "SCHOTT/F2" in caught.value.screen()
    assert "CDGM/F2" in caught.value.screen()


def test_order_of_catalogues_and_explicit_catalogue_decide():
    assert glass.resolve("F2", ("CDGM", "SCHOTT"), surface=1, file=FILE) == ("CDGM", "F2")
    assert glass.resolve("f2", ("SCHOTT", "CDGM"), surface=1, file=FILE) == ("SCHOTT", "F2")
    assert glass.resolve("hikari/F2", ("SCHOTT",), surface=1, file=FILE) == ("HIKARI", "F2")


def test_unknown_catalogue_is_refused():
    with pytest.raises(UserError, match="unknown glass catalogue"):
        glass.resolve("LEITZ/N-BK7", (), surface=1, file=FILE)


def test_wavelength_outside_the_data_is_refused():
    with pytest.raises(UserError) as caught:
        glass.catalogue_index("HIKARI", "SK16", np.array([550.0, 350.0]), surface=4, file=FILE)
    text = caught.value.screen()
    for part in ("HIKARI/SK16", "surface 4", "350 nm", "400 to 700 nm"):
        assert part in text
