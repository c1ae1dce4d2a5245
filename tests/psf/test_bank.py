"""The bank keeps its contract, and its file keeps the bank."""

import dataclasses
import itertools

import numpy as np
import pytest
import xarray
from lens.made import fisheye

from gpusim.errors import UserError
from gpusim.lens.projection import ANGULAR
from gpusim.lens.samples import sample_rays
from gpusim.lens.surface import Coating
from gpusim.lens.system import build, first_order, indices, transmission
from gpusim.psf.bank import Bank
from gpusim.psf.compute import compute_bank
from gpusim.psf.field_bank import seen_as
from gpusim.psf.sampling import default_fields_deg

SMALL = {"wavelengths_nm": [450.0, 550.0, 650.0], "size": 64}


@pytest.fixture(scope="module")
def bank(demo_lens):
    return compute_bank(demo_lens, field_deg=default_fields_deg(demo_lens, 5), **SMALL)


def test_the_demonstration_bank_covers_its_sensor(demo_lens):
    # 2028 x 1520 pixels of 1.55 um have a half diagonal of 1964 um.
    edge = compute_bank(demo_lens, [550.0], [0.0, demo_lens.max_field_deg], size=32)
    assert edge.image_circle_um > 2050


def test_shapes_units_and_signs_are_those_of_the_contract(bank, demo_lens):
    assert bank.psf.shape == (5, 3, 64, 64)
    assert bank.psf.dtype == np.float32
    assert bank.field_deg[0] == 0
    assert bank.field_deg[-1] == demo_lens.max_field_deg
    # Evenly spaced in f tan(theta).
    np.testing.assert_allclose(np.diff(bank.ideal_height_um, 2), 0, atol=1e-9)
    assert bank.efl_mm == first_order(demo_lens, 550.0).efl_mm
    # float32 samples, 4096 of them: each rounded by 6e-8 of itself.
    held = bank.psf.sum(axis=(2, 3), dtype=float)
    np.testing.assert_allclose(held + bank.outside_energy, 1, rtol=0, atol=1e-7)
    assert bank.halo.shape == (3, 5, 3, 128, 128) and bank.halo.dtype == np.float32
    np.testing.assert_array_equal(bank.halo_pitch_um, bank.pitch_um * np.array([8, 64, 512]))
    levels = sum(level.psf.sum(axis=(2, 3), dtype=float) for level in bank.levels)
    np.testing.assert_allclose(levels + bank.beyond_energy, 1, rtol=0, atol=1e-6)
    assert (bank.psf >= 0).all()
    at = np.arange(64) - 32
    assert not bank.psf[..., np.hypot(at[:, None], at) >= 32].any()
    assert bank.psf[..., 32, 1].all()
    assert (np.diff(bank.real_height_um, axis=0) > 0).all()
    np.testing.assert_array_equal(bank.real_height_um[0], 0)
    np.testing.assert_array_equal(bank.relative_illumination[0], 1)
    assert (np.diff(bank.relative_illumination, axis=0) < 0).all()
    # f/2.8, corrected for the sine condition: pi / (2 N)^2, within the 1.5 % that the lens misses.
    np.testing.assert_allclose(bank.projected_solid_angle_sr, np.pi / (2 * 2.8) ** 2, rtol=0.015)
    assert bank.fit_residual_waves.max() < 1e-3
    assert bank.failed_rays.max() == 0
    assert bank.folded_energy.max() == 0
    # Airy's pattern leaves 2 / (pi^2 16 um / (lambda N)) of its light outside 16 um.
    assert 0.01 < bank.outside_energy[0, 1] < 0.025


def test_transmission_is_fresnels_for_uncoated_surfaces(bank, demo_lens):
    index = build(demo_lens).index(np.array([550.0]))[:, 0]
    expected = 1.0
    for n1, n2 in itertools.pairwise(index):
        expected *= 4 * n1 * n2 / (n1 + n2) ** 2
    assert bank.transmission[1] == pytest.approx(expected, rel=1e-13)
    assert 0.55 < expected < 0.62  # eight glass-air surfaces of 5 to 7 % each


def test_an_apodised_stop_dims_the_bank_and_is_said(demo_lens, bank):
    apodised = demo_lens.model_copy(update={"gaussian_apodisation": 1.0})
    found = compute_bank(apodised, bank.wavelengths_nm, bank.field_deg, size=64)
    # Even in direction cosines on the axis, where the lens meets the sine condition to 1.5 %.
    share = found.projected_solid_angle_sr / bank.projected_solid_angle_sr
    np.testing.assert_allclose(share, (1 - np.exp(-2)) / 2, rtol=0.015)
    # Vignetting takes the dim rim first: less is lost off the axis.
    np.testing.assert_array_equal(found.relative_illumination[0], 1)
    assert (found.relative_illumination[-1] > 1.01 * bank.relative_illumination[-1]).all()
    assert "exp(-1 rho^2)" in found.provenance["pupil"]
    assert "rho" not in bank.provenance["pupil"]


def test_a_coating_is_on_every_surface_between_glass_and_air_and_only_there(demo_lens):
    # The double Gauss: 8 surfaces between glass and air, a diaphragm in air, 2 cemented surfaces.
    coating = Coating(wavelength_nm=[400.0, 500.0, 700.0], reflectance=[0.02, 0.004, 0.01])
    coated = demo_lens.model_copy(update={"coating": coating})
    index = indices(demo_lens, [550.0])[:, 0]
    cemented = 1.0
    for surface in (4, 8):
        n1, n2 = index[surface - 1], index[surface]
        assert min(n1, n2) > 1.5
        cemented *= 4 * n1 * n2 / (n1 + n2) ** 2
    # Straight between 500 and 700 nm.
    expected = cemented * (1 - 0.0055) ** 8
    assert transmission(coated, [550.0])[0] == pytest.approx(expected, rel=1e-13)
    bank = compute_bank(coated, [550.0], [0.0, 5.0], size=32)
    assert bank.transmission[0] == pytest.approx(expected, rel=1e-13)
    assert "coating" in bank.provenance["transmission"]
    with pytest.raises(UserError, match="no reflectance at 710 nm"):
        transmission(coated, [710.0])


def test_chief_ray_map_meets_real_chief_rays_between_the_nodes(demo_lens):
    fields = default_fields_deg(demo_lens)
    bank = compute_bank(demo_lens, [550.0], fields, size=32)
    system = build(demo_lens)
    index = system.index(np.array([550.0]))
    for angle in (0.7, 4.4, 9.9, 14.0):
        theta = np.radians(angle)
        ray = sample_rays(system, index, theta, np.zeros(1), np.zeros(1))
        ideal = 1e3 * bank.efl_mm * np.tan(theta)
        real, inside = bank.real_from_ideal(ideal)
        assert inside
        # The distortion is 10 um over 2 mm, smooth; measured below 1e-6 um.
        assert real == pytest.approx(1e3 * ray.chief_y_mm[0], abs=1e-4)


def test_ideal_and_real_heights_are_inverse_and_flag_the_image_circle(bank):
    r = np.linspace(0, 1.2 * bank.ideal_height_um[-1], 101)
    real, inside = bank.real_from_ideal(r)
    back, inside_too = bank.ideal_from_real(real)
    np.testing.assert_allclose(back, r, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(inside, r <= bank.ideal_height_um[-1])
    np.testing.assert_array_equal(inside, inside_too)
    assert (np.diff(real) > 0).all()
    np.testing.assert_allclose(
        bank.real_from_ideal(bank.ideal_height_um)[0],
        bank.real_height_um[:, bank.reference],
        rtol=0,
        atol=1e-9,
    )


@pytest.fixture(scope="module")
def fisheye_bank():
    return compute_bank(
        fisheye(), [500.0, 550.0], default_fields_deg(fisheye(), 9), size=32, pitch_um=1.0
    )


@pytest.mark.parametrize("wavelength", [500.0, 530.0, 550.0])
def test_a_fisheye_has_a_chief_ray_map_to_its_edge_and_back(fisheye_bank, wavelength):
    theta = np.linspace(0, 130, 261)
    height, inside = fisheye_bank.height_from_angle(theta, wavelength)
    np.testing.assert_array_equal(inside, theta <= 105)
    assert (np.diff(height) > 0).all()
    back, inside_too = fisheye_bank.angle_from_height(height, wavelength)
    # 1e-9 um over the slope at the edge, 1200 um per rad.
    np.testing.assert_allclose(back, theta, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(inside, inside_too)
    system = build(fisheye())
    index = system.index(np.array([500.0, 550.0]))
    for degrees in (40.0, 77.0, 97.0):
        rays = sample_rays(system, index, np.radians(degrees), np.zeros(1), np.zeros(1))
        share = (1 / 500 - 1 / wavelength) / (1 / 500 - 1 / 550)  # straight in 1 / lambda
        chief_um = 1e3 * (rays.chief_y_mm @ [1 - share, share])
        # Nine fields, 13 deg apart; measured 0.035 um at 97 deg.
        assert fisheye_bank.height_from_angle(degrees, wavelength)[0] == pytest.approx(
            chief_um, abs=0.05
        )
    assert abs(np.ptp(rays.chief_y_mm)) > 1e-4  # lateral colour: the wavelengths differ


def test_a_fisheye_has_an_ideal_plane_below_85_deg_only(fisheye_bank):
    assert np.isinf(fisheye_bank.ideal_height_um[fisheye_bank.field_deg > 90]).all()
    assert (fisheye_bank.distortion[fisheye_bank.field_deg > 90] == -1).all()
    real_85 = fisheye_bank.height_from_angle(85.0)[0]
    assert fisheye_bank.rectilinear_circle_um == pytest.approx(real_85, rel=1e-12)
    assert fisheye_bank.image_circle_um > 1.15 * real_85
    f_um = 1e3 * fisheye_bank.efl_mm
    ideal = f_um * np.tan(np.radians([0.0, 30.0, 60.0, 84.9, 85.1]))
    real, inside = fisheye_bank.real_from_ideal(ideal)
    np.testing.assert_array_equal(inside, [True] * 4 + [False])
    np.testing.assert_allclose(
        real[:4], fisheye_bank.height_from_angle([0.0, 30.0, 60.0, 84.9])[0], rtol=1e-12
    )
    back, inside_too = fisheye_bank.ideal_from_real(real)
    np.testing.assert_allclose(back, ideal, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(inside, inside_too)


def test_a_wavelength_beyond_the_bank_has_no_chief_rays(bank):
    with pytest.raises(UserError, match="no chief rays") as caught:
        bank.height_from_angle(3.0, 660.0)
    assert "450 to 650" in caught.value.screen()


def test_a_fisheye_has_an_angular_plane_to_its_edge(fisheye_bank):
    angular = seen_as(fisheye_bank, ANGULAR)
    assert angular.rectilinear_circle_um == angular.image_circle_um == fisheye_bank.image_circle_um
    f_um = 1e3 * angular.efl_mm
    ideal = f_um * np.radians([0.0, 30.0, 84.9, 104.9, 105.1])
    real, inside = angular.real_from_ideal(ideal)
    np.testing.assert_array_equal(inside, [True] * 4 + [False])
    np.testing.assert_allclose(
        real[:4], fisheye_bank.height_from_angle([0.0, 30.0, 84.9, 104.9])[0], rtol=1e-12
    )
    np.testing.assert_allclose(angular.ideal_from_real(real)[0], ideal, rtol=1e-9, atol=1e-9)
    # Below the end of the flat plane both have the same field at a point, at other places.
    flat = fisheye_bank.ideal_from_real(real[:3])[0]
    np.testing.assert_allclose(np.arctan(flat / f_um), ideal[:3] / f_um, rtol=1e-9, atol=1e-12)
    assert seen_as(angular, ANGULAR) is angular


def test_psf_of_the_axis_is_symmetric_and_that_of_the_corner_is_not(bank):
    axis, corner = bank.psf[0, 1], bank.psf[-1, 1]
    np.testing.assert_allclose(axis, axis.T, rtol=0, atol=1e-6)
    assert np.abs(corner[1:, 1:] - corner[1:, :0:-1]).max() > 1e-3
    np.testing.assert_allclose(corner[1:], corner[:0:-1], rtol=0, atol=1e-9)


def test_a_bank_survives_its_file(bank, tmp_path):
    path = tmp_path / "bank.nc"
    bank.save(path)
    again = Bank.load(path)
    for name in Bank.table.names:
        np.testing.assert_array_equal(getattr(again, name), getattr(bank, name))
        assert np.asarray(getattr(again, name)).dtype == np.asarray(getattr(bank, name)).dtype
    assert again.provenance == bank.provenance
    for level, same in zip(bank.levels, again.levels, strict=True):
        np.testing.assert_array_equal(level.psf, same.psf)
        assert level.pitch_um == same.pitch_um
    assert list(tmp_path.iterdir()) == [path]


def test_the_file_holds_every_field_of_the_bank():
    # The projection is the scene's.
    assert {field.name for field in dataclasses.fields(Bank)} == (
        Bank.table.names | {"provenance", "projection"}
    )


def test_a_file_says_how_wavelengths_are_joined_and_older_ones_are_cubic(bank, tmp_path):
    dataclasses.replace(bank, spectral_degree=1).save(tmp_path / "straight.nc")
    assert Bank.load(tmp_path / "straight.nc").spectral_degree == 1
    bank.to_xarray().drop_vars("spectral_degree").to_netcdf(
        tmp_path / "older.nc", engine="h5netcdf"
    )
    assert Bank.load(tmp_path / "older.nc").spectral_degree == 3


def test_every_variable_in_the_file_has_units_and_provenance(bank, tmp_path):
    bank.save(tmp_path / "bank.nc")
    with xarray.open_dataset(tmp_path / "bank.nc", engine="h5netcdf") as data:
        for name in data.variables:
            assert data[name].attrs["units"], name
            assert "Double Gauss" in data[name].attrs["provenance"], name
        assert data.attrs["patent"] == "US 2,673,491"
        assert "stop closed to f/2.8" in data.attrs["history"]
        np.testing.assert_allclose(data["xi"][32], 0)
