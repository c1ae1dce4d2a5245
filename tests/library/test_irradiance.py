"""Irradiance out of the optics and into a sensor: units, bands, and the frame that it makes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from harness import assert_close

import gpusim as gs
from gpusim.errors import UserError
from gpusim.library.irradiance import band_images
from gpusim.scene.exr import write_exr
from gpusim.scene.spectra import WAVELENGTHS_NM

LINES = np.arange(400.0, 701.0, 10.0)
SIZE = (18, 24)


def small(sensor: str = "imx477") -> gs.Camera:
    camera = gs.Camera.load("mtf-only")
    return gs.Camera(camera.lens, gs.Sensor.load(sensor).roi(*SIZE), "small")


@pytest.fixture(scope="module")
def chart() -> gs.Scene:
    return gs.Scene.load("colorchecker", frame=None)


def test_an_even_scene_has_the_irradiance_of_its_radiance():
    """E = pi L sin^2: in the middle of the field, from the lens's own solid angle."""
    camera, scene = small(), gs.Scene.load("flat-field")
    found = gs.Irradiance.of(camera, scene, [545, 550, 555, 560], 1e-3)
    bank = camera.lens.bank()
    solid = np.interp(found.wavelengths_nm, bank.wavelengths_nm, bank.projected_solid_angle_sr)
    passed = np.interp(found.wavelengths_nm, bank.wavelengths_nm, bank.transmission)
    radiance = np.interp(found.wavelengths_nm, WAVELENGTHS_NM, scene.spectra[0])
    middle = found.values[SIZE[0] // 2, SIZE[1] // 2]
    glare = 1 + 2 * camera.sensor.veiling_glare
    assert np.all(middle > 0.98 * radiance * solid * passed)
    assert np.all(middle < 1.02 * glare * radiance * solid * passed)


@pytest.mark.slow
def test_what_comes_out_goes_in_again(chart):
    camera = small()
    seen = gs.Irradiance.of(camera, chart, LINES, 1e-3)
    direct = gs.expose(camera, chart, 1e-3, probes=0)
    light = seen.light(camera.sensor)
    expected = direct.rates + direct.glare[:, None, None]
    # Bands of 10 nm against curves in steps of 5: what they bend within, and two tolerances.
    assert np.abs(light.rates / expected - 1).max() < 1e-2
    assert np.sqrt(np.mean((light.rates / expected - 1) ** 2)) < 4e-3
    frame = light.capture(1 / 60, seed=3)
    assert frame.raw.shape == SIZE
    off = frame.truth_dn - direct.capture(1 / 60, seed=3).truth_dn
    assert np.abs(off).max() < 0.01 * frame.truth_dn.max()


@pytest.mark.parametrize("sensor", ["kodak-vga", "imx249-mono"])
def test_every_sensor_reads_it(sensor: str):
    camera = small(sensor)
    values = np.full((*SIZE, 3), 2e-3, np.float32)
    values[:, 12:] = 0
    light = gs.Irradiance(values, np.array([450.0, 550.0, 650.0])).light(camera.sensor)
    frame = light.capture(noise=False)
    lit = frame.raw[-SIZE[0] :, -SIZE[1] :] if frame.raw.shape != SIZE else frame.raw
    assert lit[:, 2].mean() > lit[:, -3].mean() + 20


def test_electrons_are_counted_by_the_equation():
    """N = A E integral QE lambda / hc (EMVA 1288 R4, equation 1)."""
    sensor = small("imx249-mono").sensor
    values = np.full((*SIZE, 2), 1e-3)
    light = gs.Irradiance(values, np.array([500.0, 600.0])).light(sensor)
    lines = np.linspace(500, 600, 2001)
    own = sensor.quantum_efficiency
    curve = np.interp(lines, own.wavelengths_nm, own.channels["W"])
    area = sensor.fill_factor * (1e-6 * sensor.pixel_pitch_um) ** 2
    photons = area * 1e-3 * 1e-9 * lines / (6.62607015e-34 * 299792458.0)
    assert_close(light.rates[0], np.full(SIZE, np.trapezoid(photons * curve, lines)), rtol=1e-4)


def test_files(tmp_path: Path):
    values = np.random.default_rng(1).uniform(0, 1e-2, (*SIZE, LINES.size)).astype(np.float32)
    seen = gs.Irradiance(values, LINES)
    seen.save(tmp_path / "a.npz")
    again = gs.Irradiance.load(tmp_path / "a.npz")
    np.testing.assert_array_equal(again.values, seen.values)
    np.testing.assert_array_equal(again.wavelengths_nm, seen.wavelengths_nm)
    seen.save(tmp_path / "a.exr")
    file = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True)
    assert file.header()["units"] == "W m^-2 nm^-1"
    plane = file.channels()["S0.550,000nm"].pixels
    np.testing.assert_array_equal(plane, seen.values[..., 15])
    # Spectral EXR (Fichet 2021), as scenes are read.
    from gpusim.scene.spectral_exr import read_spectral_exr

    np.testing.assert_array_equal(read_spectral_exr(tmp_path / "a.exr").wavelengths_nm, LINES)


def test_an_exr_of_irradiance_is_read_as_it_was_written(tmp_path: Path):
    """Wavelengths too, to the last bit: two within 1e-4 nm stay two."""
    lines = np.array([400.0, 500.00005, 500.0001, 1000 / 1.7])
    values = np.random.default_rng(1).uniform(0, 1e-2, (*SIZE, lines.size)).astype(np.float32)
    gs.Irradiance(values, lines).save(tmp_path / "a.exr")
    again = gs.Irradiance.load(tmp_path / "a.exr")
    np.testing.assert_array_equal(again.values, values)
    np.testing.assert_array_equal(again.wavelengths_nm, lines)


@pytest.mark.parametrize("units", ["W m^-2 sr^-1 nm^-1", None])
def test_an_exr_of_other_units_is_no_irradiance(tmp_path: Path, units: str | None):
    write_exr(
        tmp_path / "a.exr", dict.fromkeys(("S0.500nm", "S0.600nm"), np.ones(SIZE)), None, units
    )
    with pytest.raises(UserError, match="something else") as caught:
        gs.Irradiance.load(tmp_path / "a.exr")
    assert caught.value.file == tmp_path / "a.exr"
    assert (units or "not said") in caught.value.value


def test_a_reflectance_is_no_irradiance_whatever_its_units(tmp_path: Path):
    planes = dict.fromkeys(("T.500nm", "T.600nm"), np.ones(SIZE))
    write_exr(tmp_path / "a.exr", planes, units="W m^-2 nm^-1")
    with pytest.raises(UserError, match="no light"):
        gs.Irradiance.load(tmp_path / "a.exr")


@pytest.mark.parametrize("units", ["W m^-2 nm^-1", "e-/s"])
def test_what_is_no_radiance_is_no_scene(tmp_path: Path, units: str):
    """Else light on the sensor goes through the lens once more."""
    for name, planes in {"a": {"S0.500nm": np.ones(SIZE)}, "b": {"Y": np.ones(SIZE)}}.items():
        file = tmp_path / f"{name}.exr"
        write_exr(file, planes, units=units)
        with pytest.raises(UserError, match="holds no radiance") as caught:
            gs.Scene.load(file)
        assert (caught.value.file, caught.value.field) == (file, "units")
        assert caught.value.value == units


@pytest.mark.slow
def test_images_without_a_filter_array_have_every_pixel(chart):
    camera = small()
    own = camera.sensor.quantum_efficiency
    curves = np.stack([own.channels[name] for name in camera.sensor.channels])
    images = band_images(camera, chart, np.array(own.wavelengths_nm), curves, 1e-3)
    assert images.shape == (*SIZE, 3)
    direct = gs.expose(camera, chart, 1e-3, probes=0)
    letters = camera.sensor.cfa.letters
    for place, plane, glare in zip(np.ndindex(2, 2), direct.rates, direct.glare, strict=True):
        image = images[..., camera.sensor.channels.index(letters[place[0]][place[1]])]
        found = image[place[0] :: 2, place[1] :: 2]
        assert np.abs(found / (plane + glare) - 1).max() < 1e-2


@pytest.mark.parametrize(
    ("shape", "lines", "words"),
    [
        ((4, 4, 3), [400, 500], "shapes"),
        ((4, 4), [400, 500], "shapes"),
        ((4, 4, 2), [500, 400], "rise"),
        ((4, 4, 1), [500], "rise"),
        ((4, 4, 2), [100, 500], "beyond"),
    ],
)
def test_what_is_no_irradiance_is_refused(shape: tuple, lines: list, words: str):
    with pytest.raises(UserError, match=words):
        gs.Irradiance(np.zeros(shape), np.array(lines, float))


def test_values_sizes_and_files_that_are_none_are_refused(tmp_path: Path, chart):
    for value in (-1.0, np.nan, np.inf):
        with pytest.raises(UserError, match="no irradiance"):
            gs.Irradiance(np.full((2, 2, 2), value), np.array([400.0, 500.0]))
    with pytest.raises(UserError, match="another size"):
        gs.Irradiance(np.zeros((2, 2, 2)), np.array([400.0, 500.0])).light(small().sensor)
    with pytest.raises(UserError, match="between the wavelengths"):
        gs.Irradiance.of(small(), chart, [401, 500])
    (tmp_path / "a.npz").write_bytes(b"PK nothing")
    np.savez(tmp_path / "b.npz", other=np.zeros(3))
    for name, words in (("a", "no irradiance"), ("b", "no irradiance"), ("c", "no such")):
        with pytest.raises(UserError, match=words) as caught:
            gs.Irradiance.load(tmp_path / f"{name}.npz")
        assert caught.value.file == tmp_path / f"{name}.npz"
