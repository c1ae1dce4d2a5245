"""Ray fans, spots, wavefront maps and angles: against one another and against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lens.made import lens, model
from lens.rays import oval
from scipy.interpolate import CubicSpline

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.analysis.fields import Field, design_lines, main_fields
from gpusim.lens.analysis.rays import (
    airy_radius_um,
    arrival,
    hexapolar,
    ray_fan,
    spot_diagram,
    wavefront_map,
)
from gpusim.lens.analysis.zernike import fit
from gpusim.lens.system import System, build

GREEN = np.array([550.0])
AXIS = Field("axis", 0.0)


@pytest.fixture(scope="module")
def gauss() -> System:
    return build(load_prescription("double-gauss").scaled(8.3).stopped(2.8))


@pytest.fixture(scope="module")
def tilted() -> System:
    rows = [
        {"radius": 30.0, "thickness": 3.0, **model(1.6), "tilt_deg": [1.0, 2.0]},
        {"radius": -60.0},
    ]
    return build(lens(rows))


@pytest.mark.parametrize("way", ["x", "y"])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_ray_fan_is_the_slope_of_the_opd_fan(gauss: System, number: int, way: str):
    lines, primary = design_lines(gauss)
    fan = ray_fan(gauss, lines, primary, main_fields(gauss)[number], way)
    cosine, landing = (fan.alpha, fan.x_um) if way == "x" else (fan.beta, fan.y_um)
    for line, wavelength in enumerate(lines):
        lit = np.isfinite(cosine[line])
        order = np.argsort(cosine[line][lit])
        at, opd_um = (
            values[line][lit][order] * unit
            for values, unit in ((cosine, 1), (fan.opd_waves, 1e-3 * wavelength))
        )
        # OPD ahead of the sphere: transverse = +dW/d(direction cosine), on a sphere of no end.
        # Along x the other cosine changes too, by the sagittal coma's share.
        other = fan.beta if way == "x" else fan.alpha
        cross = (fan.y_um if way == "x" else fan.x_um)[line][lit][order]
        slope = CubicSpline(at, opd_um)(at, 1)
        turn = CubicSpline(at, other[line][lit][order])(at, 1)
        np.testing.assert_allclose(
            slope[3:-3],
            (landing[line][lit][order] + cross * turn)[3:-3],
            rtol=0,
            atol=2e-3 * np.abs(landing[line][lit]).max() + 1e-4,
        )


def test_lateral_colour_lifts_the_fans_of_other_wavelengths(gauss: System):
    lines, primary = design_lines(gauss)
    field = main_fields(gauss)[2]
    fan = ray_fan(gauss, lines, primary, field, "y")
    middle = fan.y_um[:, len(fan.stop) // 2]
    alone = [ray_fan(gauss, lines[[k]], 0, field, "y").opd_waves[0] for k in range(len(lines))]
    assert middle[primary] == pytest.approx(0, abs=1e-6)  # as rays are aimed
    assert np.abs(middle).max() > 0.3
    np.testing.assert_allclose(fan.opd_waves[primary], alone[primary], atol=1e-9)
    # The tilt is what the chief ray's place makes of the direction cosines.
    for k, wavelength in enumerate(lines):
        at = fan.beta[k] - fan.beta[k, len(fan.stop) // 2]
        tilt = middle[k] * at / (1e-3 * wavelength)
        np.testing.assert_allclose(fan.opd_waves[k] - alone[k], tilt, atol=1e-6)


def test_an_undercorrected_lens_is_ahead_of_its_sphere_and_lands_below_at_the_upper_rim():
    rows = [{"radius": 50.0, "thickness": 5.0, **model(1.5)}, {"radius": -50.0}]
    fan = ray_fan(build(lens(rows)), GREEN, 0, AXIS, "y")
    assert fan.opd_waves[0, -1] > 1
    assert fan.y_um[0, -1] < -1
    np.testing.assert_allclose(fan.y_um[0], -fan.y_um[0, ::-1], atol=1e-6)


def test_without_an_axis_fans_along_x_are_no_mirror_images(tilted: System):
    fan = ray_fan(tilted, GREEN, 0, AXIS, "x")
    assert np.abs(fan.x_um[0] + fan.x_um[0, ::-1]).max() > 0.5
    assert fan.x_um[0, 40] == fan.y_um[0, 40] == 0


def test_hexapolar_points_stand_for_the_disc():
    x, y, area = hexapolar(12)
    assert len(x) == 469
    assert area.sum() == pytest.approx(1, abs=1e-12)
    assert area @ x == pytest.approx(0, abs=1e-12)
    # The trapezoidal rule over 12 rings: of rho^2 and rho^6, 1/2 and 1/4, to 1/144 of their slopes.
    rho2 = x**2 + y**2
    assert area @ rho2 == pytest.approx(1 / 2, abs=4e-3)
    assert area @ rho2**3 == pytest.approx(1 / 4, abs=12e-3)


def test_the_spot_of_a_perfect_lens_is_its_defocus():
    system = oval()
    still = spot_diagram(system, GREEN, 0, AXIS)
    assert still.geometric_um < 1e-3
    moved = replace(system, image_z_mm=system.image_z_mm + 0.1)
    spot = spot_diagram(moved, GREEN, 0, AXIS)
    # Every ray goes on by 0.1 mm along its slope; the outermost is that of the rim.
    rim = ray_fan(moved, GREEN, 0, AXIS, "y")
    slope = np.abs(rim.beta[0, -1]) / np.sqrt(1 - rim.beta[0, -1] ** 2)
    assert spot.geometric_um == pytest.approx(100 * slope, rel=1e-6)
    np.testing.assert_allclose(spot.centroid_um, 0, atol=1e-6)
    # Over the stop's area, by Gauss's rule over the square of the height.
    square, weight = np.polynomial.legendre.leggauss(20)
    heights = CubicSpline(rim.stop, rim.y_um[0])(np.sqrt((square + 1) / 2))
    assert spot.rms_um == pytest.approx(np.sqrt(weight @ heights**2 / 2), rel=1e-2)


def test_the_wavefront_of_a_defocused_perfect_lens_is_defocus():
    system = build(oval().prescription.model_copy(update={"f_number": 8.0}))
    moved = replace(system, image_z_mm=system.image_z_mm + 0.05)
    wave = wavefront_map(moved, 550.0, AXIS)
    lit = np.isfinite(wave.opd_waves)
    x, y = np.meshgrid(wave.stop, wave.stop)
    terms = fit(wave.opd_waves[lit], x[lit], y[lit])
    # W = dz (1 - cos u), which is dz sin^2 u / 2 to sin^2 u / 4 = 1e-3 of itself.
    rim = ray_fan(moved, GREEN, 0, AXIS, "y")
    waves = 50 * (1 - np.sqrt(1 - rim.beta[0, -1] ** 2)) / 0.55
    assert terms[3] == pytest.approx(waves / (2 * np.sqrt(3)), rel=5e-3)
    assert np.abs(np.delete(terms, [0, 3])).max() < 5e-3 * waves
    assert wave.peak_to_valley_waves == pytest.approx(waves, rel=5e-3)
    # Points on a square grid: 1 / nodes.
    assert wave.rms_waves == pytest.approx(waves / (2 * np.sqrt(3)), rel=1 / 65)


def test_coma_of_a_field_along_y_is_term_7(gauss: System):
    wave = wavefront_map(gauss, 550.0, Field("", np.radians(5.0)))
    lit = np.isfinite(wave.opd_waves)
    x, y = np.meshgrid(wave.stop, wave.stop)
    terms = fit(wave.opd_waves[lit], x[lit], y[lit])
    assert abs(terms[6]) > 1e3 * abs(terms[7])
    np.testing.assert_allclose(wave.opd_waves, wave.opd_waves[:, ::-1], atol=1e-6)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_angles_are_the_slopes_along_which_light_moves_with_the_image_plane(
    gauss: System, number: int
):
    field = main_fields(gauss)[number]
    here = arrival(gauss, 550.0, field)
    moved = arrival(replace(gauss, image_z_mm=gauss.image_z_mm + 0.1), 550.0, field)
    slope = (moved.y_mm - here.y_mm) / 0.1
    assert here.chief_deg == pytest.approx(np.degrees(np.arctan(slope)), abs=1e-6)
    assert here.lower_deg < here.chief_deg < here.upper_deg
    assert here.sagittal_deg[0] == pytest.approx(-here.sagittal_deg[1], abs=1e-3)
    if number == 0:
        tangential, sagittal = here.f_numbers
        assert tangential == pytest.approx(2.8, rel=0.01)
        assert sagittal == pytest.approx(tangential, rel=1e-3)
    else:
        assert here.chief_deg > 5
        # Vignetted along y, and foreshortened.
        assert here.f_numbers[0] > 1.02 * here.f_numbers[1]


def test_angles_of_rims_are_those_of_the_last_rays_that_pass(gauss: System):
    field = main_fields(gauss)[2]
    fan = ray_fan(gauss, GREEN, 0, field, "y")
    angles = np.degrees(np.arctan2(fan.beta[0], np.sqrt(1 - fan.alpha[0] ** 2 - fan.beta[0] ** 2)))
    here = arrival(gauss, 550.0, field)
    step = np.nanmax(np.abs(np.diff(angles)))
    assert 0 <= here.upper_deg - np.nanmax(angles) < step
    assert 0 <= np.nanmin(angles) - here.lower_deg < step


def test_the_airy_radius_is_that_of_the_f_number(gauss: System):
    assert airy_radius_um(gauss, 550.0) == pytest.approx(1.22 * 0.55 * 2.8, rel=0.01)
