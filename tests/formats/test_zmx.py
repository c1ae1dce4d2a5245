"""A .zmx file of our own writing gives the same lens; what is not modelled is refused by name."""

import re

import numpy as np
import pytest
from formats.written import zmx_text
from lens.made import lens, model

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.formats.zmx import parse_zmx
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build, first_order, with_clear_apertures
from gpusim.psf.compute import compute_bank

CODECS = {"ANSI": "cp1252", "UTF-16": "utf-16", "UTF-16 without mark": "utf-16-le"}


@pytest.fixture(scope="module")
def written(double_gauss):
    small = double_gauss.scaled(8.3).stopped(2.8)
    system = build(small)
    return small, zmx_text(small, float(system.image_z_mm - system.geometry.vertex_z[-1]))


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS.keys())
def test_the_same_lens_from_zmx_gives_the_same_bank(tmp_path, written, codec):
    original, text = written
    file = tmp_path / "double-gauss.ZMX"
    file.write_bytes(text.encode(codec))
    read = load_prescription(file)
    settings = {"wavelengths_nm": [450.0, 550.0, 650.0], "field_deg": [0.0, 8.0, 14.0], "size": 64}
    one, two = (compute_bank(p, **settings) for p in (original, read))
    # Curvature is written in place of radius: one rounding, 1e-16, some 1e3 times in the OPD.
    np.testing.assert_allclose(two.psf, one.psf, rtol=0, atol=1e-7 * one.psf.max())
    np.testing.assert_allclose(two.real_height_um, one.real_height_um, rtol=1e-11)
    np.testing.assert_allclose(two.relative_illumination, one.relative_illumination, rtol=1e-9)
    np.testing.assert_allclose(two.transmission, one.transmission, rtol=1e-14)
    assert "read from a Zemax file" in two.provenance["history"]


def test_the_import_log_says_what_was_read_ignored_and_substituted(tmp_path, written):
    original, text = written
    prescription = parse_zmx(text.encode("cp1252"), tmp_path / "a.zmx")
    assert prescription.title == original.title
    assert prescription.glass_catalogues == original.glass_catalogues
    assert prescription.max_field_deg == original.max_field_deg
    assert prescription.design_wavelengths_nm == pytest.approx(original.design_wavelengths_nm)
    assert prescription.surfaces[5].semi_diameter is None  # the aperture sets the stop
    import_log = prescription.import_log
    assert (1, "TYPE, CURV, DISZ, GLAS, DIAM", "read") in import_log.rows
    assert (6, "STOP, TYPE, CURV, DISZ", "read") in import_log.rows
    assert (6, "DIAM: the system aperture sets the stop", "ignored") in import_log.rows
    for entry in (
        "file: COFN",
        "surface 1: HIDE",
        "file: TOL",
        "file: EFLY",
        "file: GCAT MISC: no such catalogue offline",
    ):
        assert entry in import_log.listed("ignored")
    assert import_log.listed("substituted") == ["file: RAIM: every ray is aimed at the real stop"]


def test_a_gaussian_apodisation_is_read(tmp_path, written):
    _, text = written
    found = parse_zmx(text.replace("GFAC 0 0", "GFAC 1 0.7").encode("cp1252"), tmp_path / "a.zmx")
    assert found.gaussian_apodisation == 0.7
    said = [one for one in found.import_log.listed("substituted") if "GFAC" in one]
    assert len(said) == 1
    assert "factor 0.7" in said[0]
    # Uniform whatever the factor, and Gaussian of none.
    for even in ("GFAC 0 1.0", "GFAC 1 0"):
        content = text.replace("GFAC 0 0", even).encode("cp1252")
        found = parse_zmx(content, tmp_path / "a.zmx")
        assert found.gaussian_apodisation == 0
        assert not any("GFAC" in one for one in found.import_log.listed("substituted"))


def test_even_aspheres_conics_and_model_glasses_are_read(tmp_path):
    rows = [
        {
            "curvature": 0.04,
            "conic": -0.6,
            "asphere": {"a2": 1e-4, "a4": -2e-6, "a16": 3e-20},
            "thickness": 3.0,
            "semi_diameter": 6.0,
            **model(1.52),
        },
        {"curvature": -0.01, "semi_diameter": 6.0},
    ]
    original = lens(rows)
    text = zmx_text(original, 30.0)
    read = parse_zmx(text.encode("cp1252"), tmp_path / "a.zmx")
    assert read.surfaces[0].asphere == original.surfaces[0].asphere
    assert read.surfaces[0].conic == -0.6
    assert first_order(read) == first_order(original)
    assert read.surfaces[1].thickness == 30.0
    assert any("model glass nd 1.52" in text for text in read.import_log.listed("substituted"))


def test_the_partial_dispersion_of_a_model_glass_is_read(tmp_path):
    rows = [{"radius": 20.0, "thickness": 3.0, **model(1.52)}, {"radius": -20.0}]
    text = zmx_text(lens(rows), 18.0)
    for number, dpgf in (("0.0125", 0.0125), ("-3.0E-3", -0.003), ("0", None)):
        changed = text.replace("149.0 0 0", f"149.0 {number} 0", 1)
        read = parse_zmx(changed.encode("cp1252"), tmp_path / "a.zmx")
        assert read.surfaces[0].dpgf == dpgf
        (said,) = [one for one in read.import_log.listed("substituted") if "GLAS" in one]
        assert ("off the normal line" in said) == (dpgf is not None)
        assert (read.surfaces[0].nd, read.surfaces[0].vd) == (1.52, 149.0)


def old_zmx(written, *changes):
    """Return the file as programs of about 2003 write it: a line of wavelengths, XFLD and YFLD."""
    text = re.sub(r"WAVM .*\r\n", "", text_of(written).decode())
    text = re.sub(r"FTYP .*\r\n", "FTYP 0 0\r\n", text)
    for key, old in (("XFLN", "XFLD"), ("YFLN", "YFLD"), ("VDYN", "ZVDY"), ("VCYN", "ZVCY")):
        text = text.replace(key, old)
    for before, after in (
        ("PWAV 2", "WAVL 4.861327E-001 5.875618E-001 6.562725E-001\r\nWWGT 1 2 1\r\nPWAV 2"),
        *changes,
    ):
        assert before in text
        text = text.replace(before, after, 1)
    return text.encode("cp1252")


def test_the_line_of_wavelengths_of_old_files_is_read(tmp_path, written):
    new = parse_zmx(text_of(written), tmp_path / "new.zmx")
    old = parse_zmx(old_zmx(written), tmp_path / "old.zmx")
    assert old.design_wavelengths_nm == pytest.approx([486.1327, 587.5618, 656.2725], rel=1e-12)
    assert old.reference_nm == pytest.approx(587.5618, rel=1e-12)
    assert old.max_field_deg == new.max_field_deg
    assert old.surfaces == new.surfaces
    assert ("file", "WAVL", "read") in old.import_log.rows
    weights = [row for row in old.import_log.rows if "WWGT" in row.what]
    assert [row.how for row in weights] == ["ignored"]
    # The primary, and how many count where the file says it.
    other = parse_zmx(old_zmx(written, ("PWAV 2", "PWAV 3")), tmp_path / "old.zmx")
    assert other.reference_nm == pytest.approx(656.2725, rel=1e-12)
    two = parse_zmx(old_zmx(written, ("FTYP 0 0", "FTYP 0 0 3 2")), tmp_path / "old.zmx")
    assert len(two.design_wavelengths_nm) == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("5.875618E-001", "yellow"), ["not a number", "WAVL", "yellow"]),
        (("PWAV 2", "PWAV 4"), ["primary wavelength", "1 to 3"]),
        (
            ("WAVL 4.861327E-001 5.875618E-001 6.562725E-001", "WAVL"),
            ["no wavelength", "WAVL um um"],
        ),
    ],
)
def test_a_wrong_line_of_wavelengths_is_refused(tmp_path, written, change, words):
    with pytest.raises(UserError) as caught:
        parse_zmx(old_zmx(written, change), tmp_path / "old.zmx")
    for word in words:
        assert word in caught.value.screen()


def test_vignetting_factors_of_old_files_are_read(tmp_path, written):
    old = parse_zmx(old_zmx(written, ("ZVCY 0 0 0", "ZVCY 0 0.1 0.3")), tmp_path / "old.zmx")
    assert any("vignetting factors" in text for text in old.import_log.listed("substituted"))


@pytest.mark.parametrize(
    ("line", "name", "value"),
    [("FNUM", "f_number", 2.8), ("ENPD 4.1", "entrance_pupil_diameter_mm", 4.1),
     ("FLOA", "stop_semi_diameter_mm", 1.0)],
)  # fmt: skip
def test_every_kind_of_aperture_is_read(tmp_path, written, line, name, value):
    text = written[1]
    if line != "FNUM":
        text = text.replace("FNUM 2.8 0", line)
    read = parse_zmx(text.encode("cp1252"), tmp_path / "a.zmx")
    assert getattr(read, name) == value


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("MODE SEQ", "MODE NSC", ["sequential", "MODE", "NSC"]),
        ("UNIT MM", "UNIT IN", ["UNIT", "IN", "MM"]),
        ("DISZ INFINITY", "DISZ -1000", ["before the lens", "-1000", "INFINITY"]),
        ("  STOP\r\n", "", ["no stop", "STOP"]),
        ("SURF 3\r\n", "SURF 3\r\n  STOP\r\n", ["several stops", "[3, 6]"]),
        ("FNUM 2.8 0", "OBNA 0.2 0", ["OBNA", "numerical aperture"]),
        ("FNUM 2.8 0\r\n", "", ["no aperture"]),
        ("FNUM 2.8 0", "FNUM 0 0", ["f_number", "greater than 0"]),
        ("FNUM 2.8 0", "FNUM two 0", ["FNUM", "two", "number"]),
        ("FTYP 0 0", "FTYP 1 0", ["FTYP", "object height", "2 paraxial image height"]),
        ("FTYP 0 0 3", "FTYP 0 0 0", ["no field", "YFLN"]),
        ("SURF 4\r\n", "SURF 5\r\n", ["not numbered in order", "SURF 4"]),
        ("FTYP 0 0", "FTYP 0 1", ["telecentric"]),
        ("GFAC 0 0", "GFAC 2 1", ["apodisation", "GFAC", "2 1", "1 (Gaussian)"]),
        ("GFAC 0 0", "GFAC 1 -0.5", ["apodisation", "-0.5", "0 to 100"]),
        ("GFAC 0 0", "GFAC 1 half", ["GFAC", "half", "number"]),
        ("ENVD 2.0E+1 1 0", "ENVD 4.0E+1 1 1", ["environment"]),
        (
            "SURF 2\r\n  TYPE STANDARD",
            "SURF 2\r\n  TYPE COORDBRK",
            ["coordinate breaks", "SURF 2 TYPE"],
        ),
        ("SURF 2\r\n  TYPE STANDARD", "SURF 2\r\n  TYPE TOROIDAL", ["TOROIDAL", "XASPHERE"]),
        ("SURF 2\r\n  TYPE STANDARD", "SURF 2\r\n  TYPE XASPHERE", ["incomplete", "SURF 2 XDAT"]),
        ("SURF 2\r\n  TYPE STANDARD", "SURF 2\r\n  TYPE", ["surface type none"]),
        ("GLAS F5", "GLAS MIRROR", ["mirrors", "SURF 7 GLAS"]),
        ("  HIDE 0 0", "  SCBD 0 0", ["tilted or decentred", "SURF 1 SCBD"]),
        ("  HIDE 0 0", "  NEWK 0 0", ["NEWK is not understood", "SURF 1 NEWK"]),
        ("  HIDE 0 0", "  SQAP 1 2", ["rectangular aperture", "SURF 1 SQAP"]),
        ("SURF 2\r\n", "SURF 2\r\n  XDAT 3 0.1\r\n", ["SURF 2 XDAT 3", "XASPHERE"]),
        ("  GLAS F5 0 0 1.5 40.0 0 0 0 0 0 0", "  GLAS", ["a glass has no name", "SURF 7 GLAS"]),
        ("DISZ INFINITY", "DISZ 0", ["before the lens", "SURF 0 DISZ"]),
        ("SURF 2\r\n", "SURF 2\r\n  PARM 3 0.1\r\n", ["SURF 2 PARM 3", "EVENASPH"]),
        ("SURF 2\r\n", "SURF 2\r\n  CLAP 0.1 1.0\r\n", ["obscuration", "SURF 2 CLAP"]),
        ("WAVM 1 0.4861327 1", "WAVM 1 blue 1", ["WAVM", "blue"]),
        ("PWAV 2", "PWAV 7", ["PWAV", "7", "1 to 3"]),
        ("GCAT SCHOTT CDGM MISC", "GCAT LIGHTPATH", ["none of the file's glass catalogues"]),
    ],
)
def test_what_is_not_modelled_is_refused_by_name(tmp_path, written, old, new, words):
    assert old in written[1]
    text = written[1].replace(old, new, 1)
    with pytest.raises(UserError) as caught:
        parse_zmx(text.encode("cp1252"), tmp_path / "wrong.zmx")
    for word in [*words, "wrong.zmx"]:
        assert word in caught.value.screen()


def test_an_unknown_glass_names_its_surface_and_its_file(tmp_path, written):
    file = tmp_path / "odd-glass.zmx"
    file.write_text(written[1].replace("GLAS F5", "GLAS F5X"))
    with pytest.raises(UserError) as caught:
        first_order(load_prescription(file))
    for word in ("'F5X'", "surface 7", "odd-glass.zmx", "SCHOTT/F5"):
        assert word in caught.value.screen()


def text_of(written, *changes):
    text = written[1]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text.encode("cp1252")


def test_an_extended_asphere_has_normalised_coefficients(tmp_path, written):
    data = ["XDAT 1 3 0 0", "XDAT 2 2.5 0 0", "XDAT 3 0 0 0", "XDAT 4 0.01 0", "XDAT 5 -0.002"]
    # A fourth coefficient beyond the stated three counts for nothing.
    block = "  TYPE XASPHERE\r\n  " + "\r\n  ".join([*data, "XDAT 6 7.0"])
    change = ("SURF 3\r\n  TYPE STANDARD", f"SURF 3\r\n{block}")
    read = parse_zmx(text_of(written, change), tmp_path / "a.zmx")
    asphere = read.surfaces[2].asphere
    # Sag at the normalisation radius is the sum of the coefficients.
    assert sum(a * 2.5 ** (2 * i) for i, a in enumerate(asphere.coefficients, start=1)) == (
        pytest.approx(0.008, rel=1e-14)
    )
    assert asphere.a4 == pytest.approx(0.01 / 2.5**4, rel=1e-15)
    assert asphere.a8 == 0
    sixteen = change[1].replace("XDAT 1 3", "XDAT 1 16").replace("XDAT 6 7.0", "XDAT 18 7.0")
    with pytest.raises(UserError, match="SURF 3 XDAT 18"):
        parse_zmx(text_of(written, (change[0], sixteen)), tmp_path / "a.zmx")


def test_image_heights_become_field_angles(tmp_path, written):
    original = written[0]
    edge = original.max_field_deg
    paraxial = first_order(original).efl_mm * np.tan(np.radians(edge))
    system = build(original)
    index = system.index(np.array([original.reference_nm]))
    real = float(
        sample_rays(system, index, np.radians(edge), np.zeros(1), np.zeros(1)).chief_y_mm[0]
    )
    assert abs(paraxial - real) > 1e-3 * real  # the lens distorts, so that the two are told apart
    for kind, name, height in ((2, "paraxial", paraxial), (3, "real", real)):
        heights = ("YFLN 0 ", f"YFLN 0 {-float(height)!r} 1 1 1 1 1 1 ")
        read = parse_zmx(text_of(written, ("FTYP 0", f"FTYP {kind}"), heights), tmp_path / "a.zmx")
        # The root is found to 1e-10 deg; the height is that of a real chief ray.
        assert read.max_field_deg == pytest.approx(edge, abs=1e-8)
        assert f"file: {name} image height {height:g} mm by the field angle" in "".join(
            read.import_log.listed("substituted")
        )
        assert "by the field angle" in read.history[-1]


def test_an_image_height_that_no_field_reaches_is_refused(tmp_path, written):
    change = ("FTYP 0", "FTYP 3"), ("YFLN 0 ", "YFLN 900 ")
    with pytest.raises(UserError) as caught:
        parse_zmx(text_of(written, *change), tmp_path / "a.zmx")
    assert caught.value.field in ("fields", "max_field_deg")


def test_vignetting_factors_are_left_to_the_clear_apertures(tmp_path, written):
    changes = ("VDYN 0 0 0", "VDYN 0 0.05 -0.1"), ("VCYN 0 0 0", "VCYN 0 0.1 0.4")
    plain = parse_zmx(text_of(written), tmp_path / "a.zmx")
    read = parse_zmx(text_of(written, *changes), tmp_path / "a.zmx")
    assert read.surfaces == plain.surfaces
    assert "vignetting factors by the clear apertures" in "".join(
        read.import_log.listed("substituted")
    )
    assert "vignetting" not in "".join(plain.import_log.listed("substituted"))


def test_vignetting_factors_size_the_surfaces_that_have_no_aperture(tmp_path, written):
    text = text_of(written, ("VCYN 0 0 0", "VCYN 0 0.2 0.5"), ("VDYN 0 0 0", "VDYN 0 0.1 -0.2"))
    bare = b"\r\n".join(line for line in text.split(b"\r\n") if not line.startswith(b"  DIAM"))
    read = parse_zmx(bare, tmp_path / "a.zmx")
    assert "pass the beams of the vignetting factors" in read.history[-1]
    # At the edge of the field the beam keeps 0.5 of the stop's height, from -0.7 to 0.3, as far as
    # round apertures can be closed to an ellipse: the rays at its ends pass, and just touch.
    system, theta = build(read), np.radians(read.max_field_deg)
    index = system.index(np.array([read.reference_nm]))
    ends = system.stop_radius_mm * np.array([-0.7, 0.3])
    rays = sample_rays(system, index, theta, np.zeros(2), ends)
    assert (rays.margin[:-1] < 1e-9).all()
    plain = text_of(written).split(b"\r\n")
    full = parse_zmx(
        b"\r\n".join(line for line in plain if not line.startswith(b"  DIAM")), tmp_path / "a.zmx"
    )
    needed = [s.semi_diameter for s in with_clear_apertures(full).surfaces]
    for surface, whole in zip(read.surfaces, needed, strict=True):
        assert surface.semi_diameter is None or surface.semi_diameter < whole * (1 + 1e-9)
    assert read.surfaces[0].semi_diameter < 0.95 * needed[0]
    # Outside the meridional plane the factors cannot be turned into apertures.
    with pytest.raises(UserError, match="vignetting factors off the meridional plane"):
        parse_zmx(bare.replace(b"XFLN 0 0", b"XFLN 0 5"), tmp_path / "a.zmx")


@pytest.mark.parametrize(
    ("stated", "glass", "nd"),
    [("1.6026 38.4", "model", 1.6026), ("1.6026 0", "constant", 1.6026), ("1.5 40.0", None, None)],
)
def test_an_unknown_glass_falls_back_on_what_the_file_states(tmp_path, written, stated, glass, nd):
    change = ("GLAS F5 0 0 1.5 40.0", f"GLAS F5-OLD 0 0 {stated}")
    read = parse_zmx(text_of(written, change), tmp_path / "a.zmx")
    if glass is None:  # 1.5 and 40 are what the program writes where it knows neither
        with pytest.raises(UserError, match="'F5-OLD' of surface 7"):
            first_order(read)
        return
    assert (read.surfaces[6].glass, read.surfaces[6].nd) == (glass, nd)
    text = next(t for t in read.import_log.listed("substituted") if t.startswith("surface 7"))
    assert "F5-OLD, which no catalogue has here" in text
    # A glass that is known is taken from the catalogue, whatever stands beside it.
    known = parse_zmx(
        text_of(written, ("GLAS F5 0 0 1.5 40.0", f"GLAS F5 0 0 {stated}")), tmp_path / "a.zmx"
    )
    assert known.surfaces[6].glass == "F5"


def test_a_catalogue_file_beside_the_lens_is_preferred_and_named(tmp_path, written):
    lines = ["NM MYGLASS 5 0 1.6 0", "CD 1.6 0 0", "LD 0.3 2.5", "NM F5 5 0 1.7 0", "CD 1.7"]
    (tmp_path / "misc.AGF").write_text("\n".join([*lines, "LD 0.3 2.5"]))
    changes = ("SCHOTT CDGM MISC", "misc SCHOTT CDGM OLDBOOK"), ("N-BAF10", "MYGLASS")
    read = parse_zmx(text_of(written, *changes), tmp_path / "a.zmx")
    indices = build(read).index(np.array([500.0]))[:, 0]
    assert indices[1] == pytest.approx(1.6, rel=1e-15)
    assert indices[7] == pytest.approx(1.7, rel=1e-15)  # F5: the first catalogue counts
    assert "file: GCAT MISC: from misc.AGF beside the lens" in read.import_log.listed("read")
    assert "file: GCAT OLDBOOK: no such catalogue offline" in read.import_log.listed("ignored")
    said = read.import_log.listed("read")
    assert "surface 1: glass MYGLASS of misc.AGF: formula 5, Conrady" in said


def test_apertures_in_air_count_where_the_file_says_that_they_clip(tmp_path, written):
    stop = "SURF 6\r\n"
    for line, semi in (("  FLAP 0 1 0", 1.0), ("  CLAP 0 0.8 0", 0.8), ("  PPAR 0 1 0", None)):
        read = parse_zmx(text_of(written, (stop, f"{stop}{line}\r\n")), tmp_path / "a.zmx")
        assert read.surfaces[5].semi_diameter == semi


def test_what_a_design_program_leaves_out_has_its_meaning(tmp_path, written):
    changes = (
        ("SURF 2\r\n  TYPE STANDARD\r\n", "SURF 2\r\n"),
        ("DISZ INFINITY", "DISZ 1.0E+10"),
        ("ENVD 2.0E+1 1 0", "ENVD 20 1 1"),
        ("FNUM 2.8 0", "FNUM 2.8 0\r\nOBNA 0.1 0"),
    )
    read = parse_zmx(text_of(written, *changes), tmp_path / "a.zmx")
    assert first_order(read) == first_order(parse_zmx(text_of(written), tmp_path / "a.zmx"))
    assert "file: SURF 0 DISZ 1.0E+10: by infinity" in read.import_log.listed("substituted")
    assert "file: OBNA: the object is at infinity, FNUM rules" in read.import_log.listed("ignored")


@pytest.mark.parametrize("keep", [0.05, 0.3, 0.5, 0.7, 0.9])
def test_a_truncated_file_is_refused(tmp_path, written, keep):
    text = written[1][: int(keep * len(written[1]))]
    with pytest.raises(UserError):
        parse_zmx(text.encode("cp1252"), tmp_path / "cut.zmx")


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n\x00\x00", b"hello\nworld\n"])
def test_what_is_no_lens_file_is_refused(tmp_path, content):
    with pytest.raises(UserError, match="not a lens file"):
        parse_zmx(content, tmp_path / "picture.zmx")
