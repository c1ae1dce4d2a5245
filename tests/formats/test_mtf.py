"""The MTF-only lens: the table comes back out of the bank, and what is no MTF is refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from changes import changed
from scipy.special import j1

from gpusim.errors import UserError
from gpusim.formats.mtf import Curve, read_mtf, round_psfs
from gpusim.formats.ready import load_ready, mtf_presets

FREQUENCIES = [0, 50, 100, 200, 300, 400]
TABLE = {
    "title": "a table",
    "source": "made up",
    "efl_mm": 8.0,
    "f_number": 4.0,
    "working_f_number": 4.1,
    "transmission": [0.9, 0.8],
    "wavelengths_nm": [[430, 490], 600],
    "mtf": {
        "frequencies_cy_mm": FREQUENCIES,
        "fields": [
            {
                "height_mm": 0,
                "relative_illumination": 1,
                "values": [[1, 0.9, 0.8, 0.5, 0.2, 0], [1, 0.88, 0.74, 0.44, 0.15, 0]],
            },
            {
                "height_mm": 0.5,
                "relative_illumination": [0.9, 0.88],
                "distortion_percent": -0.5,
                "values": [[1, 0.8, 0.6, 0.3, 0.1, 0], [1, 0.78, 0.56, 0.26, 0.08, 0]],
            },
            {
                "height_mm": 1.0,
                "relative_illumination": [0.7, 0.66],
                "distortion_percent": -2.0,
                "values": [[1, 0.6, 0.4, 0.2, 0.05, 0]],
            },
        ],
    },
}
FILE = Path("table.yaml")


@pytest.fixture(scope="module")
def bank():
    return read_mtf(TABLE, FILE)


def transfer(psf, pitch_um, frequency_cy_mm, angle_rad):
    """Return the transform of a PSF along a direction, by the sum that defines it."""
    at = (np.arange(len(psf)) - len(psf) // 2) * pitch_um
    along = at[None, :] * np.cos(angle_rad) + at[:, None] * np.sin(angle_rad)
    waves = np.exp(-2j * np.pi * 1e-3 * np.asarray(frequency_cy_mm)[:, None, None] * along)
    return (waves * psf.astype(float)).sum(axis=(1, 2))


@pytest.mark.parametrize("angle_deg", [0, 37, 90])
def test_the_table_comes_back_at_its_frequencies_in_every_direction(bank, angle_deg):
    steps = (len(bank.field_deg) - 1) // 2
    rows = [0, 0, 1]  # the blue band has two wavelengths
    for number, field in enumerate(TABLE["mtf"]["fields"]):
        for place, row in enumerate(rows):
            found = transfer(
                bank.psf[number * steps, place], bank.pitch_um, FREQUENCIES, np.radians(angle_deg)
            )
            values = np.array(field["values"][min(row, len(field["values"]) - 1)])
            # What the window misses has a transform of at most its own light, o: the rest is
            # (MTF - tail) / (1 - o).
            missed = abs(bank.outside_energy[number * steps, place])
            tolerance = missed * (1 + values) / (1 - missed) + 1e-6
            assert (np.abs(found.imag) < 1e-6).all()
            assert (np.abs(found.real - values) <= tolerance).all()
            # It is a check: 3 % of contrast are seen.
            assert (np.abs(found.real - 0.97 * values) > tolerance)[1:4].any()


def test_what_lies_between_the_table_and_the_bank(bank):
    assert bank.psf.shape[:2] == (15, 3)  # 2 x 7 intervals; 430, 490 and 600 nm
    np.testing.assert_array_equal(bank.wavelengths_nm, [430, 490, 600])
    assert bank.reference_nm == 600
    np.testing.assert_array_equal(bank.psf[:, 0], bank.psf[:, 1])
    np.testing.assert_allclose(bank.ideal_height_um, np.linspace(0, 1000, 15))
    # Cubic between fields, beyond the axis the same ones: at t = 3/7, with fields at -1, 0, 1, 2.
    t = 3 / 7
    around = t * (t - 1) * (t - 2) / -6 + t * (t + 1) * (t - 2) / -2
    shares = ((t + 1) * (t - 1) * (t - 2) / 2, around, t * (t + 1) * (t - 1) / 6)
    mixed = np.tensordot(shares, bank.psf[[0, 7, 14], 2].astype(float), axes=1)
    np.testing.assert_allclose(bank.psf[3, 2], mixed, atol=1e-8)  # f32 of 0.1
    # Light: the even polynomial through all.
    rows = [[1, 0, 0], [1, 1, 1], [1, 4, 16]]
    terms = np.linalg.solve(rows, bank.relative_illumination[[0, 7, 14], 2])
    assert bank.relative_illumination[3, 2] == pytest.approx(terms @ [1, t**2, t**4])
    np.testing.assert_allclose(bank.relative_illumination[7], [0.9, 0.9, 0.88])
    # Through the table, and with no lateral colour.
    np.testing.assert_allclose(bank.real_height_um[[7, 14]], [[497.5] * 3, [980.0] * 3])
    np.testing.assert_allclose(bank.distortion[[7, 14]], [-0.005, -0.02])
    np.testing.assert_array_equal(bank.transmission, [0.9, 0.9, 0.8])
    np.testing.assert_allclose(bank.projected_solid_angle_sr, np.pi / 8.2**2)
    assert np.isnan(bank.failed_rays).all() and np.isnan(bank.fit_residual_waves).all()
    assert "MTF only" in bank.provenance["lens_model"]
    np.testing.assert_allclose(bank.psf.sum(axis=(2, 3), dtype=float), 1, rtol=0, atol=1e-6)


def test_the_psf_of_the_closed_form_is_airys():
    """A perfect lens: its MTF, finely tabulated, gives (2 J1(v) / v)^2."""
    cutoff = 1 / (0.55 * 2.8)  # cycles/um
    v = np.linspace(0, 1, 400)
    mtf = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2))
    psf = round_psfs([Curve(cutoff * v, np.append(mtf[:-1], 0.0))], 0.5, 128)[0]
    at = np.hypot(*(np.indices((128, 128)) - 64)) * 0.5
    x = np.pi * cutoff * np.maximum(at, 1e-9)
    airy = np.pi / 4 * cutoff**2 * (2 * j1(x) / x) ** 2 * 0.25
    inside = at < 32
    # Monotone cubics over 400 intervals: h^2 / 12 times the curvature that they cut off, 1e-6, and
    # at the end the power 3/2 of the distance.
    np.testing.assert_allclose(psf[inside], airy[inside], rtol=0, atol=2e-5 * airy.max())
    assert (psf[~inside] == 0).all()


def test_between_frequencies_there_is_no_overshoot_and_beyond_them_a_straight_line():
    curve = Curve(np.array([0, 0.1, 0.2, 0.3]), np.array([1, 0.9, 0.5, 0.4]))
    f = np.linspace(0, 0.3, 301)
    assert (np.diff(curve(f)) < 0).all()
    np.testing.assert_allclose(curve(np.array([0, 0.1, 0.2, 0.3])), [1, 0.9, 0.5, 0.4])
    assert curve.end == pytest.approx(0.7)
    np.testing.assert_allclose(curve(np.array([0.5, 0.7, 2.0])), [0.2, 0, 0], atol=1e-12)
    ended = Curve(np.array([0, 0.1, 0.2, 0.3]), np.array([1, 0.4, 0, 0]))
    assert ended.end == pytest.approx(0.2)
    np.testing.assert_allclose(ended(np.array([0.2, 0.25, 0.3, 1])), 0, atol=1e-15)


def test_an_mtf_that_ends_abruptly_rings_and_is_kept():
    data = changed(TABLE, (("mtf", "frequencies_cy_mm"), [0, 100, 200, 300, 310]))
    for field in data["mtf"]["fields"]:
        field["values"] = [[1, 0.95, 0.9, 0.85, 0]]
    bank = read_mtf(data, FILE)
    assert bank.psf.min() < -1e-3 * bank.psf.max()
    found = transfer(bank.psf[0, 0], bank.pitch_um, [100, 200, 290], 0.3)
    assert (np.abs(found.real - [0.95, 0.9, 0.854]) < 0.02).all()


def test_a_fine_mtf_gets_a_fine_grid_and_a_wide_psf_a_wide_window():
    fine = changed(TABLE, (("mtf", "frequencies_cy_mm"), [4 * f for f in FREQUENCIES]))
    # 1600 cycles/mm: 2.5 samples a period.
    assert read_mtf(fine, FILE).pitch_um == pytest.approx(0.25)
    wide = changed(TABLE, (("mtf", "frequencies_cy_mm"), [f / 3 for f in FREQUENCIES]))
    bank = read_mtf(wide, FILE)
    assert bank.psf.shape[-1] == 512
    assert np.abs(bank.outside_energy).max() < 0.05


VALUES = ("mtf", "fields", 1, "values")


@pytest.mark.parametrize(
    ("where", "value", "words"),
    [
        (("efl_mm",), ..., ["efl_mm", "missing", "a field is missing"]),
        (("transmission",), ..., ["transmission", "missing"]),
        (("working_f_number",), ..., ["working_f_number", "missing"]),
        (("mtf", "fields", 1, "relative_illumination"), ..., ["mtf.fields.2", "missing"]),
        (("mtf", "frequencies_cy_mm"), [0, 50, 100, 100, 300, 400], ["must rise from 0"]),
        (("mtf", "frequencies_cy_mm"), [10, 50, 100, 200, 300, 400], ["must rise from 0"]),
        (("mtf", "frequencies_cy_mm"), [0, 50, 100, 200], ["6 values for 4 frequencies"]),
        (VALUES, [[0.98, 0.8, 0.6, 0.3, 0.1, 0]], ["field 2", "frequency 0 is 1, not 0.98"]),
        (VALUES, [[1, 0.8, -0.1, 0.3, 0.1, 0]], ["field 2", "0 to 1.05", "-0.1"]),
        (VALUES, [[1, 1.06, 0.6, 0.3, 0.1, 0]], ["0 to 1.05", "1.06"]),
        (VALUES, [[1, 0.8, 0.6, 0.3, 0.1, 0.1]], ["ends at 0.1 without falling"]),
        (VALUES, [[1, 0.8, 0.6, 0.3, 0.1, 0]] * 3, ["3 rows of values for 2"]),
        (VALUES, [[1, 0.8, float("nan"), 0.3, 0.1, 0]], ["values", "finite"]),
        (VALUES, "none", ["values"]),
        (("mtf", "fields", 0, "height_mm"), 0.1, ["height_mm must rise from 0"]),
        (("mtf", "fields", 2, "height_mm"), 0.5, ["height_mm must rise from 0"]),
        (("mtf", "fields", 2, "distortion_percent"), -60, ["real_height_um", "rising"]),
        (("mtf", "fields", 2, "relative_illumination"), [1, 1, 1], ["fields.3", "3 numbers"]),
        (("mtf", "fields", 0, "relative_illumination"), 0.9, ["1 on the axis"]),
        (("wavelengths_nm",), [[430, 490], [490, 600]], ["wavelengths_nm must rise", "gap"]),
        (("transmission",), 1.2, ["transmission", "up to 1"]),
        (("colour",), "blue", ["colour", "unknown field"]),
    ],
)  # fmt: skip
def test_what_is_no_table_is_refused_by_name(where, value, words):
    with pytest.raises(UserError) as caught:
        read_mtf(changed(TABLE, (where, value)), FILE)
    for word in [*words, "table.yaml"]:
        assert word in caught.value.screen()


def test_light_that_no_window_holds_is_refused():
    values = [[1, 0.5, 0.45, 0.4, 0.2, 0]]
    data = changed(TABLE, (("mtf", "frequencies_cy_mm"), [0, 1, 100, 200, 300, 400]))
    for field in data["mtf"]["fields"]:
        field["values"] = values
    with pytest.raises(UserError, match="of the light lie") as caught:
        read_mtf(data, FILE)
    assert "veiling glare" in caught.value.screen()
    data = changed(TABLE, (VALUES, [[1, 0.8, 0.6, 0.3, 0.3, 0.2999]]))
    with pytest.raises(UserError, match="light does not resolve"):
        read_mtf(data, FILE)


def test_every_preset_is_the_lens_that_it_says():
    assert "diffraction-limited" in mtf_presets()
    for name, file in mtf_presets().items():
        lens = load_ready(name)
        assert lens.title and lens.source
        bank = lens.bank()
        text = file.read_text(encoding="utf-8")
        assert "no lens was measured for it" in " ".join(text.split())
        data = yaml.safe_load(text)
        f_number = data["f_number"]
        frequency = np.array(data["mtf"]["frequencies_cy_mm"], float)
        for row, wavelength in zip(
            data["mtf"]["fields"][0]["values"], data["wavelengths_nm"], strict=True
        ):
            v = np.minimum(frequency * wavelength * 1e-6 * f_number, 1)
            exact = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2))
            np.testing.assert_allclose(row, exact, rtol=0, atol=5.1e-5)  # four digits
        light = np.cos(np.arctan(bank.ideal_height_um[::4] / 8000)) ** 4
        np.testing.assert_allclose(bank.relative_illumination[::4, 0], light, atol=5.1e-5)
