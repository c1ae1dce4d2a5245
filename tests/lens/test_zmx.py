"""A .zmx file of our own writing gives the same lens; what is not modelled is refused by name."""

import numpy as np
import pytest
from lens.made import lens, model

from gpusim.errors import UserError
from gpusim.lens.bank import compute_bank
from gpusim.lens.prescription import load_prescription
from gpusim.lens.system import build, first_order
from gpusim.lens.zmx import parse_zmx

CODECS = {"ANSI": "cp1252", "UTF-16": "utf-16", "UTF-16 without mark": "utf-16-le"}


def zmx_text(prescription, image_distance_mm):
    """Write a prescription as Zemax does: curvatures, one block for each surface."""
    lines = prescription.design_wavelengths_nm
    primary = lines.index(prescription.reference_nm) + 1
    text = [
        "VERS 140730 195 26155",
        "MODE SEQ",
        f"NAME {prescription.title}",
        f"NOTE 0 {prescription.source}",
        "UNIT MM X W X CM MR CPMM",
        f"FNUM {prescription.f_number!r} 0",
        "ENVD 2.0E+1 1 0",
        "GFAC 0 0",
        f"GCAT {' '.join(prescription.glass_catalogues)} MISC",
        "RAIM 0 2 1 1 0 1 0 0 0",
        f"FTYP 0 0 3 {len(lines)} 0 0 0",
        "XFLN 0 0 0 0 0 0 0 0 0 0 0 0",
        f"YFLN 0 {0.7 * prescription.max_field_deg!r} {prescription.max_field_deg!r} 0 0 0 0 0",
        *(f"WAVM {i} {w / 1e3!r} 1" for i, w in enumerate(lines, start=1)),
        "WAVM 4 0.55 1",  # unused entries follow the used ones
        f"PWAV {primary}",
        "COFN QF COATING.DAT",
        "SURF 0",
        "  TYPE STANDARD",
        "  CURV 0.0 0 0 0 0",
        "  DISZ INFINITY",
        "  DIAM 0 0 0 0 1",
    ]
    surfaces = prescription.surfaces
    for number, surface in enumerate(surfaces, start=1):
        text += [f"SURF {number}"] + (["  STOP"] if number == prescription.stop else [])
        aspheric = any(surface.asphere.coefficients)
        thickness = image_distance_mm if number == len(surfaces) else surface.thickness
        text += [
            f"  TYPE {'EVENASPH' if aspheric else 'STANDARD'}",
            f"  CURV {surface.vertex_curvature!r} 0 0 0 0",
            "  HIDE 0 0 0 0 0 0 0 0 0 0",
            f"  DISZ {thickness!r}",
        ]
        if aspheric:
            for i, a in enumerate(surface.asphere.coefficients, start=1):
                text.append(f"  PARM {i} {a!r}")
        if surface.conic:
            text.append(f"  CONI {surface.conic!r}")
        if surface.glass == "model":
            text.append(f"  GLAS ___BLANK 1 0 {surface.nd!r} {surface.vd!r} 0 0 0 0 0 0")
        elif surface.glass:
            text.append(f"  GLAS {surface.glass} 0 0 1.5 40.0 0 0 0 0 0 0")
        text.append(f"  DIAM {surface.semi_diameter or 1.0!r} 1 0 0 1")
    text += [
        f"SURF {len(surfaces) + 1}",
        "  TYPE STANDARD",
        "  CURV 0.0 0 0 0 0",
        "  DISZ 0",
        "  DIAM 1 0 0 0 1",
        "TOL TOFF 0 0",
        "EFLY 0 2 0 0",
    ]
    return "\r\n".join(text) + "\r\n"


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


def test_the_account_says_what_was_read_ignored_and_substituted(tmp_path, written):
    original, text = written
    prescription = parse_zmx(text.encode("cp1252"), tmp_path / "a.zmx")
    assert prescription.title == original.title
    assert prescription.glass_catalogues == original.glass_catalogues
    assert prescription.max_field_deg == original.max_field_deg
    assert prescription.design_wavelengths_nm == pytest.approx(original.design_wavelengths_nm)
    assert prescription.surfaces[5].semi_diameter is None  # the aperture sets the stop
    account = prescription.account
    assert (1, "TYPE, CURV, DISZ, GLAS, DIAM", "read") in account.rows
    for entry in (
        "file: COFN",
        "surface 1: HIDE",
        "file: TOL",
        "file: EFLY",
        "file: GCAT MISC: no such catalogue offline",
    ):
        assert entry in account.listed("ignored")
    assert account.listed("substituted") == ["file: RAIM: every ray is aimed at the real stop"]


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
    assert any("model glass nd 1.52" in text for text in read.account.listed("substituted"))


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
        ("DISZ INFINITY", "DISZ 1000", ["finite object distance", "1000", "INFINITY"]),
        ("  STOP\r\n", "", ["no stop", "STOP"]),
        ("SURF 3\r\n", "SURF 3\r\n  STOP\r\n", ["several stops", "[3, 6]"]),
        ("FNUM 2.8 0", "OBNA 0.2 0", ["OBNA", "numerical aperture"]),
        ("FNUM 2.8 0\r\n", "", ["no aperture"]),
        ("FNUM 2.8 0", "FNUM 0 0", ["f_number", "greater than 0"]),
        ("FNUM 2.8 0", "FNUM two 0", ["FNUM", "two", "number"]),
        ("FTYP 0 0", "FTYP 3 0", ["FTYP", "real image height"]),
        ("FTYP 0 0", "FTYP 0 1", ["telecentric"]),
        ("GFAC 0 0", "GFAC 1 2.0", ["apodisation"]),
        ("ENVD 2.0E+1 1 0", "ENVD 4.0E+1 1 1", ["environment"]),
        ("SURF 2\r\n  TYPE STANDARD", "SURF 2\r\n  TYPE COORDBRK", ["SURF 2 TYPE", "COORDBRK"]),
        ("SURF 2\r\n  TYPE STANDARD", "SURF 2\r\n  TYPE XASPHERE", ["SURF 2 TYPE", "XASPHERE"]),
        ("GLAS F5", "GLAS MIRROR", ["mirrors", "SURF 7 GLAS"]),
        ("  HIDE 0 0", "  SCBD 0 0", ["SCBD is not understood", "SURF 1 SCBD"]),
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


@pytest.mark.parametrize("keep", [0.05, 0.3, 0.5, 0.7, 0.9])
def test_a_truncated_file_is_refused(tmp_path, written, keep):
    text = written[1][: int(keep * len(written[1]))]
    with pytest.raises(UserError):
        parse_zmx(text.encode("cp1252"), tmp_path / "cut.zmx")


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n\x00\x00", b"hello\nworld\n"])
def test_what_is_no_lens_file_is_refused(tmp_path, content):
    with pytest.raises(UserError, match="not a lens file"):
        parse_zmx(content, tmp_path / "picture.zmx")
