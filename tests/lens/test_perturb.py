"""One number of a lens changed: names, glasses of a catalogue, elements."""

from __future__ import annotations

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.perturb import elements, names_part, parts, perturbed
from gpusim.lens.system import indices


@pytest.fixture(scope="module")
def lens():
    return load_prescription("double-gauss")


def test_names():
    assert names_part("2.radius") and names_part("element.1-2.tilt_x_deg")
    assert not names_part("all.radius") and names_part("all.radius", several=True)
    for wrong in ("2.weight", "element.1-2.radius", "x.radius", "2", "element.all.nd"):
        assert not names_part(wrong, several=True)


def test_an_element_is_glass_between_air_and_air(lens):
    found = elements(lens)
    glass = [surface.glass is not None for surface in lens.surfaces]
    for first, last in found:
        assert all(glass[first - 1 : last - 1]) and not glass[last - 1]
    inside = sum(last - first for first, last in found)
    assert inside == sum(glass)
    assert parts(lens, "element.all.tilt_x_deg") == [
        f"element.{a}-{b}.tilt_x_deg" for a, b in found
    ]


def test_the_index_of_a_catalogue_glass_moves_at_every_wavelength(lens):
    """Also where the source printed an index beside the glass: the light meets the catalogue's."""
    at = np.linspace(400, 700, 13)
    before = indices(lens, at)
    for name in parts(lens, "all.nd"):
        number = int(name.split(".")[0])
        moved = indices(perturbed(lens, name, 3e-4, "x"), at) - before
        # A formula through the glass's own indices meets them to a thousandth of the change.
        assert moved[number] == pytest.approx(3e-4, abs=3e-7)
        assert np.count_nonzero(np.abs(moved).max(axis=1)) == 1


def test_what_a_lens_has_not_is_refused(lens):
    with pytest.raises(UserError, match="no such surface"):
        perturbed(lens, "99.radius", 0.1, "axes.lens.99.radius")
    with pytest.raises(UserError, match="plane"):
        perturbed(lens, f"{lens.stop}.radius", 0.1, "x")
