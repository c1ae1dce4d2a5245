"""How far a raw's polynomial of the distortion is off the library's lenses, and who says so."""

import numpy as np
import pytest

from gpusim.formats.lens_file import load_prescription, presets
from gpusim.isp.lens_tags import HEIGHTS, Optics, correction_notes, misfit_um, warp
from gpusim.lens.samples import sample_rays
from gpusim.lens.system import build
from gpusim.psf.field_map import FieldMap
from gpusim.sensor.load import load_sensor

LARGEST_DEG = 80.0  # of a field that still has a place on the ideal plane
PITCH_UM = 4.0
# Largest distance over the whole image circle, um: as measured, and a quarter more. Of the others
# the circle ends where a polynomial of the 7th degree no longer follows.
BARS_UM = {
    "compact-6mm": 0.11,
    "cooke-triplet": 0.014,
    "double-gauss": 0.010,
    "telephoto": 0.10,
    "tessar": 0.47,
    "wide": 2.0,
    "phone": 8.7,
    "fisheye": 14.0,
}


def chief_rays(name: str) -> tuple[Optics, np.ndarray, np.ndarray]:
    """Return a lens as files know it, and ideal and real heights of 400 chief rays, um."""
    prescription = load_prescription(name)
    system, centre = build(prescription), np.zeros(1)
    index = system.index(np.array([550.0]))

    def lands(angle: float) -> float:
        return 1e3 * abs(sample_rays(system, index, angle, centre, centre).chief_y_mm.item())

    edge = np.radians(prescription.max_field_deg)
    angles = np.linspace(0, edge, 33)
    scale = lands(1e-4) / 1e-4
    field = FieldMap(angles, np.array([lands(angle) for angle in angles]), scale)
    dense = np.linspace(0, min(edge, np.radians(LARGEST_DEG)), 400)
    real = field.height_um(dense)
    heights = np.linspace(0, real[-1], HEIGHTS)
    known = scale * np.tan(field.angle(heights))
    return Optics(name, 1.0, 1.0, heights, known, np.ones(HEIGHTS)), scale * np.tan(dense), real


def test_every_lens_has_a_bar():
    assert set(BARS_UM) == set(presets())


@pytest.mark.slow
@pytest.mark.parametrize("name", BARS_UM)
def test_the_polynomial_is_as_near_as_it_says(name: str):
    lens, ideal, real = chief_rays(name)
    circle = real[-1]
    k = warp(lens, circle, np.zeros(HEIGHTS))
    r = ideal / circle
    apart = circle * (k[0] * r + k[1] * r**3 + k[2] * r**5 + k[3] * r**7) - real
    reach = np.maximum(ideal, real)  # of a picture as large as the circle, before and after
    corner = np.interp(circle, reach, apart)
    off = max(np.abs(apart[reach <= circle]).max(), abs(corner))
    print(f"{name}: {off:.3f} um over a circle of {circle:.0f} um, {off / PITCH_UM:.2f} px")
    assert off <= BARS_UM[name]
    # By the heights that files know, a third as many, and straight between them.
    assert misfit_um(lens, circle) == pytest.approx(off, rel=0.1)
    base = load_sensor("imx477")
    half = int(circle / np.sqrt(2) / PITCH_UM)
    sensor = base.model_copy(
        update={"rows": 2 * half, "cols": 2 * half, "pixel_pitch_um": PITCH_UM}
    )
    told = "".join(correction_notes(lens, sensor))
    assert ("polynomial" in told) == (name in ("wide", "phone", "fisheye"))


def test_what_is_no_polynomial_is_told_and_what_has_no_axis():
    sensor = load_sensor("imx477")
    height = np.linspace(0, 4000, HEIGHTS)
    plain = Optics("a lens", 8.0, 2.8, height * (1 + 0.05 * (height / 4000) ** 2), height, height)
    assert correction_notes(plain, sensor) == ()
    waves = height + 3 * np.sin(height / 150)
    bent = Optics("a lens", 8.0, 2.8, waves, height, height)
    (told,) = correction_notes(bent, sensor)
    # 3 um of pixels of 1.55 um, of which the polynomial follows a little or bends too far.
    assert 1.5 < float(told.partition("up to ")[2].partition(" px")[0]) < 2.5
    none = np.zeros(0)
    (told,) = correction_notes(Optics("a lens", 8.0, 2.8, none, none, none), sensor)
    assert "no axis" in told
