"""Dispersion formulas give published indices; a catalogue file is read, checked and preferred."""

import numpy as np
import pytest
import yaml

from gpusim.errors import UserError
from gpusim.formats.agf import dispersion_of, read_agf
from gpusim.formats.lens_file import load_prescription
from gpusim.lens import dispersion, glass
from gpusim.lens.system import indices

# Coefficients and the (nd, Vd) printed beside them, re-keyed from the makers' catalogues; KRS-5 has
# the index at 10 um of Rodney & Malitson (1956).
PUBLISHED = {
    "N-BK7 (Schott)": (
        2,
        (1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653),
        (1.5168, 64.17),
    ),
    "APL1 (Ohara)": (
        1,
        (2.2762403, -0.0096874647, 0.0092330378, 0.00038940853, -3.8018733e-05, 2.0693225e-06),
        (1.517277, 69.563209),
    ),
    "IRG2 (Schott)": (
        3,
        (1.85362871, 0.0121652879, 6.64999251e-05, -0.00266759682, -1.29306852e-07, -2.88756685e-7),
        (1.891717, 29.896648),
    ),
    "BASF5": (5, (1.57410327, 0.0139786149, 0.00083004511), (1.603233, 42.504788)),
    "5742 (Nikon)": (
        6,
        (1.30326513, 0.00977713845, 0.127313632, 0.0463756328, 0.895143157, 107.962139),
        (1.576531, 42.042478),
    ),
    "BBO, ordinary": (7, (2.7405, 0.0184, 0.0179, 0.0155), (1.670737, 52.593907)),
    "ZnO, ordinary": (8, (2.81418, 0.87968, 0.09253764, 0.00711), (2.003385, 12.424016)),
    "LiYF4, ordinary": (9, (1.38757, 0.70757, 0.00931, 0.18849, 50.99741), (1.453776, 93.549426)),
    "P-SK12S (Hikari)": (
        12,
        (
            2.4767282, -0.0103779856, 0.013934653, 0.000196558619,
            4.37662846e-07, 2.28673729e-07, -9.02510603e-05,
        ),
        (1.585930, 59.652170),
    ),
    "J-SFH1 (Hikari)": (
        13,
        (
            3.11637039, -0.0140103252, 0.0, 0.0455295459, 0.00379129507,
            -0.000576203793, 0.000153793977, -1.65780029e-05, 8.814805e-07,
        ),
        (1.808090, 22.738831),
    ),
}  # fmt: skip
LINES = np.array([dispersion.D_LINE_NM, dispersion.F_LINE_NM, dispersion.C_LINE_NM])


@pytest.mark.parametrize("name", PUBLISHED)
def test_each_formula_gives_the_published_index_and_dispersion(name):
    formula, coefficients, (nd, vd) = PUBLISHED[name]
    d, f, c = dispersion.formula_index(formula, coefficients, LINES)
    digits = len(str(nd).rstrip("0").split(".")[1])
    assert abs(d - nd) <= 0.5 * 10 ** -max(digits, 5) + 1e-9
    assert abs((d - 1) / (f - c) - vd) < (0.005 if name.startswith("N-BK7") else 2e-6)
    # A slip in the last digit but three of the strongest coefficient is seen.
    spoilt = (coefficients[0] * 1.001, *coefficients[1:])
    assert abs(dispersion.formula_index(formula, spoilt, LINES)[0] - nd) > 1e-5


def test_krs5_has_its_published_index_at_ten_micrometres():
    terms = (1.8293958, 0.0225, 1.6675593, 0.0625, 1.1210424)
    terms = (*terms, 0.1225, 0.04513366, 0.2025, 12.380234, 27089.8681)
    # Rodney & Malitson (1956), table: 2.37069 at 10 um, to five digits.
    assert dispersion.formula_index(11, terms, 10e3) == pytest.approx(2.37069, abs=1e-5)


def test_formulas_without_a_published_glass_are_those_that_contain_them():
    # Extended adds two terms to Schott's.
    schott = PUBLISHED["APL1 (Ohara)"][1]
    w = LINES / 1e3
    both = dispersion.formula_index(1, schott, LINES) ** 2 + 3e-8 / w**10 - 5e-9 / w**12
    extended = dispersion.formula_index(10, (*schott, 3e-8, -5e-9), LINES)
    np.testing.assert_allclose(extended, np.sqrt(both), rtol=1e-15)
    # Sellmeier 2 gives its resonances as wavelengths; B w^2/(w^2 - L^2) is the first term, and
    # B/(w^2 - L^2) = (B/L^2) (w^2/(w^2 - L^2) - 1) turns the second into Sellmeier 4.
    a, b1, l1, b2, l2 = 0.2, 1.1, 0.1, -0.7, 9.0
    four = (1 + a - b2 / l2**2, b1, l1**2, b2 / l2**2, l2**2)
    np.testing.assert_allclose(
        dispersion.formula_index(4, (a, b1, l1, b2, l2), LINES),
        dispersion.formula_index(9, four, LINES),
        rtol=1e-14,
    )


AGF = """CC our own
NM LENS-A 2 517642 1.5168 64.17 0 0
GC a comment with words
ED 7.1 8.3 2.51 -0.0009 0
CD 1.03961212E+00 6.00069867E-03 2.31792344E-01 2.00179144E-02 1.01046945E+00 1.03560653E+02 0 0
LD 3.1E-01 2.5E+00
IT 3.1E-01 0.4 25
NM F2 3 0 1.891717 29.896648 0 0
CD 1.85362871 0.0121652879 6.64999251e-05 -0.00266759682 -1.29306852e-07 -2.88756685e-7
LD 0.44 4.6
"""


def lens_file(folder, catalogues, name):
    data = {
        "title": "t",
        "patent": None,
        "source": "s",
        "units": "mm",
        "f_number": 5.0,
        "max_field_deg": 5.0,
        "focus": "paraxial",
        "stop": 1,
        "glass_catalogues": catalogues,
        "surfaces": [{"radius": 50.0, "thickness": 3.0, "glass": name}, {"radius": -50.0}],
    }
    file = folder / "lens.yaml"
    file.write_text(yaml.safe_dump(data))
    return file


@pytest.mark.parametrize("codec", ["cp1252", "utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_a_glass_of_a_file_beside_the_lens_is_that_of_the_offline_catalogue(tmp_path, codec):
    (tmp_path / "mine.agf").write_bytes(AGF.encode(codec))
    lens = load_prescription(lens_file(tmp_path, ["mine.agf"], "lens-a"))
    wavelengths = np.array([400.0, 550.0, 1000.0])
    # The maker's coefficients are the same in both; rounding of a few operations.
    np.testing.assert_allclose(
        indices(lens, wavelengths)[1],
        glass.catalogue_index("SCHOTT", "N-BK7", wavelengths, surface=1, file=None),
        rtol=1e-14,
    )
    assert "surface 1: glass LENS-A of mine.agf: formula 2, Sellmeier 1" in lens.import_log.listed(
        "read"
    )
    # What was derived from the lens needs the file no more.
    (tmp_path / "mine.agf").unlink()
    assert indices(lens.resized(2.0), wavelengths).shape == (3, 3)


@pytest.mark.parametrize(
    ("catalogues", "name", "formula"),
    [
        (["mine.agf", "SCHOTT"], "F2", 3),
        (["SCHOTT", "mine.agf"], "F2", None),
        (["SCHOTT", "mine.agf"], "MINE/F2", 3),
        (["mine.agf", "SCHOTT"], "SCHOTT/F2", None),
        (["mine.agf", "SCHOTT"], "N-BK7", None),
    ],
)
def test_order_of_catalogues_and_explicit_catalogue_decide(tmp_path, catalogues, name, formula):
    (tmp_path / "mine.agf").write_text(AGF)
    surface = load_prescription(lens_file(tmp_path, catalogues, name)).surfaces[0]
    assert (surface.dispersion and surface.dispersion.formula) == formula


def test_wavelengths_outside_the_range_of_the_file_are_refused(tmp_path):
    (tmp_path / "mine.agf").write_text(AGF)
    lens = load_prescription(lens_file(tmp_path, ["mine.agf"], "LENS-A"))
    with pytest.raises(UserError) as caught:
        indices(lens, np.array([300.0]))
    for word in ("lens.yaml", "LENS-A", "surface 1", "300 nm", "310 to 2500 nm"):
        assert word in caught.value.screen()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("NM LENS-A", "NM LENS-B", ["'LENS-A'", "surface 1", "MINE/LENS-B"]),
        ("LENS-A 2 ", "LENS-A 14 ", ["formula of glass LENS-A", "14", "13 Extended 3"]),
        ("LENS-A 2 ", "LENS-A 1 ", ["do not give the nd", "1.516800"]),
        ("2.31792344E-01", "2.32792344E-01", ["do not give the nd", "coefficients missing"]),
        ("CD 1.0", "XX 1.0", ["incomplete", "LENS-A CD", "at least 1 number"]),
        ("LD 3.1E-01 2.5E+00", "LD 3.1E-01", ["incomplete", "LENS-A LD", "2 numbers"]),
        ("LD 3.1E-01 2.5E+00", "LD 2.5 0.3", ["LENS-A LD", "the shorter first"]),
        ("1.03961212E+00", "__import__('os')", ["incomplete", "LENS-A CD"]),
    ],
)
def test_a_wrong_catalogue_is_named_with_glass_and_line(tmp_path, old, new, words):
    assert old in AGF
    (tmp_path / "mine.agf").write_text(AGF.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        load_prescription(lens_file(tmp_path, ["mine.agf"], "LENS-A"))
    for word in words:
        assert word in caught.value.screen()


@pytest.mark.parametrize(
    ("content", "words"),
    [(None, ["cannot be read"]), (b"", ["not a glass catalogue"]), (b"\x89PNG", ["mine.agf"])],
)
def test_what_is_no_catalogue_is_refused(tmp_path, content, words):
    if content is not None:
        (tmp_path / "mine.agf").write_bytes(content)
    with pytest.raises(UserError) as caught:
        load_prescription(lens_file(tmp_path, ["mine.agf"], "LENS-A"))
    for word in words:
        assert word in caught.value.screen()


def test_an_unknown_catalogue_is_refused_at_once(tmp_path):
    with pytest.raises(UserError) as caught:
        load_prescription(lens_file(tmp_path, ["LEITZ"], "F2"))
    for word in ("no such glass catalogue", "LEITZ", "SCHOTT", ".agf"):
        assert word in caught.value.screen()


def test_a_dispersion_may_stand_in_the_lens_and_must_name_its_glass(tmp_path):
    file = lens_file(tmp_path, [], "own")
    data = yaml.safe_load(file.read_text())
    law = {"formula": 5, "coefficients": [1.5, 0.01, 0.0], "range_um": [0.4, 0.7]}
    data["surfaces"][0]["dispersion"] = law
    file.write_text(yaml.safe_dump(data))
    found = indices(load_prescription(file), np.array([500.0]))[1]
    assert found == pytest.approx(1.52, rel=1e-15)
    law["coefficients"] = [0.5]
    file.write_text(yaml.safe_dump(data))
    with pytest.raises(UserError, match="dispersion formula of glass own of surface 1 fails"):
        indices(load_prescription(file), np.array([500.0]))
    for change, words in (
        ({"glass": "model", "nd": 1.5, "vd": 60.0}, "a dispersion is of no glass"),
        ({"dispersion": law | {"formula": 0}}, "13 Extended 3"),
    ):
        wrong = data | {"surfaces": [data["surfaces"][0] | change, data["surfaces"][1]]}
        file.write_text(yaml.safe_dump(wrong))
        with pytest.raises(UserError, match=words):
            load_prescription(file)


def test_of_a_name_that_comes_twice_the_first_counts(tmp_path):
    path = tmp_path / "two.agf"
    path.write_text(AGF + AGF.replace("LD 3.1E-01", "LD 5.0E-01"))
    glasses = read_agf(path)
    assert dispersion_of("LENS-A", glasses["LENS-A"], path).range_um == (0.31, 2.5)
