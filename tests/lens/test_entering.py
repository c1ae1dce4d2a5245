"""Light as it enters: against closed forms, and the light that arrives at a point of the image."""

import numpy as np
import pytest
from lens.made import lens, model
from sampling import one_in

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.entering import stretch
from gpusim.lens.samples import sample_field, sample_rays
from gpusim.lens.system import build, first_order
from gpusim.lens.wavefront import pupils
from gpusim.psf.compute import compute_bank
from gpusim.psf.field_map import FieldMap
from gpusim.reference.aperture import aperture_of
from gpusim.reference.backward import chief_back
from gpusim.reference.bundle import frame_of, rays_of

D_LINE = np.array([587.5618])
GREEN = np.array([550.0])
MIDDLE = np.zeros(1)


def test_a_hyperboloid_brightens_the_rim_of_its_pupil():
    """A plane and a hyperboloid (Descartes): heights h leave at sines s, E = h dh / (s ds)."""
    f, n = 20.0, 1.5
    rows = [
        {"radius": np.inf, "thickness": 0.5 * f, **model(n)},
        {"radius": -(n - 1) * f, "conic": -n * n},
    ]
    system = build(lens(rows, f_number=2.0, max_field_deg=1.0))
    samples = sample_field(system, system.index(D_LINE), 0.0)
    found, of_chief = samples.entering.density(0, samples.inside[0])

    def sine(h):
        a, b = n * n - 1, (n - 1) * f
        sag = (-b + np.sqrt(b * b + a * h * h)) / a
        return h / np.hypot(h, f + sag)

    h = np.hypot(samples.entering.px, samples.entering.py)[0, samples.inside[0]]
    away = np.maximum(h, 1e-3)
    slope = (sine(away + 1e-4) - sine(away - 1e-4)) / 2e-4
    exact = away / (sine(away) * slope)
    assert of_chief == pytest.approx(f * f, rel=1e-4)
    # Forward differences of 2e-5 of the stop's radius.
    np.testing.assert_allclose(found * of_chief, exact, rtol=1e-4)
    assert exact.max() / exact.min() > 1.1
    (pupil,) = pupils(samples, D_LINE, 64.0, 512)
    assert pupil.entered == pytest.approx(np.pi * (f / 4) ** 2, rel=1e-4)  # the beam's area


@pytest.mark.parametrize("name", ["double-gauss", "phone", "fisheye"])
def test_the_images_area_is_the_slope_of_the_map(name):
    system = build(load_prescription(name))
    index, scale = system.index(GREEN), 1e3 * first_order(system.prescription, 550.0).efl_mm
    theta = np.radians(np.linspace(0, 0.9 * system.prescription.max_field_deg, 60))
    height = [1e3 * sample_rays(system, index, one, MIDDLE, MIDDLE).chief_y_mm[0] for one in theta]
    chief = FieldMap(theta, np.array(height), scale)
    for one in theta[[0, 20, 50]]:
        slope = chief.slope_um(one)
        across = slope if one == 0 else chief.height_um(one) / np.sin(one)
        exact = 1e-6 * across * slope
        assert stretch(system, 550.0, float(one)).area() == pytest.approx(exact, rel=2e-6)


def test_a_turned_field_and_a_moved_element_have_their_own_area():
    gauss = load_prescription("double-gauss")
    system = build(gauss)
    straight = stretch(system, 550.0, 0.1).area()
    assert stretch(system, 550.0, 0.1, 1.0).area() == pytest.approx(straight, rel=1e-6)
    # An element that is moved by next to nothing takes the other way to the same figure.
    surfaces = list(gauss.surfaces)
    surfaces[1] = surfaces[1].model_copy(update={"decentre_mm": (1e-7, 0.0)})
    moved = build(gauss.model_copy(update={"surfaces": tuple(surfaces)}))
    for theta in (0.0, 0.1, 0.2):
        one, other = (stretch(each, 550.0, theta, 0.5).area() for each in (system, moved))
        assert other == pytest.approx(one, rel=2e-6)


def test_of_an_object_far_away_the_light_is_that_of_one_at_infinity():
    gauss = load_prescription("double-gauss").scaled(25.0)
    far = gauss.model_copy(update={"object_distance_mm": 1e7})
    for theta in (0.0, 0.2):
        light = []
        for system in (build(gauss), build(far)):
            index = system.index(GREEN)
            (pupil,) = pupils(sample_field(system, index, theta), GREEN, 64.0, 256)
            light.append(pupil.entered / stretch(system, 550.0, theta).area())
        assert light[1] == pytest.approx(light[0], rel=1e-5)  # 25 mm of 10 km, twice


def test_of_a_near_object_the_light_on_axis_is_that_of_its_pupil():
    # At f/16 the sine condition holds to 1e-4; in focus, or the image is larger than in focus.
    near = load_prescription("double-gauss").scaled(25.0).stopped(16.0)
    settings = {"object_distance_mm": 200.0, "focus": "paraxial", "reference_nm": 550.0}
    system = build(near.model_copy(update=settings))
    index = system.index(GREEN)
    (pupil,) = pupils(sample_field(system, index, 0.0), GREEN, 64.0, 512)
    light = pupil.entered / stretch(system, 550.0, 0.0).area()
    assert light == pytest.approx(pupil.projected_solid_angle_sr, rel=3e-4)
    assert pupil.entering_at_chief < 1.0  # sr: a wider cone behind the lens than before it


@pytest.mark.parametrize(("name", "tolerance"), one_in(2, [("wide", 1e-4), ("double-gauss", 3e-4)]))
def test_what_fields_send_adds_up_to_what_a_point_of_the_image_sees(name, tolerance):
    """Rays from the scene, spread by their PSFs, against rays traced back from the image.

    The radiance theorem gives the latter without any aberration: the solid angle there. Moments of
    third order and more of the PSFs are left out, and those within the window sampled. Lateral
    colour, 10 um at 400 nm in the wide lens, belongs to the spread. What is left out goes with the
    third power of the aperture and of the field; found is 1.6e-4 for the double Gauss at f/2.8, and
    6e-5 for the wide lens: the tolerances are less than twice that.
    """
    given = load_prescription(name)
    given = given.stopped(max(given.f_number, 2.8))
    lines = np.array([400.0, 550.0, 700.0])
    bank = compute_bank(given, lines)
    system, focal = build(given), first_order(given, 550.0).efl_mm
    axis = bank.projected_solid_angle_sr
    sent = []
    for field in (0, 4, 8):
        image = np.array([1e-3 * bank.real_height_um[field, 1], 0.0])
        frame = frame_of(system, system.index(GREEN), image, focal)
        arrives = []
        for nm in lines:
            index = system.index(np.array([nm]))
            rays = rays_of(system, index, image, chief_back(system, index, image), frame)
            extent = float(np.ptp(rays.p, axis=1).max())
            half_um = 384 * 1e-3 * nm / (2 * extent)
            arrives.append(aperture_of(rays, nm, half_um).solid_angle_sr)
        shown = bank.relative_illumination[field] * axis
        np.testing.assert_allclose(shown, arrives, rtol=tolerance, err_msg=str(field))
        sent.append(bank.field_light[field, 1] * axis[1] / arrives[1] - 1)
    # Without their spread it is another figure.
    assert np.abs(sent).max() > 2 * tolerance
