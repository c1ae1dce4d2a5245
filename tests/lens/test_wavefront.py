"""Wavefront and pupil: against rays traced anew, another program, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from lens.made import disc_samples, lens, model
from scipy.interpolate import RegularGridInterpolator

from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription, presets
from gpusim.lens.launch import Launch
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build, first_order, indices
from gpusim.lens.trace import trace
from gpusim.lens.wavefront import best_focus_shift, half_plane_share, pupils, within_hull

GREEN = np.array([550.0])
# rayoptics 0.9.8: stop x, stop y (mm) and OPD (waves at 550 nm, its sign turned) of single rays of
# the double Gauss at f = 8.3 mm, f/2.8, image at the paraxial d-line focus, reference sphere
# through the exit pupil.
RAYOPTICS = {
    0.0: [
        (0.0, -0.9369699673, -0.2936213207),
        (0.1044791012, 0.3134373035, -0.01399499673),
        (0.3132432891, -0.4176577188, -0.05147997501),
        (0.5202722622, -0.8324356195, -0.3314823850),
        (0.6244886397, 0.7285700797, -0.3126991196),
        (0.9364284178, 0.3121428059, -0.3361199349),
    ],
    14.0: [
        (0.0, -0.9560998062, 0.6680087484),
        (0.1038146024, 0.3091096842, -0.03838337500),
        (0.3145862396, -0.4209012779, -0.05552061991),
        (0.5264564413, -0.8502347305, 0.6079950257),
        (0.6169565216, 0.7061353146, -0.004090230642),
        (0.9299446476, 0.2967575923, -0.2707831008),
    ],
}


@pytest.mark.parametrize("field", RAYOPTICS)
def test_opd_agrees_with_rayoptics(double_gauss, field):
    # Ours is Debye's (a sphere of infinite radius); a radius R to the exit pupil adds
    # R - sqrt(R^2 - p^2 + (p . d)^2) for a ray that lands at p with direction d.
    system = build(double_gauss.scaled(8.3).stopped(2.8).model_copy(update={"focus": "paraxial"}))
    index = system.index(GREEN)
    stop_x, stop_y, expected = np.array(RAYOPTICS[field]).T
    rays = sample_rays(system, index, np.radians(field), stop_x, stop_y)
    chief = sample_rays(system, index, np.radians(field), np.zeros(1), np.zeros(1))
    pupil_z = system.geometry.vertex_z[-1] + first_order(double_gauss.scaled(8.3)).exit_pupil_z_mm
    radius = (system.image_z_mm - pupil_z) / np.sqrt(1 - chief.beta[0, 0] ** 2)
    p2 = rays.landing_x_mm**2 + rays.landing_y_mm**2
    along = rays.landing_x_mm * rays.alpha + rays.landing_y_mm * rays.beta
    opd = rays.opd_mm + radius - np.sqrt(radius**2 - p2 + along**2)
    # On axis the radius is the same; at 14 deg the other program ends its sphere at the real exit
    # pupil: 3 % of R changes the correction, 0.03 waves, by 1e-3.
    np.testing.assert_allclose(opd[0] / 550e-6, expected, rtol=0, atol=1e-3 if field else 2e-5)


@pytest.mark.parametrize("name", presets())
def test_fitted_wavefront_meets_rays_that_took_no_part_in_the_fit(name):
    system = build(load_prescription(name))
    fields = np.radians([0.0, 0.7 * system.prescription.max_field_deg])
    wavelengths = np.array([450.0, 650.0])
    index = system.index(wavelengths)
    rng = np.random.default_rng(1)
    for theta in fields:
        grids = pupils(sample_field(system, index, theta), wavelengths, 64.0, 512)
        r = system.stop_radius_mm * np.sqrt(rng.uniform(0, 1, 200))
        phi = rng.uniform(0, 2 * np.pi, 200)
        rays = sample_rays(system, index, theta, r * np.cos(phi), r * np.sin(phi))
        for line, pupil in enumerate(grids):
            clear = rays.inside[line]
            assert clear.sum() > 20
            i = np.rint(rays.alpha[line] / (pupil.alpha[1] - pupil.alpha[0]) - 0.5).astype(int)
            i = np.clip(i, 0, len(pupil.alpha) - 1)
            step_b = pupil.beta[1] - pupil.beta[0]
            j = np.rint((rays.beta[line] - pupil.beta[0]) / step_b).astype(int)
            i, j = i[clear], j[clear]
            # From the ray to the nearest node by the mean of the slopes at both: what is left is
            # of third order in half a step.
            slope_a, slope_b = np.gradient(pupil.opd_mm, pupil.alpha, pupil.beta)
            da = pupil.alpha[i] - rays.alpha[line][clear]
            db = pupil.beta[j] - rays.beta[line][clear]
            at_node = (
                rays.opd_mm[line][clear]
                + 0.5 * (slope_a[i, j] - rays.landing_x_mm[line][clear]) * da
                + 0.5 * (slope_b[i, j] - rays.landing_y_mm[line][clear]) * db
            )
            waves = (pupil.opd_mm[i, j] - at_node) / (wavelengths[line] * 1e-6)
            # The requirement; the piston is no error.
            assert np.std(waves) < 1e-3


@pytest.mark.parametrize("name", presets())
def test_the_grid_reaches_beyond_the_pupil_and_the_fit_is_good(name):
    system = build(load_prescription(name).scaled(8.3))
    index = system.index(GREEN)
    for field in np.linspace(0, system.prescription.max_field_deg, 4):
        (pupil,) = pupils(sample_field(system, index, np.radians(field)), GREEN, 64.0, 128)
        assert pupil.coverage.max() == pytest.approx(1, abs=1e-12)
        assert not pupil.coverage[-1].any()
        assert not pupil.coverage[:, [0, -1]].any()
        assert pupil.fit_residual_mm < 1e-4 * 550e-6


def test_rays_land_where_the_slope_of_the_wavefront_says(demo_lens):
    system = build(demo_lens)
    index = system.index(GREEN)
    theta = np.radians(14.0)
    samples = sample_field(system, index, theta)
    (pupil,) = pupils(samples, GREEN, 64.0, 1024)
    inside = samples.inside[0] & (samples.alpha[0] > pupil.alpha[1])
    at = np.column_stack([samples.alpha[0][inside], samples.beta[0][inside]])
    slopes = np.gradient(pupil.opd_mm, pupil.alpha, pupil.beta)
    for slope, landing in zip(slopes, (samples.landing_x_mm, samples.landing_y_mm), strict=True):
        found = RegularGridInterpolator((pupil.alpha, pupil.beta), slope)(at)
        # Central differences and bilinear interpolation: 0.3 step^2 of the third derivative of W,
        # which is below 15 mm: 0.3 (4e-4)^2 15 mm = 7e-7 mm.
        np.testing.assert_allclose(found, -landing[0][inside], rtol=0, atol=1e-6)
        assert np.ptp(landing[0][inside]) > 5e-3


def test_nothing_counts_beyond_the_rays_that_were_traced():
    # Rays in a half disc of radius 1; polynomials fitted there mean nothing at 1.1.
    samples = disc_samples(1.0)
    disc = np.hypot(samples.alpha[0], samples.beta[0]) <= 1
    a, b = np.linspace(0.01, 1.2, 60), np.linspace(-1.2, 1.2, 121)
    within = within_hull(samples.alpha[0][disc], samples.beta[0][disc], a, b)
    radius = np.hypot(a[:, None], b[None])
    # The rays' spacing is 0.026: chords of their hull pass at cos(0.1) or so.
    assert within[radius < 0.95].all()
    assert not within[radius > 1].any()


def test_half_plane_share_is_the_area():
    rng = np.random.default_rng(2)
    u = (np.arange(400) + 0.5) / 400 - 0.5
    for _ in range(20):
        a, b, h = rng.normal(size=3)
        counted = (a * u[:, None] + b * u[None] < h).mean()
        # A line crosses at most 800 of the 160000 sub-cells, each counted wrong by half at most.
        assert half_plane_share(h, a, b) == pytest.approx(counted, abs=2.5e-3)
    np.testing.assert_allclose(half_plane_share(np.array([-0.6, 0, 0.25, 0.6]), 1, 0),
                               [0, 0.5, 0.75, 1], rtol=0, atol=1e-9)  # fmt: skip


def test_solid_angle_on_axis_is_pi_sin_squared(demo_lens):
    system = build(demo_lens)
    index = system.index(GREEN)
    radius = np.array([system.stop_radius_mm])
    rim = sample_rays(system, index, 0.0, np.zeros(1), radius)
    (pupil,) = pupils(sample_field(system, index, 0.0), GREEN, 64.0, 512)
    # Straight edges in place of arcs: cell^2 / (24 r) of the rim's length 2 pi r per cell width:
    # (1 / 228)^2 / 12 = 2e-6 of the area; measured 3.0e-6.
    assert pupil.projected_solid_angle_sr == pytest.approx(np.pi * rim.beta[0, 0] ** 2, rel=4e-6)


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0])
def test_illumination_falls_as_the_view_factor_and_cos4_of_a_distant_pupil(angle):
    # A disc of radius a at distance 1, seen from a point off its axis: its projected solid angle is
    # pi F with the closed form of F (Howell, catalogue of view factors); for small a it is
    # pi a^2 cos^4.
    a, h = 0.05, np.tan(np.radians(angle))
    u, v = np.meshgrid(np.linspace(0, 1.04, 41), np.linspace(-1.04, 1.04, 81))
    keep = u * u + v * v <= 1.04**2
    x, y = a * u[keep], a * v[keep]
    length = np.sqrt(x**2 + (h - y) ** 2 + 1)
    samples = disc_samples(a)
    samples = replace(
        samples,
        chief_direction=np.zeros((1, 2)),
        alpha=(x / length)[None],
        beta=((h - y) / length)[None],
        margin=((x**2 + y**2) / a**2 - 1)[None, None],
    )
    (pupil,) = pupils(samples, GREEN, 1.0, 512)
    inner = 1 + h * h - a * a
    view_factor = 0.5 * (1 - inner / np.sqrt((1 + h * h + a * a) ** 2 - 4 * a * a * h * h))
    exact = np.pi * view_factor
    assert pupil.projected_solid_angle_sr == pytest.approx(exact, rel=5e-6)  # rim, as above
    # The next term of the series is of order a^2 = 2.5e-3.
    assert exact == pytest.approx(np.pi * a**2 * np.cos(np.radians(angle)) ** 4, rel=5e-3)


def test_clear_apertures_vignette(demo_lens):
    def illumination(prescription):
        system = build(prescription)
        index = system.index(GREEN)
        angles = []
        for theta in (0.0, np.radians(14.3)):
            samples = sample_field(system, index, theta)
            angles.append(pupils(samples, GREEN, 64.0, 256)[0].projected_solid_angle_sr)
        return angles[1] / angles[0]

    def resized(factor):
        surfaces = tuple(
            s.model_copy(update={"semi_diameter": s.semi_diameter and s.semi_diameter * factor})
            for s in demo_lens.surfaces
        )
        return demo_lens.model_copy(update={"surfaces": surfaces})

    free, given, tight = (illumination(resized(f)) for f in (1.5, 1.0, 0.85))
    assert tight < given < free
    # 1.5 times the glass clips nothing: what is left is the fall-off of a lens, near cos^4 of the
    # angle in image space.
    assert 0.8 < free < 0.95


def test_a_stop_before_the_lens_gives_barrel_and_behind_it_pincushion_distortion():
    front = [
        {"radius": np.inf, "thickness": 10.0},
        {"radius": np.inf, "thickness": 3.0, **model(1.5)},
        {"radius": -25.0},
    ]
    behind = [
        {"radius": 25.0, "thickness": 3.0, **model(1.5)},
        {"radius": np.inf, "thickness": 10.0},
        {"radius": np.inf},
    ]
    for rows, stop, sign in ((front, 1, -1), (behind, 3, 1)):
        system = build(lens(rows, stop=stop, f_number=20.0, max_field_deg=15.0))
        theta = np.radians(15.0)
        chief = sample_rays(system, system.index(GREEN), theta, np.zeros(1), np.zeros(1))
        ideal = first_order(system.prescription, 550.0).efl_mm * np.tan(theta)
        distortion = chief.chief_y_mm[0] / ideal - 1
        assert sign * distortion > 0.01


def test_best_focus_is_stationary_and_lies_between_paraxial_and_marginal_focus():
    rows = [{"radius": np.inf, "thickness": 4.0, **model(1.5)}, {"radius": -25.0}]
    paraxial = build(lens(rows, f_number=5.0))
    lines = np.array(paraxial.prescription.design_wavelengths_nm)
    best = build(lens(rows, f_number=5.0, focus="best"))
    rim = np.full((1, 1), 5.0)
    axis = Launch(0.0, np.zeros((3, 1)))
    rays = trace(paraxial.geometry, indices(paraxial.prescription, lines[:1]), axis, 0 * rim, rim)
    marginal_z = rays.point[2] - rays.point[1] * rays.direction[2] / rays.direction[1]
    assert float(marginal_z[0, 0]) < best.image_z_mm < paraxial.image_z_mm
    # Linear in the shift, so a second step from the best focus is nothing but rounding.
    assert abs(best_focus_shift(best, lines)) < 1e-10
    spread = []
    for system in (paraxial, best):
        (pupil,) = pupils(sample_field(system, system.index(lines[1:2]), 0.0), lines[1:2], 1.0, 256)
        mean = np.average(pupil.opd_mm, weights=pupil.coverage)
        spread.append(np.average((pupil.opd_mm - mean) ** 2, weights=pupil.coverage) ** 0.5)
    # Third-order spherical aberration: W20 = -W40 cuts the RMS to a quarter (Mahajan 1982). Here
    # the fifth order is 3 % of the third and the glass disperses a little.
    assert spread[1] == pytest.approx(spread[0] / 4, rel=0.05)


def test_a_field_that_is_wholly_vignetted_is_an_error(demo_lens):
    surfaces = list(demo_lens.surfaces)
    for i in (0, -1):
        surfaces[i] = surfaces[i].model_copy(update={"semi_diameter": 0.2})
    system = build(demo_lens.model_copy(update={"surfaces": tuple(surfaces)}))
    with pytest.raises(UserError, match="no light passes"):
        sample_field(system, system.index(GREEN), np.radians(14.0))
