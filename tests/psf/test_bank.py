"""The bank keeps its contract, its file keeps the bank, and the cache keeps the file."""

import dataclasses
import itertools

import numpy as np
import pytest
import xarray
from lens.made import fisheye
from optics.made import bank as made_bank

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.projection import ANGULAR
from gpusim.lens.samples import sample_rays
from gpusim.lens.surface import Coating
from gpusim.lens.system import build, first_order, indices, transmission
from gpusim.psf import compute
from gpusim.psf.bank import Bank
from gpusim.psf.compute import cached_bank, compute_bank
from gpusim.psf.field_bank import seen_as
from gpusim.psf.sampling import default_fields_deg
from gpusim.psf.store import from_cache

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


def test_fields_of_a_wide_lens_are_even_in_angle_and_others_in_its_tangent(demo_lens):
    np.testing.assert_allclose(default_fields_deg(fisheye(), 8), np.arange(8) * 15.0)
    at_50 = default_fields_deg(demo_lens.model_copy(update={"max_field_deg": 50.0}), 3)
    assert np.tan(np.radians(at_50[1])) == pytest.approx(np.tan(np.radians(50)) / 2)


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


def test_distortion_of_a_fisheye_is_reported_against_f_theta(fisheye_bank):
    real = fisheye_bank.real_height_um[:, fisheye_bank.reference]
    f_theta = 1e3 * fisheye_bank.efl_mm * np.radians(fisheye_bank.field_deg)
    np.testing.assert_allclose((1 + fisheye_bank.distortion_f_theta) * f_theta, real, rtol=1e-12)
    assert fisheye_bank.distortion_f_theta[0] == 0
    assert -0.2 < fisheye_bank.distortion_f_theta[-1] < 0


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


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """Give an empty cache, and a count of the banks computed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    computed = []

    def counted(*args, **kwargs):
        computed.append(args)
        return compute_bank(*args, **kwargs)

    monkeypatch.setattr(compute, "compute_bank", counted)
    return tmp_path / "gpusim" / "banks", computed


TINY = {"wavelengths_nm": [550.0], "field_deg": [0.0, 10.0], "size": 32}


def test_the_second_call_finds_the_bank_in_the_cache(cache, demo_lens):
    folder, computed = cache
    first = cached_bank(demo_lens, **TINY)
    second = cached_bank(demo_lens, **TINY)
    assert len(computed) == 1
    np.testing.assert_array_equal(first.psf, second.psf)
    assert len(list(folder.iterdir())) == 1


def test_another_lens_or_setting_is_another_bank(cache, demo_lens):
    folder, computed = cache
    cached_bank(demo_lens, **TINY)
    cached_bank(demo_lens, **TINY | {"size": 34})
    cached_bank(demo_lens.stopped(4.0), **TINY)
    cached_bank(demo_lens.model_copy(update={"gaussian_apodisation": 0.5}), **TINY)
    surfaces = list(demo_lens.surfaces)
    surfaces[3] = surfaces[3].model_copy(update={"glass": "SCHOTT/N-SF15"})
    cached_bank(demo_lens.model_copy(update={"surfaces": tuple(surfaces)}), **TINY)
    assert len(computed) == 5
    assert len(list(folder.iterdir())) == 5


@pytest.mark.parametrize("damage", ["garbage", "truncated", "empty", "foreign"])
def test_a_corrupt_cache_file_is_computed_again(cache, demo_lens, damage):
    folder, computed = cache
    cached_bank(demo_lens, **TINY)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if damage == "foreign":
        xarray.Dataset({"other": 1}).to_netcdf(file, engine="h5netcdf")
    else:
        file.write_bytes({"garbage": b"x" * 5000, "truncated": whole[:9000], "empty": b""}[damage])
    again = cached_bank(demo_lens, **TINY)
    assert len(computed) == 2
    np.testing.assert_array_equal(again.psf, Bank.load(file).psf)


def test_one_bit_that_flips_in_a_cached_file_is_noticed(cache, demo_lens):
    """Wherever the data lie: each flip gives a file that is not loaded, or loads what was saved."""
    folder, computed = cache
    sound = cached_bank(demo_lens, **TINY)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    at = whole.index(sound.psf[1, 0, 16].tobytes()) + 4 * 16  # the PSF's middle
    flipped = bytearray(whole)
    flipped[at + 2] ^= 0x40
    file.write_bytes(flipped)
    with pytest.raises(ValueError, match="not those that were saved"):
        Bank.load(file)
    again = cached_bank(demo_lens, **TINY)
    assert len(computed) == 2
    np.testing.assert_array_equal(again.psf, sound.psf)
    np.testing.assert_array_equal(Bank.load(file).psf, sound.psf)
    refused = 0
    random = np.random.default_rng(3)
    for place in random.integers(len(whole), size=20):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << random.integers(8)
        file.write_bytes(flipped)
        try:
            found = Bank.load(file)
        except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError):
            refused += 1
            continue
        for name in (*Bank.table.variables, *Bank.table.optional):
            np.testing.assert_array_equal(getattr(found, name), getattr(sound, name))
    # Nearly all of the file are data.
    assert refused >= 15


def test_a_cache_that_cannot_be_written_is_said_and_does_no_harm(cache, demo_lens):
    folder, _ = cache
    folder.parent.write_text("a file where the folder should be")
    bank = cached_bank(demo_lens, **TINY)
    assert bank.provenance["cache"].startswith("not written")


def test_progress_counts_up_to_the_number_of_fields(demo_lens):
    calls = []
    compute_bank(demo_lens, **TINY, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(1, 2), (2, 2)]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"reference_nm": 555.0}, ["reference_nm", "555"]),
        ({"field_deg": [0.0, 20.0]}, ["beyond the lens", "0 to 14.3"]),
        ({"field_deg": [5.0, 10.0]}, ["rise from 0"]),
        ({"field_deg": [0.0]}, ["rise from 0"]),
        ({"wavelengths_nm": [550.0, 450.0]}, ["wavelengths must rise"]),
        ({"wavelengths_nm": [300.0, 550.0]}, ["300 nm", "outside the data", "N-BAF10"]),
        ({"pitch_um": 1.5}, ["too coarse", "1.5", "<= "]),
        ({"size": 33}, ["even", "33"]),
    ],
)
def test_settings_that_make_no_bank_are_refused(demo_lens, settings, words):
    with pytest.raises(UserError) as caught:
        compute_bank(demo_lens, **TINY | settings)
    for word in words:
        assert word in caught.value.screen()


def test_a_damaged_file_of_the_cache_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    whole, computed = made_bank(size=16), []

    def compute(prescription, progress=None):
        computed.append(1)
        return whole

    lens = load_prescription("double-gauss")
    from_cache(Bank, compute, lens, {})
    (file,) = tmp_path.rglob("*.nc")
    content = file.read_bytes()
    rng = np.random.default_rng(17)
    damages = [content[:100], b"", content[: len(content) // 2], content + content]
    for _ in range(10):  # 16 bytes anywhere: header, groups, names, data
        at = int(rng.integers(0, len(content) - 16))
        damages.append(content[:at] + rng.bytes(16) + content[at + 16 :])
    for damaged in damages:
        file.write_bytes(damaged)
        for _ in range(2):
            found = from_cache(Bank, compute, lens, {})
            np.testing.assert_array_equal(found.psf, whole.psf)
            np.testing.assert_array_equal(found.real_height_um, whole.real_height_um)
            assert found.provenance == whole.provenance
    # Once for each damage that counts: not fatal, nor for ever.
    assert 8 < len(computed) <= 1 + len(damages)
