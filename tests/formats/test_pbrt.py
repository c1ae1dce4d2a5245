"""Lens files of pbrt: front to rear, one index for each glass, the aperture at a radius of 0."""

import numpy as np
import pytest

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.pbrt import parse_pbrt
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order

# A symmetric pair of our own: front converging, stop between, film behind.
PAIR = """# a pair of lenses
# radius thickness index aperture
50.0  # nominal
40.0   3.0   1.6  16.0
-200.0 6.0   1    16.0
0      6.0   0    8.0
200.0\t3.0\t1.6\t16.0
-40.0  30.0  1.0  16.0
"""


@pytest.fixture
def read(tmp_path):
    def reader(*changes):
        text = PAIR
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        return parse_pbrt(text.encode(), tmp_path / "pair.dat")

    return reader


def test_rows_run_from_the_front_to_the_film(tmp_path):
    file = tmp_path / "pair.dat"
    file.write_text(PAIR)
    lens = load_prescription(file)
    assert lens.title == "a pair of lenses"
    assert [s.radius for s in lens.surfaces] == [40.0, -200.0, None, 200.0, -40.0]
    assert [s.thickness for s in lens.surfaces] == [3.0, 6.0, 6.0, 3.0, None]
    assert [s.semi_diameter for s in lens.surfaces] == [8.0, 8.0, None, 8.0, 8.0]
    assert lens.stop == 3
    assert lens.stop_semi_diameter_mm == 4.0
    # The renderer moves the film to the focus, whatever the last thickness says.
    assert lens.focus == "best"
    assert "file: last thickness 30: by the best focus" in lens.import_log.listed("substituted")


def test_the_import_log_says_that_there_is_no_dispersion(read):
    lens = read()
    assert lens.import_log.listed("ignored") == [
        "file: nominal focal length 50: it follows from the rows"
    ]
    substituted = lens.import_log.listed("substituted")
    assert "file: no dispersion stated: none, so the lens has no colour errors" in substituted
    assert "surface 1: glass of index 1.6: the same at every wavelength" in substituted
    assert (5, "radius, thickness, index, aperture diameter", "read") in lens.import_log.rows
    index = build(lens).index(np.array([400.0, 700.0]))
    assert index[1].tolist() == [1.6, 1.6]


def test_the_field_is_the_largest_whose_chief_ray_passes(read):
    lens = read()
    system = build(lens)
    index = system.index(np.array([lens.reference_nm]))
    inside = []
    for angle in (lens.max_field_deg, lens.max_field_deg + 0.02):
        theta = np.radians(angle)
        rays = sample_rays(system, index, theta, np.zeros(1), np.zeros(1))
        inside.append(bool(rays.inside.all()))
    assert inside == [True, False]
    assert "as far as the chief ray passes the apertures" in lens.history[-1]
    narrow = read(("40.0   3.0   1.6  16.0", "40.0   3.0   1.6  9.0"))
    assert narrow.max_field_deg < lens.max_field_deg


def test_a_stop_may_lie_in_glass(read):
    lens = read(
        ("-200.0 6.0   1    16.0\n", ""),
        ("0      6.0   0    8.0", "0      6.0   1.6  8.0"),
        ("200.0\t3.0\t1.6\t16.0\n", ""),
    )
    assert [s.glass for s in lens.surfaces] == ["constant", "constant", None]
    assert lens.surfaces[1].semi_diameter == 4.0
    # A ball-like lens of thickness 9: the plane between changes nothing.
    power = 0.6 * (2 / 40 - 0.6 * 9 / (1.6 * 40**2))
    assert first_order(lens).efl_mm == pytest.approx(1 / power, rel=1e-13)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("0      6.0   0    8.0\n", "", ["no stop", "radius of 0"]),
        ("200.0\t3.0", "0\t3.0", ["several stops", "[3, 4]"]),
        ("0      6.0   0 ", "0      6.0   1.5 ", ["index of row 3", "0, or 1 as before"]),
        ("-200.0 6.0   1 ", "-200.0 6.0   0.5 ", ["index of row 2", "1 (air) or more"]),
        ("40.0   3.0   1.6  16.0", "40.0   3.0   1.6", ["line 4", "40.0   3.0   1.6", "radius"]),
        ("40.0   3.0", "4O.0   3.0", ["line 4", "4O.0"]),
        ("40.0   3.0", "nan   3.0", ["line 4", "nan"]),
        ("40.0   3.0   1.6  16.0", "40.0   3.0   1.6  0", ["aperture of row 1", "> 0 mm"]),
        ("40.0   3.0", "40.0   0", ["surfaces.1.thickness", "greater than 0 (mm)"]),
        ("40.0   3.0", "40.0   -3", ["surfaces.1.thickness", "-3.0", "greater than 0"]),
        ("-40.0  30.0  1.0", "-40.0  30.0  1.5", ["surfaces.5.glass", "no glass behind the last"]),
        ("40.0   3.0   1.6", "40.0   3.0   7.6", ["surfaces.1.nd", "less than 5"]),
    ],
)
def test_a_wrong_row_is_named(read, old, new, words):
    with pytest.raises(UserError) as caught:
        read((old, new))
    for word in [*words, "pair.dat"]:
        assert word in caught.value.screen()
