"""Glasses of which nd and Vd alone are known: the nearest of a catalogue, and what is left open."""

import re

import numpy as np
import pytest
import yaml
from lens.made import lens

from gpusim.formats.lens_file import load_prescription
from gpusim.lens import model_glass
from gpusim.lens.dispersion import C_LINE_NM, D_LINE_NM, F_LINE_NM, model_index
from gpusim.lens.model_glass import colour, known, nearest, state_model_glasses, with_nearest
from gpusim.lens.system import indices
from gpusim.psf.sampling import WAVELENGTHS_NM

LINES = np.array([D_LINE_NM, F_LINE_NM, C_LINE_NM])


def singlet(glass, **fields):
    """Return a thin lens of f = 100 mm at nd 1.5 with a stop 10 mm behind it."""
    rows = [
        {"radius": 100.0, "thickness": 1e-6, "semi_diameter": 20.0, **glass},
        {"radius": -100.0, "thickness": 10.0, "semi_diameter": 20.0},
        {"radius": np.inf},
    ]
    return lens(rows, stop=3, **fields)


def as_models(prescription):
    """Return a lens as a file has it that names no glasses: nd and Vd to the printed digits."""
    index = indices(prescription, LINES)
    surfaces = list(prescription.surfaces)
    for i, (d, f, c) in enumerate(index[1:]):
        if surfaces[i].glass:
            changes = {"glass": "model", "nd": round(d, 5), "vd": round((d - 1) / (f - c), 2)}
            surfaces[i] = surfaces[i].model_copy(update=changes)
    return prescription.model_copy(update={"surfaces": tuple(surfaces)})


def test_the_nearest_glass_is_the_one_whose_digits_were_printed():
    one = singlet({"glass": "model", "nd": 1.517, "vd": 64.2}, glass_catalogues=["SCHOTT"])
    # The code 517642 stands for N-BK7 (1.51680, 64.17).
    found = nearest(1.517, 64.2, one)
    assert found.name in ("SCHOTT/N-BK7", "SCHOTT/N-BK7HT", "SCHOTT/BK7G18")
    assert (found.nd, found.vd) == pytest.approx((1.51680, 64.17), abs=0.01)
    # By brute force over all makers, where the lens names none: nothing is nearer.
    anywhere = singlet({"glass": "model", "nd": 1.621, "vd": 36.2})
    found = nearest(1.621, 36.2, anywhere)
    distance = np.hypot(found.nd - 1.621, 0.01 * (found.vd - 36.2))
    books = ("SCHOTT", "OHARA", "HOYA", "SUMITA", "CDGM", "LZOS", "HIKARI")
    others = [
        np.hypot(g.nd - 1.621, 0.01 * (g.vd - 36.2))
        for book in books
        for g in known(book)
        if g.low_nm <= 400 and g.high_nm >= 700
    ]
    assert distance == min(others)


def test_a_plastic_has_no_glass_near_it_and_stays():
    one = singlet({"glass": "model", "nd": 1.651, "vd": 21.5})
    assert nearest(1.651, 21.5, one) is None
    swapped = with_nearest(one)
    assert swapped.surfaces[0].glass == "model"
    assert "surface 1 none (nd 1.651, Vd 21.5)" in swapped.history[-1]


def test_a_glass_without_data_at_the_lens_wavelengths_is_not_taken():
    # nd and Vd of Hoya's E-FDS2, whose data end at 1014 nm as those of all glasses of Hoya.
    for books, reference, found_there in (
        (["HOYA"], 550.0, True),
        (["HOYA"], 1500.0, False),
        (["HOYA", "SCHOTT"], 550.0, True),
    ):
        one = singlet(
            {"glass": "model", "nd": 2.00272, "vd": 19.32},
            design_wavelengths_nm=[reference],
            reference_nm=reference,
            glass_catalogues=books,
        )
        found = nearest(2.00272, 19.32, one)
        assert (found is not None) == found_there
        assert found is None or found.name.endswith("FDS2")


def test_colour_of_a_thin_lens_is_that_of_the_closed_form():
    one = singlet({"glass": "model", "nd": 1.5, "vd": 60.0}, reference_nm=D_LINE_NM)
    found = colour(one, LINES)
    # f = R / (2 (n - 1)), to what 1e-6 mm of glass add.
    f_mm = 100 / (2 * (model_index(1.5, 60.0, LINES) - 1))
    np.testing.assert_allclose(found.longitudinal, 1e3 * (f_mm - f_mm[0]), atol=1e-2)
    # The ray through the middle of the stop, d = 10 mm behind the lens, leaves the lens at the
    # slope tan(theta) / (1 - d / f) and goes f(d line) - d farther. Aberrations of
    # third order change it by some times tan^2(5 deg) = 0.8 %.
    slope = np.tan(np.radians(one.max_field_deg)) / (1 - 10 / f_mm)
    expected_um = 1e3 * (f_mm[0] - 10) * (slope - slope[0])
    assert np.abs(expected_um).max() > 5
    np.testing.assert_allclose(found.lateral, expected_um, rtol=0.03, atol=1e-6)


def test_the_import_log_states_what_the_choice_of_glasses_changes():
    one = as_models(load_prescription("telephoto"))
    one._import_log = type(one.import_log)()
    state_model_glasses(one)
    between, spread = one.import_log.listed("substituted")
    # The same two lenses by hand: on the model, and with the catalogue's glasses.
    wavelengths = model_glass.wavelengths_of(one)
    assert (wavelengths[0], wavelengths[-1]) == (WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1])
    placed = model_glass.in_one_plane(one)
    swapped = with_nearest(placed)
    assert not model_glass.model_surfaces(swapped)
    model, catalogue = colour(placed, wavelengths), colour(swapped, wavelengths)
    found = [float(word) for word in re.findall(r"([\d.e+]+) um", between)]
    expected = []
    for a, b in zip(model, catalogue, strict=True):
        expected += [np.ptp(a), np.ptp(b), np.abs(a - b).max()]
    assert found == pytest.approx(expected, rel=0.06)  # of two and three printed digits
    assert min(found) > 1  # not nothing
    # The spread changes it by as much as the choice does, and not by many times: 0.1 to 10.
    lateral = float(re.search(r"\+-([\d.e+]+) um of lateral", spread)[1])
    assert 0.1 < lateral / expected[2] < 10


def test_the_catalogue_glasses_of_a_lens_are_found_again():
    original = load_prescription("telephoto")
    swapped = with_nearest(as_models(original))
    # Printed digits put the glass itself at hypot(5e-6, 0.005 / 100) = 5e-5 at most; the nearest is
    # nearer, or it is another with the same nd and Vd.
    found, known_ = (indices(one, LINES) for one in (swapped, original))
    np.testing.assert_allclose(found[:, 0], known_[:, 0], rtol=0, atol=6e-5)
    # d(nF - nC) = (nF - nC) dVd / Vd = 0.035 x 0.01 / 23 at most.
    span = (found - known_)[:, 1] - (found - known_)[:, 2]
    np.testing.assert_allclose(span, 0, atol=2e-5)


def test_a_lens_without_model_glasses_has_nothing_to_state():
    one = load_prescription("double-gauss")
    rows = list(one.import_log.rows)
    state_model_glasses(one)
    assert one.import_log.rows == rows
    assert with_nearest(one) is one


def test_what_cannot_be_traced_is_said():
    one = singlet(
        {"glass": "model", "nd": 1.5, "vd": 60.0}, design_wavelengths_nm=[300.0], reference_nm=550.0
    )
    state_model_glasses(one)
    (said,) = one.import_log.listed("substituted")
    assert "cannot be traced" in said
    assert "outside the data" in said


def test_a_lens_file_may_ask_for_the_nearest_glasses(tmp_path):
    data = {
        "title": "a singlet",
        "patent": None,
        "source": "made up",
        "units": "mm",
        "nearest_glasses": True,
        "f_number": 5.0,
        "max_field_deg": 5.0,
        "focus": "best",
        "stop": 1,
        "surfaces": [
            {"radius": 50.0, "thickness": 3.0, "glass": "model", "nd": 1.517, "vd": 64.2},
            {"radius": -50.0},
        ],
    }
    file = tmp_path / "lens.yaml"
    file.write_text(yaml.safe_dump(data))
    found = load_prescription(file)
    assert found.surfaces[0].glass.partition("/")[2]
    assert (found.surfaces[0].nd, found.surfaces[0].vd) == (1.517, 64.2)  # as printed
    said = " ".join(found.import_log.listed("substituted"))
    assert "lateral colour" in said
    assert "by the nearest of the catalogues: surface 1" in said
    data["nearest_glasses"] = False
    file.write_text(yaml.safe_dump(data))
    assert load_prescription(file).surfaces[0].glass == "model"
