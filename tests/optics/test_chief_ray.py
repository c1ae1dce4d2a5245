"""The chief-ray splines: against the tracer, against the bank's map, and against their twins."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from harness import assert_close
from optics.made import bank, plane_bank
from sampling import one_in

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.projection import ANGULAR, RECTILINEAR
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import System, build, first_order
from gpusim.optics.chief_ray import FIT_ERROR_UM, LANDINGS, black_share, chief_ray_map, radial_map
from gpusim.psf.bank import Bank
from gpusim.psf.chief_rays import MIDDLE, MISS_UM, ChiefRays, between_fields
from gpusim.psf.field_bank import seen_as
from gpusim.psf.field_map import FieldMap, ideal_height_um
from gpusim.psf.sampling import WAVELENGTHS_NM, default_fields_deg
from gpusim.reference.chief_ray import chief_ray as twin
from gpusim.reference.fields import Heights
from gpusim.sensor.load import load_sensor

LENSES = (
    *("compact-6mm", "cooke-triplet", "double-gauss", "fisheye", "phone", "telephoto", "tessar"),
    "wide",
)
# What the map may miss of the tracer, and FIT_ERROR_UM of its spline; 1e-3 between the wavelengths.
MAP_UM = 2e-3


def landed_um(system: System, wavelengths_nm: np.ndarray, angles_deg: np.ndarray) -> np.ndarray:
    """Return where chief rays land (F, L)."""
    index = system.index(np.asarray(wavelengths_nm, float))
    return np.stack(
        [
            1e3 * sample_rays(system, index, np.radians(angle), MIDDLE, MIDDLE).chief_y_mm
            for angle in angles_deg
        ]
    )


@lru_cache(maxsize=2)
def lens_of(name: str) -> tuple[System, Bank]:
    """Return a lens and the chief rays of its bank, without PSFs worth the name."""
    prescription = load_prescription(name)
    system, lines = build(prescription), np.array(WAVELENGTHS_NM, float)
    efl_mm = first_order(prescription, 550.0).efl_mm
    angles = default_fields_deg(prescription)
    real = landed_um(system, lines, angles)
    rays_deg, rays_um = between_fields(ChiefRays(system, lines), angles, real, 1e3 * efl_mm)
    table = np.zeros(real.shape)
    made = replace(
        bank(),
        wavelengths_nm=lines,
        reference_nm=550.0,
        field_deg=angles,
        ideal_height_um=ideal_height_um(efl_mm, angles),
        real_height_um=real,
        psf=np.full((*real.shape, 2, 2), 0.25, np.float32),
        relative_illumination=table + 1,
        outside_energy=table,
        folded_energy=table,
        efl_mm=efl_mm,
        ray_deg=rays_deg,
        ray_um=rays_um,
    )
    return system, made


@pytest.mark.parametrize("name", one_in(2, LENSES))
def test_the_map_of_every_lens_is_that_of_the_tracer(name: str):
    """At angles and wavelengths that are no nodes; to the rim, and in both projections."""
    system, lens = lens_of(name)
    largest = lens.field_deg[-1]
    angles = largest * np.sort(np.random.default_rng(5).uniform(0, 1, 20))
    angles = np.append(angles, largest * (1 - 1e-9))
    real = landed_um(system, [550.0], angles)[:, 0]
    for projection in (RECTILINEAR, ANGULAR):
        chief_ray = chief_ray_map(seen_as(lens, projection))
        inside = angles < projection.end_deg
        assert chief_ray.radius_um == pytest.approx(real[inside][-1], rel=0.05)
        ideal = chief_ray.ideal_um(np.stack([0.6 * real, 0.8 * real], axis=-1))
        wanted = 1e3 * lens.efl_mm * projection.height(np.radians(angles))
        # Back on the real plane, by the map's slope there.
        step = 1e-6
        slope = landed_um(system, [550.0], np.degrees(step) + angles[inside])[:, 0] - real[inside]
        slope /= (
            1e3
            * lens.efl_mm
            * np.array([step * projection.slope(np.radians(angle)) for angle in angles[inside]])
        )
        off_um = (np.hypot(*ideal[inside].T) - wanted[inside]) * slope
        assert np.abs(off_um).max() < MAP_UM + FIT_ERROR_UM, angles[np.abs(off_um).argmax()]
        assert chief_ray.error_um <= FIT_ERROR_UM
        # As a table of 32 bits that the shaders see, by its float64 twin.
        table = chief_ray.terms(1.0).astype(float)
        seen = twin(np.stack([real, 0 * real], axis=-1), table, chief_ray.radius_um)[0][..., 0]
        off_um = (seen[inside] - wanted[inside]) * slope
        assert np.abs(off_um).max() < MAP_UM + FIT_ERROR_UM
    between = [412.3, 437.0, 488.8, 561.9, 689.1]
    for wavelength, exact in zip(between, landed_um(system, between, angles).T, strict=True):
        found, _ = lens.height_from_angle(angles, wavelength)
        assert np.abs(found - exact).max() < MAP_UM, wavelength


def test_without_rays_between_the_fields_the_phone_lens_misses_the_tracer():
    """The control: it is these that make the map, and a wrong one of them is seen."""
    system, lens = lens_of("phone")
    few = replace(lens, ray_deg=None, ray_um=None)
    wrong = lens.ray_um.copy()
    wrong[len(wrong) // 2 :] += 0.05
    angles = np.linspace(0.5, 36.9, 40)
    exact = landed_um(system, [550.0], angles)[:, 0]
    for planted in (few, replace(lens, ray_um=wrong)):
        assert np.abs(planted.height_from_angle(angles)[0] - exact).max() > 2 * MAP_UM


def test_rays_are_added_until_their_map_meets_the_next():
    """R = f (tan + a wave of its own): fields 6 deg apart follow one of 200 deg, not one of 20."""
    angles = np.linspace(0, 30, 6)
    for period_deg, halved in ((200.0, 1), (20.0, 3)):

        def height(theta: np.ndarray, period_deg: float = period_deg) -> np.ndarray:
            wave = np.sin(2 * np.pi * np.degrees(theta) / period_deg)
            return 1e3 * (np.tan(theta) + 0.01 * wave)

        class Traced:
            @staticmethod
            def index(lines):
                return lines

        def lands(system, index, theta, x, y, height=height):
            ray = type("Ray", (), {})()
            ray.chief_y_mm = 1e-3 * height(np.array([theta]))
            ray.chief_direction = np.array([[0.0, np.sin(theta)]])
            return ray

        with pytest.MonkeyPatch.context() as patched:
            patched.setattr("gpusim.psf.chief_rays.sample_rays", lands)
            given = height(np.radians(angles))[:, None]
            rays = ChiefRays(Traced, [550.0])
            rays_deg, rays_um = between_fields(rays, angles, given, 1e3)
            moved_deg, moved_um = between_fields(rays, angles, given, 1e3, 40.0)
        assert len(rays_deg) == 5 * 2**halved + 1
        assert set(angles.round(9)) <= set(rays_deg.round(9))
        assert_close(rays_um[:, 0], height(np.radians(rays_deg)), atol=1e-9)
        chief = FieldMap(np.radians(rays_deg), rays_um[:, 0], 1e3)
        fine = np.linspace(0, np.pi / 6, 999)
        assert np.abs(chief.height_um(fine) - height(fine)).max() < MISS_UM / 20
        # The image plane moved away: places move along each ray. The fields' own are the caller's.
        new = np.flatnonzero(~np.isin(moved_deg.round(9), angles.round(9)))
        slope = np.tan(np.radians(moved_deg[new]))
        assert_close(moved_um[new, 0] - height(np.radians(moved_deg[new])), 40 * slope, atol=1e-9)


@pytest.mark.parametrize("distortion", [0.0, -0.02, 0.05])
def test_it_leads_from_the_real_to_the_ideal_plane(distortion: float):
    lens = bank(fields=12, distortion=distortion)
    chief_ray = chief_ray_map(lens)
    assert chief_ray.radius_um == lens.image_circle_um
    real = np.random.default_rng(1).uniform(0, lens.image_circle_um, 500)
    ideal = chief_ray.ideal_um(np.stack([real, 0 * real], axis=-1))[:, 0]
    assert_close(lens.real_from_ideal(ideal)[0], real, atol=FIT_ERROR_UM)


@pytest.mark.parametrize("name", [*LENSES, "without an axis"])
def test_it_leads_back_to_the_real_plane(name: str):
    """As closely as heights lie between which it is interpolated; points beyond stay beyond."""
    lens = plane_bank(distortion=-0.2) if name == "without an axis" else lens_of(name)[1]
    found = chief_ray_map(lens)
    rng = np.random.default_rng(4)
    height, turn = 0.98 * np.sqrt(rng.random(200)), 2 * np.pi * rng.random(200)
    real = np.stack([np.cos(turn), np.sin(turn)], axis=1) * (found.radius_um * height)[:, None]
    real += found.centre_um
    step = found.radius_um / (LANDINGS - 1)
    assert_close(found.real_um(found.ideal_um(real)), real, atol=step)
    beyond = found.real_um(found.ideal_um(1.5 * (real[height > 0.8] - found.centre_um)))
    assert np.hypot(*(beyond - found.centre_um).T).min() > found.radius_um - step


def test_near_a_fold_it_takes_more_pieces_and_follows():
    """Real r (1 - 0.3 r^2), whose slope falls to a tenth at the rim."""
    ideal = np.linspace(0, 1, 4001)

    def ideal_um(real_um: np.ndarray) -> np.ndarray:
        return 150 * np.interp(real_um / 150, ideal * (1 - 0.3 * ideal**2), ideal)

    smooth = np.polynomial.Polynomial([0, 1, 0, -0.3])

    def exact_um(real_um: np.ndarray) -> np.ndarray:
        found = ideal_um(real_um) / 150
        for _ in range(8):
            found = found - (smooth(found) - real_um / 150) / smooth.deriv()(found)
        return 150 * found

    found = radial_map(exact_um, 105.0)
    assert 16 < len(found.pieces) <= 512 and found.error_um <= FIT_ERROR_UM
    real = np.linspace(0, 105, 777)
    off = found.ideal_um(np.stack([real, 0 * real], axis=-1))[:, 0] - exact_um(real)
    slope = smooth.deriv()(exact_um(real) / 150)
    assert np.abs(off * slope).max() < 1.5 * FIT_ERROR_UM
    assert found.stretch == pytest.approx(10, rel=0.01)


def test_the_shaders_get_it_in_sim_samples():
    chief_ray = chief_ray_map(bank())
    params = chief_ray.params(0.5)
    assert_close(chief_ray.terms(0.5).ravel(), chief_ray.pieces.astype(np.float32).ravel(), atol=0)
    assert params["pieces"] == len(chief_ray.pieces)
    samples = chief_ray.radius_um / 0.5
    assert params["inverse_radius2"] == pytest.approx(1 / samples**2, rel=1e-12)


def test_of_a_lens_without_an_axis_the_shaders_get_a_net_over_both_coordinates():
    lens = plane_bank(keystone=(0.06, 0.02), boresight_um=(5.0, -3.0))
    chief_ray = chief_ray_map(lens)
    net = lens.plane_map.net
    params, terms = chief_ray.params(0.5), chief_ray.terms(0.5)
    assert_close(terms[:, :2].reshape(net.shape), (net / 0.5).astype(np.float32), atol=0)
    assert params["pieces"] == len(net) - 3
    assert_close(np.array(params["circle"]), np.array([10.0, -6.0]), atol=1e-9)
    samples = lens.image_circle_um / 0.5
    assert params["inverse_radius2"] == pytest.approx(1 / samples**2, rel=1e-12)
    # The host's map is that of the twin.
    real = np.random.default_rng(1).uniform(-90, 90, (300, 2))
    found = chief_ray.ideal_um(real)
    expected, jacobian = twin(real, net, chief_ray.radius_um, chief_ray.centre_um)
    assert_close(found, expected, atol=1e-9)
    # A double Jacobian's largest stretch, at these points and everywhere.
    norms = np.linalg.norm(jacobian, ord=2, axis=(1, 2))
    assert norms.max() <= chief_ray.stretch < 1.2 * norms.max()
    least = np.linalg.norm(jacobian, ord=-2, axis=(1, 2)).min()
    assert least / 1.2 < chief_ray.least_stretch <= least
    assert_close(
        chief_ray.stretch_within(np.zeros(2), np.ones(2)), np.full(2, chief_ray.stretch), atol=0
    )


def test_of_a_lens_with_an_axis_the_host_has_the_same_stretch_as_the_twin():
    chief_ray = chief_ray_map(bank(fields=12, distortion=-0.05))
    real = np.random.default_rng(2).uniform(-110, 110, (3000, 2))
    _, jacobian = twin(real, chief_ray.pieces, chief_ray.radius_um)
    norms = np.linalg.norm(jacobian, ord=2, axis=(1, 2))
    assert norms.max() <= chief_ray.stretch * (1 + 1e-9) and chief_ray.stretch < 1.05 * norms.max()
    least = np.linalg.norm(jacobian, ord=-2, axis=(1, 2)).min()
    assert least / 1.05 < chief_ray.least_stretch <= least * (1 + 1e-9)
    # The stretch within a ring is at least its largest, and at most that of a little wider ring.
    radius = np.hypot(*real.T)
    for low, high in ((0.0, 20.0), (30.0, 31.0), (100.0, 900.0), (200.0, 300.0)):
        found = float(chief_ray.stretch_within(np.array([low]), np.array([high]))[0])
        ring = norms[(radius >= low) & (radius <= high)]
        assert ring.max(initial=0.0) <= found * (1 + 1e-9)
        assert found <= chief_ray.stretch_within(np.array([0.9 * low]), np.array([1.1 * high]))[0]
    assert chief_ray.stretch_within(np.zeros(1), np.full(1, 20.0)) < 0.8 * chief_ray.stretch + 0.2


def test_the_certificates_map_is_the_engines(monkeypatch: pytest.MonkeyPatch):
    """Two splines of the bank's map, one in height squared and one in height; also if angular."""
    lens = bank(fields=12, distortion=-0.05)
    real = np.random.default_rng(3).uniform(-110, 110, (500, 2))
    for projection in (RECTILINEAR, ANGULAR):
        one = seen_as(lens, projection)
        lit = np.hypot(*real.T) < one.image_circle_um
        engine, truth = chief_ray_map(one).ideal_um(real), Heights(one).ideal(real)
        assert_close(engine[lit], truth[lit], atol=1.2 * FIT_ERROR_UM)


def test_the_share_of_black_pixels_is_counted():
    sensor = load_sensor("imx477").roi(60, 80)
    row, col = np.indices((60, 80))
    pitch = sensor.pixel_pitch_um
    for centre, radius in (((0.0, 0.0), 40.0), ((7.0, -3.0), 55.0), ((0.0, 0.0), 1e3)):
        x, y = (col + 0.5 - 40) * pitch - centre[0], (row + 0.5 - 30) * pitch - centre[1]
        assert black_share(sensor, centre, radius) == pytest.approx(
            np.mean(np.hypot(x, y) > radius)
        )
