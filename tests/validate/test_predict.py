"""Predicted line spreads against closed forms, with rays that no lens program made."""

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription
from gpusim.lens.system import build, first_order
from gpusim.reference.aperture import aperture_of
from gpusim.reference.backward import chief_back
from gpusim.reference.bundle import frame_of, rays_of
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.tracers import Bundle, OwnTracer

NA, WAVE_UM, EFL_MM = 0.2, 0.5, 10.0
BAND = Band("G", np.array([500.0]), np.array([1.0]))
NODES_NM = np.array([450.0, 500.0, 550.0, 600.0])


class Perfect:
    """A lens without aberration but for what is planted: a path, and magnification by colour."""

    name, independent, efl_mm = "perfect", True, EFL_MM

    def __init__(self, path_um=lambda alpha, beta: 0 * alpha, colour=0.0, denser=0.0):
        self.path_um, self.colour, self.denser = path_um, colour, denser

    def chief_mm(self, field_rad, wavelength_nm):
        """Return where chief rays land."""
        return EFL_MM * np.tan(field_rad) * (1 + self.colour * (wavelength_nm - 500))

    def rays(self, field_rad, wavelength_nm):
        """Return rays over a round pupil."""
        u = 1.1 * NA * np.linspace(-1, 1, 45)
        alpha, beta = (a.ravel() for a in np.meshgrid(u[u >= 0], u))
        wave_mm = 1e-3 * self.path_um(alpha, beta)
        margin = ((alpha**2 + beta**2) / NA**2 - 1)[None]
        chief = float(self.chief_mm(np.array([field_rad]), wavelength_nm)[0])
        entered = EFL_MM * np.stack([alpha, beta + self.denser * beta**2 / 2])
        return Bundle(chief, 0.0, alpha, beta, wave_mm, margin, entered)


def predictor(**planted):
    return Predictor(Perfect(**planted), 0.3, NODES_NM, np.ones(4))


@pytest.mark.parametrize("angle_deg", [0.0, 5.0, 45.0, 90.0])
def test_the_mtf_of_a_perfect_lens_is_diffraction(angle_deg):
    normal = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    found = predictor().line_spread(np.array([300.0, 100.0]), normal, np.zeros(2), BAND)
    at = np.clip(found.frequency_cy_um * WAVE_UM / (2 * NA), 0, 1)
    limit = 2 / np.pi * (np.arccos(at) - at * np.sqrt(1 - at**2))  # Goodman 2005, eq. 6-32
    # The rim on rows of 1/48 of the radius, and cells that it cuts: measured 4e-4.
    np.testing.assert_allclose(np.abs(found.otf), limit, rtol=0, atol=1e-3)


def test_a_tilted_wavefront_moves_the_image_as_its_rays_do():
    # A ray lands at -dW / d beta; here beta is the radius, which is y of this place.
    shift_um = 3.0
    tilted = predictor(path_um=lambda alpha, beta: -shift_um * beta)
    place, normal = np.array([0.0, 500.0]), np.array([0.0, 1.0])
    found = tilted.line_spread(place, normal, place, BAND)
    at = np.arange(-40, 40, 0.1)
    spread = found.at(at)
    # Sampled every 0.1 um; the tails beyond fall off alike on both sides but for 0.3 % of 3 um.
    assert np.average(at, weights=spread) == pytest.approx(shift_um, abs=0.02)


def test_coma_leans_to_the_side_of_its_rays():
    coma = predictor(path_um=lambda alpha, beta: -40 * (alpha**2 + beta**2) * beta)
    place, normal = np.array([0.0, 500.0]), np.array([0.0, 1.0])
    at = np.arange(-60, 60, 0.1)
    spread = coma.line_spread(place, normal, place, BAND).at(at)
    # Rays land at 40 (alpha^2 + 3 beta^2), whose mean over the disc is 40 NA^2; cut tails take less
    # than a tenth.
    assert np.average(at, weights=spread) == pytest.approx(40 * NA**2, rel=0.1)


def test_rays_count_by_the_light_that_enters():
    # Light is 1 + beta, and defocus lands rays at 200 beta: their mean is 200 <beta^2> = 50 NA^2.
    lens = Perfect(path_um=lambda alpha, beta: -100 * (alpha**2 + beta**2), denser=1.0)
    rays = Predictor(lens, 0.3, NODES_NM, np.ones(4), diffracts=False)
    place, normal = np.array([0.0, 500.0]), np.array([0.0, 1.0])
    found = rays.line_spread(place, normal, place, BAND)
    # The phase of a line spread's transfer function near 0 is that of its mean.
    mean_um = -np.angle(found.otf[1]) / (2 * np.pi * found.frequency_cy_um[1])
    assert mean_um == pytest.approx(50 * NA**2, abs=0.01)


def test_lateral_colour_parts_the_bands():
    lens = predictor(colour=1e-5)
    red = Band("R", np.array([580.0]), np.array([1.0]))
    place = np.array([400.0, 0.0])
    ideal = lens.ideal_um(place, BAND)
    np.testing.assert_allclose(lens.image_um(ideal, BAND), place, rtol=1e-9)
    # 80 nm at 1e-5 per nm of 400 um: splines over wavelengths follow a straight line exactly.
    assert lens.image_um(ideal, red)[0] - place[0] == pytest.approx(0.32, abs=1e-6)


def test_the_line_spread_holds_all_light_and_the_aperture_is_two_sincs():
    found = predictor().line_spread(np.zeros(2), np.array([1.0, 0.0]), np.zeros(2), BAND)
    at = np.arange(-800, 800, 0.1)
    # A spline between samples 0.2 um apart, where the spread has up to 1.3 cycles/um.
    assert found.at(at).sum() * 0.1 == pytest.approx(1, abs=1e-4)
    seen, slope, f = found.through(7.0, 0.1), 0.1, found.frequency_cy_um
    cos = 1 / np.hypot(1, slope)
    ratio = np.sinc(7 * f * cos) * np.sinc(7 * f * cos * slope)
    np.testing.assert_allclose(seen.otf, found.otf * ratio, rtol=0, atol=1e-12)


def test_an_even_scene_shows_what_rays_traced_back_from_the_image_say():
    """The radiance theorem, by a tracer of its own: the solid angle that arrives at a point."""
    system = build(load_prescription("double-gauss").scaled(8.3).stopped(2.8))
    index, focal = system.index(np.array([550.0])), first_order(system.prescription, 550.0).efl_mm
    widest = 0.8 * np.radians(system.prescription.max_field_deg)
    found = Predictor(OwnTracer(system), widest, np.array([450.0, 550.0, 650.0]), np.ones(3))
    sent = []
    for field in (0.0, 0.8 * widest):
        height = found.chief_um(np.array([field]), np.array([550.0]))[0]
        image = np.array([1e-3 * height[0], 0.0])
        frame = frame_of(system, index, image, focal)
        rays = rays_of(system, index, image, chief_back(system, index, image), frame)
        finest = 384 * 0.55 / (2 * float(np.ptp(rays.p, axis=1).max()))
        arrives = aperture_of(rays, 550.0, finest).solid_angle_sr
        # Rims on 96 rows: 5e-4 of the pupil.
        assert found.shown(height, np.array([550.0]))[0, 0] == pytest.approx(arrives, rel=6e-4)
        sent.append(found.light(np.array([field]), np.array([550.0]))[0, 0] / arrives - 1)
    assert abs(sent[1]) > 1.2e-3  # what the field itself sends is another light
