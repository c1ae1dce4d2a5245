"""The engine's fold of efficiencies over angle, with errors planted, loses the reports' bars.

The lens is made up, so that no bank is traced: sharp, of even light, with an exit pupil; the tracer
that predicts knows the same lens by its equations. What renders is the engine, on some pixels.
"""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from optics.angled import angled, eqe_map, leaning_pixel
from optics.angled import lens as made_lens
from optics.made import StubCamera

from gpusim.optics.angular import AngularResponse
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene import make_scene
from gpusim.scene.spectra import WAVELENGTHS_NM
from gpusim.validate import ansys_electrons
from gpusim.validate import samsung_qe as qe
from gpusim.validate.certified import Certified
from gpusim.validate.predict import Band, Predictor
from gpusim.validate.tracers import Bundle

EFL_MM, EXIT_MM, CIRCLE_UM = 1.0, 2.0, 330.0  # EFL: of every lens of `optics.made`
PLAIN = {"falloff": 0.0, "distortion": 0.0, "coma_um": 0.0, "lateral": (0.0, 0.0, 0.0), "size": 32}
LENS = made_lens(EXIT_MM, fields=9, circle_um=CIRCLE_UM, **PLAIN)
MET = SimpleNamespace(total_rms=1e-4, total_worst=1e-4, met=True, probes=8)


class Pupil:
    """Rays of a lens without aberrations, from a round exit pupil."""

    name, independent, efl_mm = "equations", True, EFL_MM

    def chief_mm(self, field_rad, wavelength_nm):
        """Return where chief rays land."""
        return EFL_MM * np.tan(field_rad)

    def rays(self, field_rad, wavelength_nm):
        """Return rays over the pupil; as much light enters for each area of the image."""
        solid_sr = np.interp(wavelength_nm, LENS.wavelengths_nm, LENS.projected_solid_angle_sr)
        sine = np.sqrt(solid_sr / np.pi)
        u = 1.1 * sine * np.linspace(-1, 1, 45)
        alpha, beta = (one.ravel() for one in np.meshgrid(u[u >= 0], u))
        margin = ((alpha**2 + beta**2) / sine**2 - 1)[None]
        entered = EFL_MM / np.cos(field_rad) ** 1.5 * np.stack([alpha, beta])
        height = float(self.chief_mm(field_rad, wavelength_nm))
        chief = np.sin(np.arctan(height / EXIT_MM))
        return Bundle(height, chief, alpha, beta + chief, 0 * alpha, margin, entered)


@pytest.fixture(scope="module")
def predictor():
    nodes = np.linspace(400.0, 700.0, 7)
    passed = np.interp(nodes, LENS.wavelengths_nm, LENS.transmission)
    widest = np.arctan(1e-3 * CIRCLE_UM / EFL_MM)
    return Predictor(Pupil(), widest, nodes, passed, pupils=5)


def tiles_of(camera, scene, accuracy, exposure_s, tiles):
    """Return the light of tiles, without certificates: the bank is no lens."""
    renderer = Renderer(camera, scene, Accuracy(1e-3, 0), noise=False, method="fft")
    try:
        return [
            replace(renderer.capture(exposure_s, tile=tile, keep=("rate",)), certificate=MET)
            for tile in tiles
        ]
    finally:
        renderer.release()


def samsung(predictor, monkeypatch):
    """Return the efficiencies of 16 x 16 pixels on the axis, and off it."""
    sensor = qe.angular_sensor().roi(32, 288)
    monkeypatch.setattr(qe, "angular_sensor", lambda: sensor)
    monkeypatch.setattr(qe, "camera_of", lambda optics, lens, sensor: StubCamera(LENS, sensor))
    monkeypatch.setattr(qe, "certified_tiles", tiles_of)
    monkeypatch.setattr(qe, "pooled", lambda captures, tolerance: Certified(MET, tolerance))
    monkeypatch.setattr(qe, "PLACES_MM", ((0.0, 0.0), (0.2, 0.0)))
    return qe.measure_qe(None, predictor)


def ansys(predictor, monkeypatch):
    """Return the electrons of 8 x 8 pixels at four places."""
    sensor = angled(eqe_map(W=leaning_pixel(0.5)), 96, 96, veiling_glare=0.0)
    monkeypatch.setattr(ansys_electrons, "certified_tiles", tiles_of)
    band = Band("W", WAVELENGTHS_NM, np.ones(WAVELENGTHS_NM.size))
    monkeypatch.setattr(
        ansys_electrons, "pooled", lambda made, tolerance: Certified(MET, tolerance)
    )
    camera = StubCamera(LENS, sensor)
    # Nothing is bent out of the field: the made-up PSFs end 32 samples wide.
    return ansys_electrons.electrons_of(
        camera, make_scene("grey"), predictor, band, rim_mm=math.inf
    )


class Chiefs:
    """A bank whose cones are taken for their chief rays."""

    def __init__(self, bank):
        self.bank = bank

    def __getattr__(self, name):
        return getattr(self.bank, name)

    def rays(self, number):
        """Return the rays of a field, all along the chief ray."""
        place_um, chief, cone = self.bank.rays(number)
        cone = cone.copy()
        cone[..., :2] = chief[:, None]
        return place_um, chief, cone


class Mirrored(Chiefs):
    """A bank whose light arrives from the other side."""

    def rays(self, number):
        """Return the rays of a field, their cosines against the outward way."""
        place_um, chief, cone = self.bank.rays(number)
        return place_um, -chief, cone * np.array([-1.0, -1.0, 1.0], np.float32)


SHARES = AngularResponse._shares


@pytest.mark.parametrize("report", [samsung, ansys])
@pytest.mark.parametrize("planted", [None, Chiefs, Mirrored])
def test_a_fold_of_other_rays_loses_the_bar(predictor, monkeypatch, report, planted):
    def wrong(response, number):
        own, response.bank = response.bank, planted(response.bank)
        try:
            return SHARES(response, number)
        finally:
            response.bank = own

    if planted:
        monkeypatch.setattr(AngularResponse, "_shares", wrong)
    found = report(predictor, monkeypatch)
    held = {bar.name: bar.held for bar in found.bars() if "certificate" not in bar.name}
    assert all(held.values()) is (planted is None), found.bars()
