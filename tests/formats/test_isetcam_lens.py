"""ISETCam's ray-trace folder: parsed and not evaluated, and the bank is that of the lens."""

import numpy as np
import pytest
from formats.exports import (
    IDEAL_MM,
    ILLUMINATION,
    WAVELENGTHS_NM,
    expected_psf,
    psf_export,
    real_mm,
    write_isetcam,
)

from gpusim.errors import UserError
from gpusim.formats.isetcam_lens import parse_parameters
from gpusim.formats.ready import load_ready

# Heights are printed to seven digits: 1e-4 um, by which the PSFs are shifted; a slope of the PSFs
# of 0.6 per 1.3 um makes 5e-5 of the peak of it.
SAME = 5e-5


@pytest.mark.parametrize("pattern", ["made-up_2D_PSF_Fld{}_Wave{}.dat", "made-up_PSF_{}_{}.dat"])
@pytest.mark.parametrize("by", ["folder", "file"])
def test_the_bank_is_that_of_the_lens(tmp_path, pattern, by):
    file = write_isetcam(tmp_path, pattern)
    lens = load_ready(tmp_path if by == "folder" else file)
    bank = lens.bank()
    assert bank.psf.shape == (16, 3, 64, 64) and bank.pitch_um == 0.5
    np.testing.assert_array_equal(bank.wavelengths_nm, WAVELENGTHS_NM)
    assert bank.reference_nm == 550  # the nearest to the file's 549
    np.testing.assert_allclose(bank.ideal_height_um[::5], 1e3 * np.array(IDEAL_MM))
    np.testing.assert_allclose(bank.relative_illumination[::5, 2], ILLUMINATION)
    np.testing.assert_array_equal(bank.transmission, 0.9)
    np.testing.assert_allclose(bank.projected_solid_angle_sr, np.pi / 5.8**2)
    assert (bank.efl_mm, bank.f_number, lens.title) == (5.0, 2.8, "made-up")
    np.testing.assert_allclose(bank.field_deg[-1], np.degrees(np.arctan(1.2 / 5)))
    for place, wavelength in enumerate(WAVELENGTHS_NM):
        exact_um = 1e3 * real_mm(1e-3 * bank.ideal_height_um, wavelength)
        np.testing.assert_allclose(bank.real_height_um[:, place], exact_um, rtol=0, atol=1e-3)
        for number, ideal in enumerate(IDEAL_MM):
            exact = expected_psf(ideal, wavelength, 64, 0.5)
            np.testing.assert_allclose(
                bank.psf[5 * number, place], exact, rtol=0, atol=SAME * exact.max()
            )


def test_a_psf_off_its_chief_ray_is_moved_onto_it(tmp_path):
    """The centre of an export may be the centroid: here 0.7 um outwards."""
    file = write_isetcam(tmp_path)
    centre_mm = real_mm(1.2, 550.0) + 0.7e-3
    text = psf_export(1.2, 550.0, side=-1, field="height", centre_mm=centre_mm)
    path = tmp_path / "made-up_2D_PSF_Fld4_Wave2.dat"
    on_chief_ray = load_ready(file).bank().psf[-1, 1]
    assert path.exists()
    path.write_bytes(text.encode("cp1252"))
    moved = load_ready(file).bank().psf[-1, 1]
    # By splines of degree 5: (2 pi 0.5 f)^6 of what contrast there is at f = 0.4 cycles/um.
    np.testing.assert_allclose(moved, on_chief_ray, rtol=0, atol=2e-4 * moved.max())
    unmoved = psf_export(1.2, 550.0, side=-1, field="height", centre_mm=centre_mm).replace(
        "Center coordinates", "Somewhere"
    )
    path.write_bytes(unmoved.encode("cp1252"))
    assert np.abs(load_ready(file).bank().psf[-1, 1] - on_chief_ray).max() > 0.1 * moved.max()


def test_an_object_at_a_finite_distance_is_said(tmp_path):
    file = write_isetcam(tmp_path)
    text = file.read_text()
    text = text.replace("objDist=10000000000.000", "objDist=55.000")
    file.write_text(text.replace("mag=0.000000", "mag=-0.100000"))
    bank = load_ready(file).bank()
    np.testing.assert_allclose(bank.ideal_height_um[-1], 1200)
    assert bank.provenance["object"].startswith("55 mm before the lens; field angles")


def test_parameters_are_parsed():
    text = "% note\na=1.5; % 'x'\nb='C:\\a b\\c';  %d\nc=400:50:500;\nd=[1, 2 3]\n\ne=-1e-3\nf=3.\n"
    values = parse_parameters(text, "p.txt")
    assert values["b"] == "C:\\a b\\c"
    for name, expected in {
        "a": [1.5], "c": [400, 450, 500], "d": [1, 2, 3], "e": [-1e-3], "f": [3],
    }.items():  # fmt: skip
        np.testing.assert_allclose(values[name], expected)


@pytest.mark.parametrize(
    "line",
    [
        "system('rm -rf /')",
        "a=system('ls')",
        "a=1+1",
        "a=pi",
        "a=1; b=2",
        "delete(x)",
        "a='x'; evil()",
        "a=1:1e-9:1000",
        "a=5:1",
        "a=nan",
        "a=",
        "!ls",
    ],
)
def test_nothing_is_evaluated(line):
    with pytest.raises(UserError, match="nothing is evaluated") as caught:
        parse_parameters(f"x=1;\n{line}\n", "p.txt")
    assert "line 2" in caught.value.screen()


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("ISETPARMS.TXT", "efl=5.000000;", "", ["efl is missing"]),
        ("ISETPARMS.TXT", "efl=5.0", "efl=-5.0", ["efl", "above 0"]),
        ("ISETPARMS.TXT", "efl=5.000000", "efl='five'", ["efl", "a number"]),
        ("ISETPARMS.TXT", "efl=5.000000", "efl=[5 6]", ["efl", "one number"]),
        ("ISETPARMS.TXT", "fnumber_eff=2.900000;", "", ["fnumber_eff is missing"]),
        ("ISETPARMS.TXT", "imgHeightNum=4", "imgHeightNum=1", ["imgHeightNum", "2 to"]),
        ("ISETPARMS.TXT", "imgHeightNum=4", "imgHeightNum=5", ["not whole", "_DI_.dat"]),
        ("ISETPARMS.TXT", "wave=450:100:650", "wave=400:100:600", ["450 nm", "400 nm"]),
        ("ISETPARMS.TXT", "wave=450:100:650", "wave='white'", ["wave", "a number"]),
        ("ISETPARMS.TXT", "made-up\\made-up'", "made-up\\other'", ["other_DI_.dat", "read"]),
        ("ISETPARMS.yaml", "transmission: 0.9", "{}", ["transmission", "ISETPARMS.yaml"]),
        ("ISETPARMS.yaml", "0.9", "[0.9, 0.8]", ["transmission", "2 numbers", "1 or 3"]),
        ("ISETPARMS.yaml", "0.9", "0.9\ncolour: red", ["colour", "unknown field"]),
        ("made-up_RI_.dat", "1.000000E+00", "", ["not whole", "11 numbers"]),
        ("made-up_RI_.dat", "1.000000E+00", "one", ["number", "_RI_"]),
        ("made-up_DI_.dat", "E-01", "E-04", ["lie apart", "_DI_.dat"]),
        ("made-up_2D_PSF_Fld2_Wave1.dat", "Listing of", "What", ["not a Zemax PSF export"]),
    ],
)
def test_what_is_missing_or_wrong_is_named(tmp_path, name, old, new, words):
    file = write_isetcam(tmp_path)
    text = (tmp_path / name).read_bytes().decode("cp1252")
    assert old in text
    (tmp_path / name).write_bytes(text.replace(old, new, 1).encode("cp1252"))
    with pytest.raises(UserError) as caught:
        load_ready(file)
    for word in words:
        assert word in caught.value.screen()


def test_a_missing_psf_file_is_named(tmp_path):
    file = write_isetcam(tmp_path)
    (tmp_path / "made-up_2D_PSF_Fld3_Wave2.dat").unlink()
    with pytest.raises(UserError, match="PSF file is missing") as caught:
        load_ready(file)
    assert "made-up_2D_PSF_Fld3_Wave2.dat" in caught.value.screen()
