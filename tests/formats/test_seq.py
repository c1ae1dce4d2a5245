"""CODE V files: what is read, in which unit and mode; what is not modelled is refused by name."""

import numpy as np
import pytest
from formats.written import seq_text

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.seq import parse_seq
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order, with_clear_apertures

SINGLET = """RDM;LEN "VERSION: 10.7"
TITLE 'A singlet ; with "marks" ! and all'  ! a comment; with marks
EPD 10.0
DIM M
WL 650 550 450
REF 2
XAN 0 0
YAN 0 5.0
SO 0 1e13
S 50.0 3.0 NBK7_SCHOTT
  STO
S -50.0 48.0
  PIM
SI 0 -0.25
GO
"""


@pytest.fixture
def read(tmp_path):
    def reader(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        return parse_seq(text.encode("cp1252"), tmp_path / "lens.seq")

    return reader


def test_a_singlet_is_read_as_it_stands(read):
    lens = read(SINGLET)
    assert lens.title == 'A singlet ; with "marks" ! and all'
    assert lens.units == "mm"
    assert lens.entrance_pupil_diameter_mm == 10.0
    assert lens.design_wavelengths_nm == (650.0, 550.0, 450.0)
    assert lens.reference_nm == 550.0
    assert lens.max_field_deg == 5.0
    assert lens.stop == 1
    assert [s.radius for s in lens.surfaces] == [50.0, -50.0]
    assert lens.surfaces[0].glass == "SCHOTT/N-BK7"
    assert lens.focus == "as-given"
    assert lens.surfaces[1].thickness == 47.75  # the defocus of SI is part of the distance
    assert lens.import_log.rows == [
        ("file", "SO 1e+13: object at infinity", "substituted"),
        (1, "S, STO", "read"),
        (2, "S", "read"),
        (2, "PIM", "ignored"),
        ("file", "SI -0.25: defocus, added to the last thickness", "read"),
        ("file", "RDM, EPD, DIM, WL, REF, XAN, YAN", "read"),
        ("file", "LEN, TIT, GO", "ignored"),
    ]
    assert lens.history == (
        "read from a CODE V file; substituted file: SO 1e+13: object at infinity",
    )


def test_the_paraxial_image_is_where_code_v_solved_it(read):
    # An achromat of Edmund Optics, no. 32-327: radii, thicknesses and glasses of its published
    # file, and beside PIM the distance to the paraxial image that CODE V computed.
    achromat = (
        "S 50.0 3.0 NBK7_SCHOTT\n  STO\nS -50.0 48.0\n",
        "S 61.47 6.0 NBK7_SCHOTT\nSTO\nS -44.64 2.5 NSF5_SCHOTT\nS -129.94 95.95194415183156\n",
    )
    lens = read(SINGLET, achromat, ("650 550 450", "587.6"), ("REF 2", "REF 1"), ("-0.25", "0"))
    order = first_order(lens)
    # Its radii were written with rounding in the 16th digit.
    assert order.bfl_mm == pytest.approx(95.95194415183156, rel=1e-13)
    assert lens.surfaces[-1].thickness == 95.95194415183156


def test_load_prescription_knows_the_kind_by_its_ending(tmp_path):
    file = tmp_path / "Lens.SEQ"
    file.write_text(SINGLET)
    assert load_prescription(file).title.startswith("A singlet")


def test_lower_case_continuation_and_other_words_for_the_same(read):
    changes = (
        ("TITLE", "tit"),
        ("S 50.0 3.0 NBK7_SCHOTT\n  STO", "s &\n50.0 & ! the first\n3.0 nbk7_Schott ; STOP"),
        ("YAN 0 5.0", "yan 0 -5.0"),
        ("DIM M", "dim MM"),
        ("RDM;LEN", "rdm y;len"),
    )
    assert read(SINGLET, *changes).surfaces == read(SINGLET).surfaces
    assert read(SINGLET, *changes).max_field_deg == 5.0


def test_commands_may_name_their_surface(read):
    flat = SINGLET.replace("S 50.0 3.0 NBK7_SCHOTT\n  STO", "S 0 0.1").replace(
        "S -50.0 48", "S 0 1"
    )
    later = "THI S2 48.0; STO S1; CUY S2 -0.02\nRDY S1 50; THI S1 3.0; GLA S1 NBK7_SCHOTT\nGO"
    one, two = read(SINGLET), read(flat, ("GO", later))
    assert first_order(two) == first_order(one)


@pytest.mark.parametrize(
    ("code", "nd", "vd"),
    [("517642", 1.517, 64.2), ("517.642", 1.517, 64.2), ("516800.641700", 1.5168, 64.17)],
)
def test_numbers_in_place_of_a_glass_are_a_model_glass(read, code, nd, vd):
    lens = read(SINGLET, ("NBK7_SCHOTT", code))
    surface = lens.surfaces[0]
    assert (surface.glass, surface.nd, surface.vd) == ("model", nd, vd)
    assert f"surface 1: glass {code}" in "".join(lens.import_log.listed("substituted"))


@pytest.mark.parametrize(
    ("name", "glass"),
    [
        ("NSF11_SCHOTT", "SCHOTT/N-SF11"),
        ("N-SF11_SCHOTT", "SCHOTT/N-SF11"),
        ("F2_SCHOTT", "SCHOTT/F2"),
        ("SLAL8_OHARA", "OHARA/S-LAL8"),
        ("HLAK1_CDGM", "CDGM/H-LAK1"),
        ("FCD1_HOYA", "HOYA/FCD1"),
        ("N-BK7", "N-BK7"),
    ],
)
def test_glass_names_find_the_catalogues_spelling(read, name, glass):
    lens = read(SINGLET, ("NBK7_SCHOTT", name))
    assert lens.surfaces[0].glass == glass
    assert first_order(lens).efl_mm > 0  # it is found


def test_a_catalogue_file_beside_the_lens_is_found(read, tmp_path):
    (tmp_path / "house.agf").write_text("NM OWN 5 0 1.6 0\nCD 1.6\nLD 0.3 2.5\n")
    lens = read(SINGLET, ("NBK7_SCHOTT", "OWN_HOUSE"))
    assert build(lens).index(np.array([500.0]))[1, 0] == pytest.approx(1.6, rel=1e-15)
    assert "glass OWN of house.agf" in "".join(lens.import_log.listed("read"))


def test_the_aperture_may_be_an_f_number_or_a_numerical_aperture(read):
    assert read(SINGLET, ("EPD 10.0", "FNO 4")).f_number == 4.0
    lens = read(SINGLET, ("EPD 10.0", "NA 0.125"))
    assert lens.f_number == 4.0
    assert "file: NA 0.125: by the f-number 1/(2 NA)" in lens.import_log.listed("substituted")


@pytest.mark.parametrize(("command", "kind"), [("YIM", "paraxial"), ("YRI", "real")])
def test_image_heights_become_field_angles(read, command, kind):
    inches = ("DIM M", "DIM I"), ("EPD 10.0", "EPD 2.0")
    lens = read(SINGLET, ("XAN 0 0\nYAN 0 5.0", f"{command} 0 -2.0 3.0"), *inches)
    assert lens.entrance_pupil_diameter_mm == pytest.approx(50.8, rel=1e-15)
    if kind == "paraxial":
        height = first_order(lens).efl_mm * np.tan(np.radians(lens.max_field_deg))
    else:
        system = build(lens)
        theta, index = np.radians(lens.max_field_deg), system.index(np.array([550.0]))
        height = sample_rays(system, index, theta, np.zeros(1), np.zeros(1)).chief_y_mm[0]
    # The root is found to 1e-10 deg: 2e-9 mm at this focal length.
    assert height == pytest.approx(3.0 * 25.4, abs=1e-8)
    assert f"{kind} image height 76.2 mm" in "".join(lens.import_log.listed("substituted"))


def test_skew_field_angles_are_angles_from_the_axis(read):
    lens = read(SINGLET, ("XAN 0 0\nYAN 0 5.0", "XAN 0 3.0\nYAN 0 4.0"))
    slope = np.hypot(np.tan(np.radians(3.0)), np.tan(np.radians(4.0)))
    assert lens.max_field_deg == pytest.approx(np.degrees(np.arctan(slope)), rel=1e-14)


def test_apertures_and_the_edge_of_the_glass_are_told_apart(read):
    lens = read(SINGLET, ("  STO", "  STO\n  CIR 6.0; CIR EDG 5.0\n  CIR L'A' 5.5"))
    assert lens.surfaces[0].semi_diameter == 5.5
    assert "surface 1: CIR EDG: the edge of the glass clips no ray" in "".join(
        lens.import_log.listed("ignored")
    )


def test_vignetting_factors_size_the_surfaces_that_have_no_aperture(double_gauss, read):
    system = build(double_gauss)
    distance = float(system.image_z_mm - system.geometry.vertex_z[-1])
    text = seq_text(double_gauss, distance).replace("VUY   0.0 0.0 0.0", "VUY 0 0.2 0.5")
    text = text.replace("VLY 0.0 0.0 0.0", "VLY 0.0 0.1 0.3")
    given = read(text)
    assert [s.semi_diameter for s in given.surfaces] == [
        s.semi_diameter for s in double_gauss.surfaces
    ]
    bare = "\n".join(line for line in text.splitlines() if "CIR" not in line)
    sized = read(bare)
    assert "they pass the beams of the vignetting factors" in sized.history[-1]
    whole = with_clear_apertures(
        double_gauss.model_copy(
            update={
                "surfaces": tuple(
                    s.model_copy(update={"semi_diameter": None}) for s in double_gauss.surfaces
                )
            }
        )
    )
    for small, large in zip(sized.surfaces, whole.surfaces, strict=True):
        assert small.semi_diameter is None or small.semi_diameter < large.semi_diameter * (1 + 1e-9)
    assert sized.surfaces[0].semi_diameter < 0.9 * whole.surfaces[0].semi_diameter
    # The rays at both ends of the vignetted beam pass, at each of the fields.
    built = build(sized)
    index = built.index(np.array([sized.reference_nm]))
    for share, upper, lower in ((0.7, 0.8, -0.9), (1.0, 0.5, -0.7)):
        theta = np.radians(share * sized.max_field_deg)
        ends = built.stop_radius_mm * np.array([upper, lower])
        rays = sample_rays(built, index, theta, np.zeros(2), ends)
        assert (rays.margin[:-1] < 1e-9).all()


def test_a_solved_image_distance_is_the_paraxial_focus(read):
    lens = read(SINGLET, ("S -50.0 48.0", "S -50.0 0.0"), ("SI 0 -0.25", "SI 0 0"))
    assert lens.focus == "paraxial"
    assert lens.surfaces[-1].thickness is None


def test_the_middle_wavelength_is_the_reference_where_none_is_stated(read):
    lens = read(SINGLET, ("REF 2\n", ""))
    assert lens.reference_nm == 550.0
    assert "file: REF not stated: by wavelength 2" in lens.import_log.listed("substituted")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("RDM;LEN", "LEN", ["radii or curvatures", "RDM Y"]),
        ("RDM;LEN", "RDM X;LEN", ["radius mode", "X"]),
        ("DIM M\n", "", ["unit of length", "DIM", "M (mm)"]),
        ("DIM M", "DIM F", ["unit of length", "F"]),
        ("  STO\n", "", ["no stop", "STO"]),
        ("S -50.0 48.0", "S -50.0 48.0; STO", ["several stops", "S2 STO"]),
        ("SO 0 1e13", "SO 0 -1000.0", ["before the lens", "-1000.0"]),
        ("SO 0 1e13", "SO 0.1 1e13", ["curved object or image", "SO"]),
        ("SI 0", "SI 0.1", ["curved object or image", "SI"]),
        ("SI 0 -0.25\n", "", ["not a CODE V lens file", "SI"]),
        ("S -50.0 48.0", "S -50.0 48.0 REFL", ["mirrors", "S2", "REFL"]),
        ("  STO", "  STO; RMD REFL", ["mirrors", "S1 RMD"]),
        ("SI 0 -0.25", "SI 0 -48", ["surfaces.2.thickness", "greater than 0"]),
        ("S -50.0 48.0", "S -50.0", ["value is missing", "S2", "2 numbers"]),
        ("S -50.0", "S -5O.0", ["not a number", "S2", "-5O.0"]),
        ("EPD 10.0\n", "", ["no aperture", "EPD"]),
        ("EPD 10.0", "EPD 10.0; FNO 4", ["two apertures", "EPD, FNO"]),
        ("EPD 10.0", "EPD 0", ["aperture is wrong", "EPD"]),
        ("EPD 10.0", "NA 1.2", ["aperture is wrong", "NA"]),
        ("EPD 10.0", "NAO 0.1", ["object space", "NAO"]),
        ("WL 650 550 450\n", "", ["no wavelength", "WL"]),
        ("REF 2", "REF 4", ["reference wavelength", "1 to 3"]),
        ("XAN 0 0\nYAN 0 5.0\n", "", ["no field", "YAN"]),
        ("YAN 0 5.0", "YIM 0 5.0", ["two types of field", "AN, IM"]),
        ("XAN 0 0\nYAN 0 5.0", "YOB 0 5.0", ["object heights", "YOB"]),
        ("YAN 0 5.0", "YAN 0 125.0", ["max_field_deg"]),
        ("  STO", "  STO; ADE 3.0", ["tilted and decentred", "S1 ADE", "3.0"]),
        ("  STO", "  STO; DAR", ["tilted and decentred", "S1 DAR"]),
        ("  STO", "  STO; SPS ODD", ["special surface", "S1 SPS"]),
        ("  STO", "  STO; CYL", ["special surface", "S1 CYL"]),
        ("  STO", "  STO; DIF DOE", ["diffractive", "S1 DIF"]),
        ("  STO", "  STO; REX 3.0", ["rectangular", "S1 REX"]),
        ("  STO", "  STO; CIR OBS 1.0", ["obscurations", "S1 CIR"]),
        ("  STO", "  STO; CUF 0.1", ["Fresnel", "S1 CUF"]),
        ("  STO", "  STO; A 1e-5", ["no asphere", "S1", "ASP"]),
        ("  STO", "  STO; XYZ 1", ["command XYZ is not understood", "S1 XYZ"]),
        ("  STO", "  STO S9", ["not there", "S9", "S0 to S1"]),
        ("EPD 10.0", "K -1", ["belongs to a surface", "K"]),
        ("EPD 10.0", "PUI 0.5", ["apodisation", "PUI"]),
        ("EPD 10.0", "EPD 10; AFO Y", ["afocal", "AFO"]),
        ("EPD 10.0", "EPD 10; ZOO 3", ["zoom", "ZOO"]),
        ("YAN 0 5.0", "YAN 0 5.0; VUY 0 0.1; XAN 0 1", ["meridional plane"]),
        ("NBK7_SCHOTT", "NBK7_LEITZ", ["unknown glass catalogue", "NBK7_LEITZ", "OHARA"]),
        ("NBK7_SCHOTT", "'E48'", ["private catalogue", "E48"]),
        ("NBK7_SCHOTT", "NBK7_SCHOTT GRIN", ["follow the glass", "GRIN"]),
        ("NBK7_SCHOTT", "NBK7_SCHOTT REFL", ["mirrors"]),
        ("S 50.0 3.0", "S 50.0 0.0", ["surfaces.1.thickness", "greater than 0 (mm)"]),
        ("S 50.0 3.0", "S 50.0 -3.0", ["surfaces.1.thickness", "-3.0", "greater than 0"]),
        (
            "S -50.0 48.0",
            "S -50.0 48.0 NBK7_SCHOTT",
            ["surfaces.2.glass", "no glass behind the"],
        ),
        ("SI 0 -0.25", "SI 0 0\nS 1 1", ["after the image"]),
        ("SO 0 1e13\n", "", ["before the object"]),
        ("SI 0", "SO 0 1e13\nSI 0", ["several object surfaces"]),
    ],
)
def test_what_is_not_modelled_is_refused_by_name(read, old, new, words):
    with pytest.raises(UserError) as caught:
        read(SINGLET, (old, new))
    for word in [*words, "lens.seq"]:
        assert word in caught.value.screen()


def test_what_is_switched_off_or_zero_is_no_obstacle(read):
    changes = ("  STO", "  STO; XDE 0.0; ADE 0; CUF 0.0"), ("EPD 10.0", "EPD 10; AFO N; ZOO 1")
    lens = read(SINGLET, *changes)
    assert lens.surfaces == read(SINGLET).surfaces
    assert "surface 1: XDE, ADE" in lens.import_log.listed("ignored")


def test_a_private_catalogue_is_skipped_and_its_glasses_are_refused(read):
    private = "PRV\n  PWL 700 600&\n 500 400\n  'E48' 1.52 1.53 1.54 1.55\nEND\nSO 0"
    assert read(SINGLET, ("SO 0", private)).surfaces == read(SINGLET).surfaces
    with pytest.raises(UserError, match="private catalogue"):
        read(SINGLET, ("SO 0", private), ("NBK7_SCHOTT", "E48"))


def test_an_unknown_glass_names_its_surface_and_its_file(read):
    with pytest.raises(UserError) as caught:
        first_order(read(SINGLET, ("NBK7_SCHOTT", "NBK77_SCHOTT")))
    for word in ("SCHOTT/NBK77", "surface 1", "lens.seq", "SCHOTT/N-BK7"):
        assert word in caught.value.screen()
