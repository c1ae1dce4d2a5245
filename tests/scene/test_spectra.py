"""Tables against colour-science's own numbers, and photometry against its definitions."""

import subprocess
import sys

import numpy as np
import pytest
from harness import assert_close

from gpusim.errors import UserError
from gpusim.scene import spectra
from gpusim.scene.spectra import QUADRATURE_NM, WAVELENGTHS_NM

colour = pytest.importorskip("colour", reason="colour-science is what the tables are checked by")
SHAPE = colour.SpectralShape(400, 700, 5)
OBSERVER = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]


def test_illuminants_are_those_of_colour_science():
    known, table = spectra._table("illuminants")
    names = list(table)
    assert {"A", "D50", "D65", "E", "FL2", "LED-B3"} <= set(names)
    for name in names:
        table = colour.SDS_ILLUMINANTS[name]
        own = known[(known >= table.shape.start) & (known <= table.shape.end)]
        published = [table[nm] for nm in own]
        # The file keeps 8 digits: half a unit in the last place of a number that begins with 1.
        assert_close(spectra.illuminant(name, own), np.array(published), rtol=5e-8)
        last_nm = spectra.illuminant_known(name).last_nm
        formula = np.inf if name in "AE" else 830 if name in ("D50", "D55", "D65", "D75") else 0
        assert last_nm == max(table.shape.end, formula)


def test_daylight_goes_on_by_its_formula_to_830_nm():
    # CIE 15:2004, table T.1, D65 at 830 nm.
    assert spectra.illuminant("D65", np.array([830.0]))[0] == pytest.approx(60.3125, abs=5e-5)
    for name, kelvin in (("D50", 5000), ("D55", 5500), ("D65", 6500), ("D75", 7500)):
        xy = colour.temperature.CCT_to_xy_CIE_D(kelvin * 1.4388 / 1.4380)
        formula = colour.sd_CIE_illuminant_D_series(xy)
        beyond = np.arange(785.0, 831.0, 5.0)
        published = np.array([formula[nm] for nm in beyond])
        assert_close(spectra.illuminant(name, beyond), published, rtol=5e-6)  # 6 digits in the file


def test_illuminant_a_goes_on_by_its_formula():
    # CIE 015:2018, eq. 4.1, at 1000 nm: by hand, 100 (560 / 1000)^5 (exp(8.99769) - 1) /
    # (exp(5.03862) - 1), with 1.435e7 / (2848 x 560) = 8.997642 and 1.435e7 / 2848000 = 5.038624.
    by_hand = 100 * 0.56**5 * np.expm1(1.435e7 / (2848 * 560)) / np.expm1(1.435e7 / 2848e3)
    found = spectra.illuminant("A", np.array([700.0, 830.0, 1000.0, 1200.0]))
    assert found[2] == pytest.approx(by_hand, rel=1e-12)
    # The table and the formula are one curve.
    whole = spectra.illuminant("A", spectra.ALL_NM)
    assert_close(whole, spectra._illuminant_a(spectra.ALL_NM), rtol=2e-5)


def test_a_blackbody_is_plancks_law():
    planck = colour.colorimetry.planck_law(spectra.ALL_NM * 1e-9, 5100, c2=1.438776877e-2)
    ours = spectra.illuminant("5100K", spectra.ALL_NM)
    assert_close(ours / ours[52], planck / planck[52], rtol=1e-12)
    for name in ("5100 K", "5100.0K"):
        assert np.array_equal(spectra.illuminant(name), spectra.illuminant("5100K"))
    for name in ("0K", "200001K"):
        with pytest.raises(UserError, match="500K to 100000K"):
            spectra.illuminant(name)


@pytest.mark.parametrize(
    ("name", "kelvin"),
    [
        ("D40", 4000 * 1.4388 / 1.4380),
        ("D57", 5700 * 1.4388 / 1.4380),
        ("D5700K", 5700.0),
        ("D7001 K", 7001.0),
        ("D93", 9300 * 1.4388 / 1.4380),
        ("D25000K", 25000.0),
    ],
)
def test_daylight_of_any_temperature_is_the_cies(name: str, kelvin: float):
    """Against colour-science's, of the same rounded factors; 5 nm are its own grid too."""
    nm = np.arange(300.0, 831.0, 5.0)
    xy = colour.temperature.CCT_to_xy_CIE_D(kelvin)
    theirs = colour.sd_CIE_illuminant_D_series(xy, M1_M2_rounding=True)
    # The file has their components with all their digits.
    assert_close(spectra.illuminant(name, nm), np.array([theirs[one] for one in nm]), rtol=1e-9)
    assert spectra.illuminant_known(name)[1:] == (300.0, 830.0)


def test_daylights_of_the_table_are_those_of_the_formula():
    """To the CIE's rounding: to three decimals at 10 nm, and once more midway between two."""
    for name in ("D50", "D55", "D60", "D65", "D75"):
        formula = spectra._daylight(WAVELENGTHS_NM, 100 * int(name[1:]) * 1.4388 / 1.4380)
        assert_close(spectra.illuminant(name), formula, atol=1.001e-3)


@pytest.mark.parametrize("name", ["D39", "D3999K", "D251", "D25001K", "D5"])
def test_no_daylight_is_refused(name: str):
    with pytest.raises(UserError) as caught:
        spectra.illuminant(name)
    assert caught.value.field == "illuminant" and caught.value.value == name


def test_a_grid_holds_what_the_eye_sees_and_no_more_than_is_known():
    assert np.array_equal(spectra.grid_nm(450, 650), WAVELENGTHS_NM)
    assert spectra.grid_nm(396.8, 1004.1)[[0, -1]].tolist() == [400, 1000]
    assert spectra.grid_nm(0, np.inf)[[0, -1]].tolist() == [300, 1200]
    for first, last in ((300, 1200), (400, 700), (380, 730)):
        grid = spectra.grid_nm(first, last)
        assert np.array_equal(grid[spectra.seen_by_eye(grid)], WAVELENGTHS_NM)


def test_luminance_is_that_of_what_the_eye_sees():
    grid = spectra.grid_nm(380, 1000)
    wide = spectra.white_radiance("A", 300.0, grid)
    # Two sums of 61 positive terms, one product and one division: 2 * 61 + 2 roundings.
    assert spectra.luminance_cd_m2(wide, grid) == pytest.approx(300, rel=124 * 2.0**-53)
    assert np.array_equal(wide[spectra.seen_by_eye(grid)], spectra.white_radiance("A", 300.0))


def test_colorchecker_reflectances_are_those_of_colour_science():
    published = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    grid = spectra.grid_nm(*spectra.patch_known("red")[1:])
    shape = colour.SpectralShape(grid[0], grid[-1], 5)
    assert (grid[0], grid[-1]) == (380, 730)
    ours = spectra.colorchecker(grid)
    assert list(ours) == list(published)
    for name, reflectance in ours.items():
        whole = published[name].copy().align(shape).values
        # From 400 to 700 nm the rows are those interpolated within that range.
        whole[spectra.seen_by_eye(grid)] = published[name].copy().align(SHAPE).values
        # The file keeps 6 decimals.
        assert_close(reflectance, whole, atol=0.51e-6)


def test_observer_and_rgb_reflectances_are_those_of_colour_science():
    published = OBSERVER.copy().align(SHAPE).values.T
    assert_close(spectra.colour_matching(), published, rtol=1e-11)  # 12 digits in the file
    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.copy().align(SHAPE).values.T
    assert_close(spectra.rgb_reflectances(), basis, rtol=1e-11)
    wide = spectra.grid_nm(*spectra.rgb_known()[1:])
    assert (wide[0], wide[-1]) == (380, 780)
    basis = colour.recovery.MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019.values.T
    assert_close(spectra.rgb_reflectances(wide), basis, rtol=1e-11)


def test_quadrature_is_the_trapezoidal_rule():
    curve = np.cos(WAVELENGTHS_NM / 50)
    # Two orders of summing 61 terms below 5: 61 * 2^-53 * 300.
    assert QUADRATURE_NM @ curve == pytest.approx(
        np.trapezoid(curve, WAVELENGTHS_NM), rel=0, abs=3e-12
    )


def test_dark_skin_under_d50_has_its_published_colour():
    # BabelColor's table gives x 0.4325, y 0.3788, Y 0.1034 for its average chart under D50;
    # colour-science gets 0.43245, 0.37833, 0.1033 from the same spectrum over 360-780 nm. What is
    # left: 5e-4 between table and spectrum, and the tails beyond 400-700 nm, below 1e-4 in x, y, Y.
    white = spectra.white_radiance("D50", 1.0)
    big_x, big_y, big_z = spectra.xyz(spectra.colorchecker()["dark skin"] * white)
    total = big_x + big_y + big_z
    assert big_x / total == pytest.approx(0.4325, abs=6e-4)
    assert big_y / total == pytest.approx(0.3788, abs=6e-4)
    assert big_y == pytest.approx(0.1034, abs=2e-4)


@pytest.mark.parametrize("illuminant", ["D50", "A", "FL2"])
def test_xyz_of_all_patches_agrees_with_the_integral_over_all_wavelengths(illuminant):
    lamp = colour.SDS_ILLUMINANTS[illuminant]
    full = colour.SpectralShape(380, 730, 5)
    bars = OBSERVER.copy().align(full).values
    power = lamp.copy().align(full).values
    reflectances = np.stack(
        [
            sd.copy().align(full).values
            for sd in colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
        ]
    )
    reference = (reflectances * power) @ bars / (power @ bars[:, 1])
    # No reflectance exceeds 1: what lies outside 400-700 nm is at most the lamp's own tails, and
    # as much again in the normalisation.
    outside = (full.wavelengths < 400) | (full.wavelengths > 700)
    tails = np.abs(power[outside] @ bars[outside]) / (power @ bars[:, 1])
    ends = 5 * np.abs(power[[4, 64]] @ bars[[4, 64]]) / (5 * power @ bars[:, 1])
    white = spectra.white_radiance(illuminant, 1.0)
    ours = spectra.xyz(np.stack(list(spectra.colorchecker().values())) * white)
    allowed = tails + ends + reference * (tails + ends)[1]
    assert allowed.max() < 0.03  # the bound itself is tight enough to mean something
    assert_close(ours, reference, atol=allowed)


@pytest.mark.parametrize("name", ["D50", "A", "E", "FL11", "LED-RGB1"])
@pytest.mark.parametrize("luminance", [1e-3, 300.0, 1e9])
def test_white_has_the_luminance_that_was_asked_for(name, luminance):
    radiance = spectra.white_radiance(name, luminance)
    # Two sums of 61 positive terms, one product and one division: 2 * 61 + 2 roundings.
    assert spectra.luminance_cd_m2(radiance) == pytest.approx(luminance, rel=124 * 2.0**-53)


def test_luminance_of_a_line_at_555_nm_is_683_lumens_per_watt():
    line = np.zeros(61)
    line[31] = 1 / 5  # 1 W m^-2 sr^-1 in the sample at 555 nm
    assert WAVELENGTHS_NM[31] == 555
    assert spectra.luminance_cd_m2(line) == pytest.approx(683.0, rel=1e-12)  # V(555 nm) = 1


def test_an_unknown_illuminant_is_an_error_that_lists_the_known():
    with pytest.raises(UserError) as caught:
        spectra.illuminant("D5")
    assert caught.value.value == "D5"
    assert "D50" in caught.value.allowed


def test_making_a_scene_imports_neither_colour_science_nor_scipy():
    # 2 s and 0.3 s of start-up.
    code = (
        "import sys; from gpusim.scene import make_scene; make_scene('demo');"
        "sys.exit(bool({'colour', 'scipy', 'OpenEXR'} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_patches_of_the_sg_have_their_published_colours():
    published = colour.CCS_COLOURCHECKERS["ColorCheckerSG - After November 2014"]
    names = [name for name in spectra.patch_names() if name.startswith("SG ")]
    assert names == [f"SG {name}" for name in published.data]
    power = spectra.illuminant("D50")
    reflectances = np.stack([spectra.patch_reflectance(name) for name in names])
    assert reflectances.min() >= 0.002
    assert reflectances.max() <= 1
    white = spectra.xyz(power)
    ours = colour.XYZ_to_Lab(spectra.xyz(reflectances * power) / white[1], _xy(white))
    theirs = [
        colour.XYZ_to_Lab(colour.xyY_to_XYZ(one), published.illuminant)
        for one in published.data.values()
    ]
    # The file keeps 5 decimals: near black half a unit of one is 2.3e-3 of L, a hundredth in all.
    assert colour.delta_E(ours, np.array(theirs), method="CIE 2000").max() < 0.01


def _xy(big: np.ndarray) -> np.ndarray:
    return big[:2] / big.sum()
