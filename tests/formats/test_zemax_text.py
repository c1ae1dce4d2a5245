"""Zemax's text exports: units, orientation and heights against the lens that they were made of."""

import numpy as np
import pytest
from formats.exports import (
    EFL_MM,
    IDEAL_MM,
    ILLUMINATION,
    WAVELENGTHS_NM,
    distortion_export,
    expected_psf,
    psf_export,
    real_mm,
    write_zemax,
)

from gpusim.errors import UserError
from gpusim.formats.ready import load_ready
from gpusim.formats.zemax_distortion import parse_distortion
from gpusim.formats.zemax_psf import parse_psf

# Exports have seven digits, and splines of degree 5 go through samples that are a third of the
# Gaussians' width apart; float32 in the bank.
SAME = 3e-7
# Angles are printed to 1e-4 degrees, 4.4e-3 um of the height at a focal length of 5 mm.
HEIGHT_UM = 5e-3


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"encoding": "utf-16-le"},
        {"encoding": "utf-8"},
        {"encoding": "cp1252", "grids": False},
        {"side": -1},
        {"side": -1, "grids": False, "kind": "FFT"},
        {"kind": "FFT", "centre": (33, 32)},
        {"spacing_um": 0.4, "size": 80, "centre": (40, 42)},
        {"field": "height"},
        {"first_row": "-y"},
        {"first_row": "-y", "side": -1, "centre": (31, 33)},
    ],
)
def test_the_bank_is_that_of_the_lens_that_was_exported(tmp_path, options):
    file = write_zemax(tmp_path, **options)
    if options.get("field") == "height":
        text = file.read_text().replace("field_type: angle", "field_type: paraxial image height")
        file.write_text(text)
    lens = load_ready(file)
    bank = lens.bank()
    size = options.get("size", 64)
    assert bank.psf.shape == (16, 3, size, size)  # 4 fields of 5 intervals
    assert bank.pitch_um == options.get("spacing_um", 0.5)
    np.testing.assert_allclose(bank.wavelengths_nm, WAVELENGTHS_NM)
    assert bank.reference_nm == bank.wavelengths_nm[1]
    ideal_um = bank.ideal_height_um[::5]
    np.testing.assert_allclose(ideal_um, 1e3 * np.array(IDEAL_MM), rtol=0, atol=HEIGHT_UM)
    for place, wavelength in enumerate(WAVELENGTHS_NM):
        # All heights, also those between the exports' fields.
        exact_um = 1e3 * real_mm(1e-3 * bank.ideal_height_um, wavelength)
        np.testing.assert_allclose(
            bank.real_height_um[:, place], exact_um, rtol=0, atol=2 * HEIGHT_UM
        )
        for number, ideal in enumerate(IDEAL_MM):
            exact = expected_psf(ideal, wavelength, size, bank.pitch_um)
            np.testing.assert_allclose(
                bank.psf[5 * number, place], exact, rtol=0, atol=SAME * exact.max()
            )
    # Turned or mirrored it is another.
    exact = expected_psf(IDEAL_MM[-1], 550.0, size, bank.pitch_um)
    for other in (exact.T, np.roll(exact[:, ::-1], 1, 1), np.roll(exact[::-1], 1, 0)):
        assert np.abs(other - exact).max() > 0.05 * exact.max()
    np.testing.assert_allclose(bank.relative_illumination[::5, 0], ILLUMINATION)
    np.testing.assert_array_equal(bank.transmission, [0.90, 0.92, 0.91])
    np.testing.assert_allclose(bank.projected_solid_angle_sr, np.pi / 5.8**2)
    assert (bank.efl_mm, bank.f_number, lens.title) == (EFL_MM, 2.8, "Gaussians")
    assert np.isnan(bank.failed_rays).all()


def test_older_versions_give_the_field_as_one_angle():
    text = psf_export(0.8, 550.0, side=-1).replace("at 0.0000, -9.0903 (deg).", "at -9.09 deg.")
    export = parse_psf(text.encode("cp1252"), "old.dat")
    assert (export.field, export.field_step, export.field_unit) == (-9.09, 0.01, "deg")
    assert export.side == -1


def test_exports_of_different_spacing_meet_on_the_finest(tmp_path):
    """The fast Fourier transform's spacing goes with the wavelength."""
    file = write_zemax(tmp_path)
    for field, ideal in enumerate(IDEAL_MM):
        text = psf_export(ideal, 450.0, spacing_um=0.45)
        (tmp_path / f"f{field}_w0.txt").write_text(text, encoding="utf-16")
    bank = load_ready(file).bank()
    assert bank.pitch_um == 0.45
    assert bank.psf.shape[-1] == 72  # 64 x 0.5 um = 71.1 x 0.45 um, even
    for place, wavelength in enumerate(WAVELENGTHS_NM):
        exact = expected_psf(1.2, wavelength, 72, 0.45)
        # The spline's error between samples of 0.5 um: (2 pi 0.5 f)^6 of a Gaussian 1.3 um wide,
        # which has contrast up to f = 0.4 cycles/um.
        np.testing.assert_allclose(bank.psf[-1, place], exact, rtol=0, atol=2e-4 * exact.max())


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Listing of Huygens PSF", "Listing of Spot", ["not a Zemax PSF export"]),
        ("0.5500 µm at", "0.4861 to 0.6563 µm at", ["polychromatic", "0.4861 to 0.6563"]),
        ("0.0000, 9.09", "1.0000, 9.09", ["off the y axis"]),
        ("Data spacing is", "Spacing", ["data spacing"]),
        ("Data spacing is 0.5", "Data spacing is 0.0", ["data spacing", "> 0"]),
        ("Image grid size: 64 by 64", "Image grid size: 64 by 32", ["64 by 32", "square"]),
        ("Center point is: 33", "Center point is: x", ["centre point"]),
    ],
)
def test_what_is_no_psf_export_is_refused_by_name(tmp_path, old, new, words):
    text = psf_export(0.8, 550.0)
    assert old in text
    text = text.replace(old, new)
    with pytest.raises(UserError) as caught:
        parse_psf(text.encode("utf-16"), tmp_path / "f.txt")
    for word in [*words, "f.txt"]:
        assert word in caught.value.screen()


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n\x00\x00", bytes(range(256)) * 4])
def test_garbage_is_refused(tmp_path, content):
    for reader in (parse_psf, parse_distortion):
        with pytest.raises(UserError, match="not a Zemax"):
            reader(content, tmp_path / "a.txt")


@pytest.mark.parametrize("keep", [0.001, 0.008, 0.3, 0.9, 0.999])
def test_a_truncated_export_is_refused(tmp_path, keep):
    for reader, text in (
        (parse_psf, psf_export(0.8, 550.0)),
        (parse_distortion, distortion_export(550.0)[:1000]),
    ):
        with pytest.raises(UserError):
            reader(text[: int(keep * len(text))].encode(), tmp_path / "a.txt")


@pytest.mark.parametrize("values", ["nan", "-1.0E-001", "one"])
def test_values_that_are_no_intensities_are_refused(tmp_path, values):
    head, _, body = psf_export(0.8, 550.0).partition("intensity.\r\n\r\n")
    body = values + body[len("1.234567E-001") :]
    with pytest.raises(UserError, match=r"intensities|number"):
        parse_psf(f"{head}intensity.\r\n\r\n{body}".encode(), tmp_path / "a.txt")


def test_a_distortion_export_is_read_in_its_units(tmp_path):
    text = distortion_export(550.0)
    wavelength, ideal, real = parse_distortion(text.encode("cp1252"), tmp_path / "a.txt")
    assert wavelength == pytest.approx(550.0)
    # Six digits of up to 0.95 mm: 5e-3 um in each coordinate.
    np.testing.assert_allclose(real, 1e3 * real_mm(1e-3 * ideal, 550.0), rtol=0, atol=1e-2)
    inches = text.replace("Units are Millimeters", "Units are Inches")
    again = parse_distortion(inches.encode("utf-16"), tmp_path / "a.txt")[1]
    np.testing.assert_allclose(again, 25.4 * ideal)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("Units are Millimeters", "Units are Furlongs", ["Furlongs", "millimeters"]),
        ("Wavelength:", "Wave", ["not a Zemax grid-distortion export"]),
        ("  -8   -8", "  -8    x", ["symmetric"]),
        ("", "", ["not whole"]),
    ],
)
def test_what_is_no_distortion_export_is_refused_by_name(tmp_path, old, new, words):
    text = distortion_export(550.0)
    assert old in text
    if words == ["symmetric"]:
        # A keystone: the left side is 1 % smaller than the right.
        lines = text.splitlines()
        for number, line in enumerate(lines):
            parts = line.split()
            if len(parts) == 10 and parts[0].startswith("-") and parts[0][1:].isdigit():
                parts[7] = f"{0.99 * float(parts[7]):.5E}"
                lines[number] = " ".join(parts)
        text = "\n".join(lines)
    elif not old:
        text = "\n".join(text.splitlines()[:12])
    else:
        text = text.replace(old, new)
    with pytest.raises(UserError) as caught:
        parse_distortion(text.encode(), tmp_path / "g.txt")
    for word in [*words, "g.txt"]:
        assert word in caught.value.screen()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("transmission: [0.90, 0.92, 0.91]\n", "", ["transmission", "missing"]),
        ("working_f_number: 2.9\n", "", ["working_f_number", "missing"]),
        ("relative_illumination: [1.0, 0.98, 0.93, 0.85]\n", "", ["relative_illumination"]),
        ("[1.0, 0.98, 0.93, 0.85]", "[1.0, 0.98]", ["relative_illumination", "2 fields", "4"]),
        ("f0_w0.txt, ", "", ["an export is missing", "450 nm"]),
        ("f0_w0.txt, ", "f0_w1.txt, ", ["same field and wavelength", "f0_w1.txt"]),
        ("f0_w0.txt, ", "f9_w9.txt, ", ["cannot be read", "f9_w9.txt"]),
        ("reference_nm: 550", "reference_nm: 500", ["reference_nm", "450, 550, 650"]),
        ("field_type: angle", "field_type: paraxial image height", ["field_type", "angle"]),
        ("field_type: angle", "field_type: object height", ["field_type"]),
        (", grid_2.txt", "", ["chief rays of a wavelength", "650 nm"]),
        ("grid_2.txt", "f0_w0.txt", ["grid-distortion", "f0_w0.txt"]),
        ("field_type: angle", "field_type: angle\nfirst_row: top", ["first_row", "+y"]),
        ("efl_mm: 5.0", "efl_mm: 7.0", ["not reach"]),
        ("efl_mm: 5.0", "efl_mm: 4.9", ["not on the chief ray", "Use Centroid"]),
    ],
)  # fmt: skip
def test_what_the_exports_do_not_hold_is_asked_for(tmp_path, old, new, words):
    file = write_zemax(tmp_path)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError) as caught:
        load_ready(file)
    for word in words:
        assert word in caught.value.screen()


def test_without_any_chief_rays_a_distortion_export_is_asked_for(tmp_path):
    file = write_zemax(tmp_path, grids=False)
    one = tmp_path / "f1_w1.txt"
    text = one.read_text(encoding="utf-16")
    one.write_text(text.replace("Center coordinates", "Somewhere"), encoding="utf-16")
    with pytest.raises(UserError, match="heights of the chief rays are missing") as caught:
        load_ready(file)
    assert "distortion_files" in caught.value.screen()


def test_samples_that_do_not_resolve_the_psf_are_refused(tmp_path):
    file = write_zemax(tmp_path, spacing_um=2.0)
    with pytest.raises(UserError, match="do not resolve the PSF"):
        load_ready(file)
