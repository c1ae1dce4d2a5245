"""Which wavelengths are rendered, and how light is named that no data describe."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from gpusim.camera import load_camera
from gpusim.known import Known
from gpusim.library.scene import Scene
from gpusim.plan import Accuracy
from gpusim.plan.band import DROPPED_SHARE, band_of
from gpusim.scene import make_scene
from gpusim.scene.spectra import WAVELENGTHS_NM, grid_nm
from gpusim.sensor.filters_model import Filter
from gpusim.sensor.qe import QuantumEfficiency
from gpusim.sensor.sensor import Sensor

TIGHT = Accuracy(1e-3)
CAMERA = load_camera("arvr")


def sensor(wavelengths_nm: list[float], curve: list[float], **changes) -> Sensor:
    """Return a monochrome sensor of one's own quantum efficiency."""
    table = QuantumEfficiency(wavelengths_nm=wavelengths_nm, channels={"W": curve})
    return CAMERA.sensor.model_copy(update={"quantum_efficiency": table, **changes})


def ends(*given) -> tuple[float, float]:
    return tuple(band_of(*given).wavelengths_nm[[0, -1]])


@pytest.mark.parametrize("camera", ["demo", "kodak", "phone", "mtf-only"])
@pytest.mark.parametrize("scene", ["demo", "slanted-edge"])
def test_a_sensor_known_to_700_nm_has_the_wavelengths_that_it_always_had(camera, scene):
    one = load_camera(camera)
    found = band_of(one.lens, one.sensor, make_scene(scene), TIGHT)
    assert np.array_equal(found.wavelengths_nm, WAVELENGTHS_NM)
    assert found.dropped == 0


@pytest.mark.parametrize(
    ("scene", "lamp", "last_nm"),
    [
        ("demo", "A", 730),  # the ColorChecker
        ("slanted-edge", "D50", 830),
        ("slanted-edge", "FL2", 780),
        ("slanted-edge", "A", 1100),  # the sensor
        ("slanted-edge", "5100K", 1100),
    ],
)
def test_light_is_rendered_as_far_as_scene_lens_and_sensor_are_known(scene, lamp, last_nm):
    given = CAMERA.lens, CAMERA.sensor, make_scene(scene, illuminant=lamp), TIGHT
    assert ends(*given) == (400, last_nm)


def test_a_glass_without_data_ends_the_light_and_is_named():
    lens = CAMERA.lens
    known = lens.known
    assert {one.what.split()[0] for one in known} == {"glass"}

    class Short:
        known = (Known("glass X", 420.0, 1013.98),)

    found = band_of(Short(), CAMERA.sensor, make_scene("grey", illuminant="A"), TIGHT)
    assert tuple(found.wavelengths_nm[[0, -1]]) == (400, 1010)
    assert "glass X" in found.unknown[-1].lacking


def test_the_share_without_data_is_that_of_the_integral():
    # A flat quantum efficiency that is known to 700 nm, under a blackbody: photons between 700 and
    # the band gap over those from the glass's end to it, by quadrature of Planck's law.
    flat = sensor([300.0, 700.0], [0.5, 0.5])
    (found,) = band_of(CAMERA.lens, flat, make_scene("grey", illuminant="5100K"), TIGHT).unknown[1:]

    def photons(nm: float) -> float:
        return nm**-4 / np.expm1(1.438776877e7 / (nm * 5100))

    start = max(one.first_nm for one in CAMERA.lens.known)
    share = quad(photons, 700, 1100)[0] / quad(photons, start, 1100)[0]
    # Sums of samples 5 nm apart: half a step at each end, of 160 steps.
    assert found.share == pytest.approx(share, rel=0.01)
    assert (found.first_nm, found.lacking) == (700, ("the sensor's quantum efficiency",))
    text = found.text
    assert f"{100 * found.share:.2g} %" in text
    assert "beyond 700 nm" in text
    assert "the sensor's quantum efficiency" in text


def test_a_photograph_names_its_infra_red_that_no_spectrum_of_rgb_has():
    wide = sensor([300.0, 1100.0], [0.5, 0.5])
    grey = Scene.from_rgb(np.full((4, 5, 3), 0.3), 100.0)
    found = band_of(CAMERA.lens, wide, grey, TIGHT)
    assert tuple(found.wavelengths_nm[[0, -1]]) == (380, 780)
    below, beyond = found.unknown
    assert (below.last_nm, beyond.first_nm) == (380, 780)
    assert all("Mallett and Yuksel" in one.lacking[0] for one in found.unknown)
    # Photons of what is known, as at its ends beyond, from where the lens begins, by sums over
    # steps of 5 nm: half a step at each end, of some 60.
    nm = np.arange(max(one.first_nm for one in CAMERA.lens.known), 1101.0, 5.0)
    photons = nm * (grey.source.planes[:, 0, 0] @ grey.on(nm).spectra)
    share = photons[nm >= 780].sum() / photons.sum()
    assert beyond.share == pytest.approx(share, rel=0.01)
    assert "beyond 780 nm" in beyond.text and f"{100 * beyond.share:.2g} %" in beyond.text


def test_what_the_tolerance_would_not_see_is_not_named():
    faint = sensor([380.0, 400.0, 500.0, 690.0, 700.0], [0.0, 0.0, 0.6, 0.5, 0.0])
    assert band_of(CAMERA.lens, faint, make_scene("grey"), TIGHT).unknown == ()


def test_behind_an_infra_red_cut_no_wavelength_is_added():
    cut = Filter(
        name="cut", wavelengths_nm=[300.0, 640.0, 690.0, 1200.0], transmission=[1.0, 1.0, 0.0, 0.0]
    )
    behind = CAMERA.sensor.model_copy(update={"filters": [cut]})
    found = band_of(CAMERA.lens, behind, make_scene("grey", illuminant="A"), TIGHT)
    assert np.array_equal(found.wavelengths_nm, WAVELENGTHS_NM)
    assert found.dropped == 0
    assert not any(one.first_nm == 700 for one in found.unknown)


def test_what_is_left_out_is_a_small_part_of_the_tolerance_and_is_counted():
    # A leak of 2e-6 of the peak beyond 700 nm: too little for 1e-2, too much for 1e-4.
    wide, curve = [380.0, 400.0, 700.0, 701.0, 1100.0], [0.5, 0.5, 0.5, 1e-6, 1e-6]
    leaky = sensor(wide, curve)
    grey = make_scene("grey", illuminant="A")
    loose = band_of(CAMERA.lens, leaky, grey, Accuracy(1e-2))
    strict = band_of(CAMERA.lens, leaky, grey, Accuracy(1e-4))
    assert loose.wavelengths_nm[-1] == 705
    assert strict.wavelengths_nm[-1] > 900
    for band, tolerance in ((loose, 1e-2), (strict, 1e-4)):
        assert 0 < band.dropped <= DROPPED_SHARE * tolerance
        whole, kept = grid_nm(380, 1100), band.wavelengths_nm

        def light(grid: np.ndarray) -> float:
            spectrum = grey.on(grid).spectra[0]
            return np.trapezoid(spectrum * np.interp(grid, wide, curve) * grid, grid)

        assert band.dropped == pytest.approx(1 - light(kept) / light(whole), abs=1e-12)
    assert loose.stages[0].predicted_error == loose.dropped


def test_a_lens_that_does_not_say_how_far_it_is_known_is_used_as_the_scene_is():
    scene = make_scene("grey", illuminant="A").on(grid_nm(400, 900))
    assert band_of(object(), CAMERA.sensor, scene, TIGHT).wavelengths_nm is scene.wavelengths_nm


def test_spectra_of_ones_own_are_known_where_they_are_given():
    made = make_scene("grey", illuminant="A")
    own = replace(made, spectra=2 * made.spectra)
    assert own.known[0].what == "the scene's spectra"
    found = band_of(CAMERA.lens, CAMERA.sensor, own, TIGHT)
    assert np.array_equal(found.wavelengths_nm, WAVELENGTHS_NM)
    assert found.unknown[-1].lacking == ("the scene's spectra",)
    # Its light ends at 700 nm, and is held there for the estimate: a lower one than the lamp's.
    assert 0.2 < found.unknown[-1].share < 0.5
