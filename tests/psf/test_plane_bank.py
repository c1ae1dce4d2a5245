"""A bank over the field plane: what a centred lens must show, and what a moved element does."""

import dataclasses

import numpy as np
import pytest
import xarray
from harness import assert_close
from lens.made import lens, model
from optics.made import at_lines

from gpusim.camera import Camera
from gpusim.errors import UserError
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build, first_order
from gpusim.lens.wavefront import pupils
from gpusim.optics.chief_ray import black_share
from gpusim.optics.images import field_images
from gpusim.optics.kernels import field_kernels
from gpusim.optics.sampling import sampled_kernels
from gpusim.psf import chief_rays, compute_plane
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.psf.plane_map import FIT_ERROR_UM
from gpusim.psf.psf import intensity
from gpusim.psf.sampling import default_sides_deg
from gpusim.sensor.load import load_sensor

GREEN = np.array([550.0])
SMALL = {"wavelengths_nm": [500.0, 550.0], "size": 64, "pitch_um": 0.7}
SIDES = {"field_x_deg": [-3.0, 0.0, 3.0], "field_y_deg": [-3.0, 0.0, 3.0]}


def coma_lens(**fields):
    """Return a singlet behind its stop, f = 19 mm: astigmatism and coma off the axis."""
    rows = [
        {"radius": np.inf, "thickness": 1.0},
        {"radius": 20.0, "thickness": 2.0, **model(1.5)},
        {"radius": -20.0},
    ]
    return lens(rows, **{"f_number": 8.0, "max_field_deg": 6.0, "focus": "best"} | fields)


def moved():
    return coma_lens().with_element_moved(2, 3, decentre_mm=(0.2, 0.1), tilt_deg=(2.0, -3.0))


@pytest.fixture(scope="module")
def bank():
    return compute_plane_bank(moved(), **SMALL, **SIDES)


@pytest.mark.parametrize("apodisation", [0.0, 1.0])
def test_a_whole_pupil_gives_the_same_psf_as_its_half(apodisation):
    system = build(coma_lens(gaussian_apodisation=apodisation))
    index = system.index(GREEN)
    theta = np.radians(5.0)
    half = sample_field(system, index, theta)
    turned = sample_field(system, index, theta, np.pi / 2)  # the field along x
    assert half.half
    assert not turned.half
    (one,) = pupils(half, GREEN, 64.0, 512)
    (other,) = pupils(turned, GREEN, 64.0, 512)
    # The same rays, turned by 90 deg, on another grid: rims are cut to 3e-6 (test_wavefront).
    assert other.entered == pytest.approx(one.entered, rel=1e-5)
    assert other.projected_solid_angle_sr == pytest.approx(one.projected_solid_angle_sr, rel=1e-5)
    radial, outside = intensity(one, 550.0, 128, 0.5)
    along_x, outside_x = intensity(other, 550.0, 128, 0.5)
    # Rows x, columns y; radial is x now, and -eta is y: the PSF is symmetric in eta.
    assert np.abs(along_x[1:, 1:] - radial.T[1:, 1:]).max() < 1e-4 * radial.max()
    assert np.abs(radial[1:, 1:] - radial[1:, :0:-1]).max() > 0.03 * radial.max()
    assert outside_x == pytest.approx(outside, abs=1e-5)
    assert turned.chief_x_mm[0] == pytest.approx(half.chief_y_mm[0], abs=1e-9)
    assert turned.chief_y_mm[0] == pytest.approx(0, abs=1e-9)


def test_a_centred_lens_has_the_same_bank_in_every_direction():
    bank = compute_plane_bank(coma_lens(), **SMALL, **SIDES)
    np.testing.assert_allclose(bank.chief_x_um, np.swapaxes(bank.chief_y_um, 0, 1), atol=1e-5)
    np.testing.assert_allclose(bank.chief_x_um, -bank.chief_x_um[:, ::-1], atol=1e-5)
    assert bank.chief_x_um[1, 2, 0] > 800  # f tan(3 deg) = 1 mm, to x > 0
    psf = bank.psf
    peak = psf.max()
    # Along x, along y and along the diagonals: mirror images (rows y, columns x).
    for one, two in (
        (psf[1, 2], np.swapaxes(psf[2, 1], 1, 2)),
        (psf[1, 0][..., 1:], psf[1, 2][..., :0:-1]),
        (psf[0, 2][:, 1:], psf[2, 2][:, :0:-1]),
        (psf[2, 2], np.swapaxes(psf[2, 2], 1, 2)),
    ):
        assert np.abs(one - two).max() < 4e-3 * peak  # 256 nodes are good to 1.9e-3 for each
    assert bank.fit_residual_waves.max() < 1e-3
    np.testing.assert_allclose(bank.relative_illumination[1, 1], 1, rtol=1e-12)


def test_a_moved_element_changes_the_bank_as_its_mirror_image_says(bank):
    mirrored = coma_lens().with_element_moved(2, 3, decentre_mm=(-0.2, 0.1), tilt_deg=(2.0, 3.0))
    other = compute_plane_bank(mirrored, **SMALL, **SIDES)
    np.testing.assert_allclose(bank.chief_x_um, -other.chief_x_um[:, ::-1], atol=1e-5)
    np.testing.assert_allclose(bank.chief_y_um, other.chief_y_um[:, ::-1], atol=1e-5)
    peak = bank.psf.max()
    difference = bank.psf[..., 1:] - other.psf[:, ::-1, :, :, :0:-1]
    # Where the grid ends hangs on the outermost ray; 256 nodes are good to 1.9e-3 for each.
    assert np.abs(difference).max() < 4e-3 * peak
    assert np.abs(bank.psf - other.psf).max() > 0.03 * peak
    # Parallel light follows the rear nodal point, efl before the focus: it is moved by the
    # decentre, and by the tilt about the vertex of surface 2. Aberrations move the chief ray a bit.
    order = first_order(coma_lens())
    arm_um = 1e3 * (order.length_mm - 1.0 + order.bfl_mm - order.efl_mm)
    x_um, y_um = 200 - arm_um * np.sin(np.radians(3)), 100 - arm_um * np.sin(np.radians(2))
    assert bank.chief_x_um[1, 1, 0] == pytest.approx(x_um, abs=3)
    assert bank.chief_y_um[1, 1, 0] == pytest.approx(y_um, abs=3)


def test_an_apodised_stop_is_apodised_behind_a_moved_element_too(bank):
    filtered = moved().model_copy(update={"gaussian_apodisation": 1.0})
    other = compute_plane_bank(filtered, **SMALL, **SIDES)
    # The stop comes first and the light through it is even: the filter passes this of it, but for
    # the sine condition, which the singlet breaks by 2 %.
    share = other.projected_solid_angle_sr / bank.projected_solid_angle_sr
    np.testing.assert_allclose(share, (1 - np.exp(-2)) / 2, rtol=0.03)
    # A share (1 - 1/e) of the amplitude is left at the peak. That is squared, over that share of
    # the light. With the aberrations of the rim darkened it is a little more.
    kept = (1 - np.exp(-1)) ** 2 / share[1]
    peak, even = (one.psf[1, 1, 1].max() for one in (other, bank))
    assert kept < peak / even < 1.1 * kept
    assert "exp(-1 rho^2)" in other.provenance["pupil"]


def test_the_psf_lies_where_the_spot_diagram_says(bank):
    system = build(moved())
    for j, i in ((1, 1), (0, 1), (1, 0)):
        x, y = SIDES["field_x_deg"][i], SIDES["field_y_deg"][j]
        samples = sample_field(
            system, system.index(GREEN), np.radians(np.hypot(x, y)), np.arctan2(x, y)
        )
        (pupil,) = pupils(samples, GREEN, 128.0, 256)
        psf = bank.psf[j, i, 1].astype(float)
        psf /= psf.sum()
        at = (np.arange(64) - 32) * bank.pitch_um
        slope = -np.array(np.gradient(1e3 * pupil.opd_mm, pupil.alpha, pupil.beta))
        mean = np.average(slope.reshape(2, -1), axis=1, weights=pupil.coverage.ravel())
        # The tails that the window cuts at 22 um: three quarters of them may be on one side.
        tolerance = 11 * bank.outside_energy[j, i, 1]
        assert tolerance < 0.7
        assert (psf.sum(axis=0) @ at) == pytest.approx(mean[0], abs=tolerance)
        assert (psf.sum(axis=1) @ at) == pytest.approx(mean[1], abs=tolerance)
        land = 1e3 * np.array([samples.landing_x_mm[0], samples.landing_y_mm[0]])
        far = land[:, samples.inside[0]][:, np.hypot(*land[:, samples.inside[0]]).argmax()]
        assert far @ mean > 0
        assert np.hypot(*mean) > 3 * tolerance


def test_default_sides_hold_the_axis_and_reach_the_largest_field():
    sides = default_sides_deg(coma_lens())
    assert len(sides) == 9
    assert sides[4] == 0
    assert sides[-1] == -sides[0] == 6.0
    np.testing.assert_allclose(np.diff(sides, 2), 0, atol=1e-14)


def test_a_plane_bank_survives_its_file(bank, tmp_path):
    path = tmp_path / "plane.nc"
    bank.save(path)
    again = PlaneBank.load(path)
    stored = PlaneBank.table.names | {"provenance"}
    # The projection is the scene's, and wavelengths are always joined by cubics.
    others = {"projection", "spectral_degree"}
    assert {field.name for field in dataclasses.fields(PlaneBank)} == stored | others
    for name in stored - {"provenance"}:
        np.testing.assert_array_equal(getattr(again, name), getattr(bank, name))
    assert again.provenance == bank.provenance
    assert list(tmp_path.iterdir()) == [path]
    with xarray.open_dataset(path, engine="h5netcdf") as data:
        for name in data.variables:
            assert data[name].attrs["units"], name
            assert "tilted by 2, -3 deg" in data[name].attrs["provenance"], name
        assert data["psf"].dims == ("field_y", "field_x", "wavelength", "y", "x")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"field_x_deg": [1.0, 3.0]}, ["field_x_deg", "hold 0"]),
        ({"field_y_deg": [3.0, 0.0]}, ["field_y_deg", "rise"]),
        ({"field_y_deg": [0.0]}, ["field_y_deg", "at least two"]),
        ({"field_y_deg": [-6.5, 0.0, 3.0]}, ["beyond the lens", "field_y_deg", "6.5", "0 to 6"]),
        ({"reference_nm": 555.0}, ["reference_nm", "500, 550"]),
        ({"size": 33}, ["even", "33"]),
        ({"pitch_um": 3.0}, ["too coarse"]),
    ],
)
def test_settings_that_make_no_plane_bank_are_refused(settings, words):
    with pytest.raises(UserError) as caught:
        compute_plane_bank(moved(), **SMALL | SIDES | settings)
    for word in words:
        assert word in caught.value.screen()


# What the chain asks of it, against rays


def plate_lens(tilt_deg: float):
    """Return a lens with a plate of glass behind it, tilted about x."""
    rows = [
        {"radius": np.inf, "thickness": 1.0},
        {"radius": 20.0, "thickness": 2.0, **model(1.5)},
        {"radius": -20.0, "thickness": 3.0},
        {"radius": np.inf, "thickness": 5.0, **model(1.5)},
        {"radius": np.inf, "thickness": 12.0},
    ]
    one = lens(rows, f_number=8.0, max_field_deg=6.0, focus="as-given")
    return one.with_element_moved(4, 5, tilt_deg=(tilt_deg, 0.0)) if tilt_deg else one


def test_a_tilted_plate_stretches_one_side_of_the_image_as_the_closed_form_says():
    """A plate shifts a ray by t sin(i - i') / cos(i') across itself (Smith, Modern Optical Eng.).

    The chief rays of the two sides meet it at different angles: the image is stretched on one side
    and squeezed on the other.
    """
    tilt = 25.0
    settings = {"wavelengths_nm": [550.0], "size": 32, "pitch_um": 0.7}
    sides = {"field_x_deg": [-4.0, 0.0, 4.0], "field_y_deg": [-4.0, 0.0, 4.0]}
    still, moved = (compute_plane_bank(plate_lens(t), **settings, **sides) for t in (0.0, tilt))
    system = build(plate_lens(0.0))
    n = float(system.index(GREEN)[4, 0])

    def across_um(y_deg: float, angle: float) -> float:
        """Return by how much the plate moves a chief ray of the y-z plane along y."""
        none = np.zeros(1)
        rays = sample_rays(system, system.index(GREEN), np.radians(y_deg), none, none)
        slope = np.arcsin(float(rays.beta[0, 0]))
        met = slope + angle  # ax > 0 turns the normal towards -y
        inner = np.arcsin(np.sin(met) / n)
        return -5e3 * np.sin(met - inner) / np.cos(inner) / np.cos(slope)

    for row, y_deg in enumerate(sides["field_y_deg"]):
        expected = across_um(y_deg, np.radians(tilt)) - across_um(y_deg, 0.0)
        found = moved.chief_y_um[row, 1, 0] - still.chief_y_um[row, 1, 0]
        assert found == pytest.approx(expected, abs=1e-3)  # the ray is aimed to 1e-9 of the stop
    below, middle, above = moved.chief_y_um[:, 1, 0]
    assert abs((above - middle) - (middle - below)) > 1.0
    # And so does the map; its direction is that of the rays.
    y = np.array([below, middle, above])
    _, v, inside = moved.ideal_points(moved.chief_x_um[:, 1, 0], y)
    f_um = 1e3 * moved.efl_mm
    assert inside[1]
    assert v[inside] == pytest.approx(f_um * np.tan(np.radians([-4.0, 0.0, 4.0]))[inside], abs=2e-3)


def test_fields_on_one_side_only_make_no_map():
    bank = compute_plane_bank(moved(), [550.0], [0.0, 3.0], [-3.0, 0.0], size=32, pitch_um=0.7)
    assert bank.image_circle_um == 0
    with pytest.raises(UserError, match="on both sides of the axis"):
        _ = bank.plane_map


def test_the_map_meets_chief_rays_that_took_no_part_in_the_fit(bank):
    system = build(moved())
    rng = np.random.default_rng(4)
    none = np.zeros(1)
    for _ in range(12):
        theta, azimuth = np.radians(2.9 * np.sqrt(rng.uniform())), rng.uniform(0, 2 * np.pi)
        rays = sample_rays(system, system.index(GREEN), theta, none, none, azimuth=azimuth)
        x, y = 1e3 * rays.chief_x_mm, 1e3 * rays.chief_y_mm
        u, v, inside = bank.ideal_points(x, y)
        assert inside.all()
        height = 1e3 * bank.efl_mm * np.tan(theta)
        assert u[0] == pytest.approx(height * np.sin(azimuth), abs=1.5 * FIT_ERROR_UM)
        assert v[0] == pytest.approx(height * np.cos(azimuth), abs=1.5 * FIT_ERROR_UM)


def test_a_decentred_lens_flares_where_its_rays_land(bank):
    """The kernel of the chain on the axis: its centre of gravity is that of the spot diagram."""
    images, places = field_images(bank, at_lines(bank, np.array([[[0.0, 1.0]]])), 1e9)
    kernels = field_kernels(images, places, bank.pitch_um, 0.7, np.ones(images.shape[-2:]))
    kernel = sampled_kernels(kernels, *bank.centre_um, 0.7, 32, planes=1)[0, 0]
    y, x = (np.indices(kernel.shape) - 32) * 0.7
    found = np.array([(x * kernel).sum(), (y * kernel).sum()]) / kernel.sum()
    system = build(moved())
    samples = sample_field(system, system.index(GREEN), 0.0)
    (pupil,) = pupils(samples, GREEN, 128.0, 256)
    slope = -np.array(np.gradient(1e3 * pupil.opd_mm, pupil.alpha, pupil.beta))
    mean = np.average(slope.reshape(2, -1), axis=1, weights=pupil.coverage.ravel())
    assert np.abs(mean).min() > 0.5
    # Tails beyond the window's 22 um may be on one side: as above.
    assert_close(found, mean, atol=11 * bank.outside_energy[1, 1, 1] + 0.02)


def test_distortion_that_folds_the_image_is_refused(monkeypatch):
    real = chief_rays.sample_rays

    def folding(system, index, theta, x, y, *, azimuth):
        found = real(system, index, theta, x, y, azimuth=azimuth)
        stretch = 1 - 0.5 * (np.degrees(theta) / 2.5) ** 2  # r (1 - r^2 / 2) turns back at 0.82
        return dataclasses.replace(
            found, chief_x_mm=found.chief_x_mm * stretch, chief_y_mm=found.chief_y_mm * stretch
        )

    monkeypatch.setattr(chief_rays, "sample_rays", folding)
    with pytest.raises(UserError, match="folds the image over") as caught:
        compute_plane_bank(coma_lens(), **SMALL, **SIDES)
    assert float(caught.value.allowed.split()[2]) < 2.5 * 0.82


def test_a_camera_takes_a_moved_lens_and_keeps_its_bank(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    computed = []

    def small(prescription, *, progress):
        computed.append(progress)
        return compute_plane_bank(prescription, **SMALL, **SIDES, progress=progress)

    monkeypatch.setattr(compute_plane, "compute_plane_bank", small)
    seen = []
    sensor = load_sensor("imx477").roi(640, 480)
    camera = Camera(moved(), sensor, "moved")
    first = camera.bank(lambda *step: seen.append(step))
    again = camera.bank()
    assert isinstance(first, PlaneBank) and len(computed) == 1 and seen[-1] == (9, 9)
    np.testing.assert_array_equal(again.psf, first.psf)
    assert again.provenance == first.provenance
    other = Camera(moved().defocused(5.0), sensor, "moved")
    other.bank()
    assert len(computed) == 2
    # The circle lies off the centre: a sensor that it would hold is missed by it.
    half_um = first.image_circle_um / 2**0.5
    side = int(2 * half_um / 1.55) - 2
    missed = load_sensor("imx477").roi(side, side)
    assert black_share(missed, (0.0, 0.0), first.image_circle_um) == 0
    assert black_share(missed, first.centre_um, first.image_circle_um) > 0
