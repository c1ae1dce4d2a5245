"""The sensors and cameras that come with the package: their sources' own figures, and a frame.

Covered: the figures that each source states, worked out anew from the file; what is assumed is
said to be; every sensor renders a frame whose mean and noise are those of its data sheet; every
camera file loads, and its lens covers its sensor.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from gpusim.camera import load_camera
from gpusim.camera import presets as cameras
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import first_order
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.psf.cone import with_exit_pupil
from gpusim.render import Renderer
from gpusim.scene.chart import Chart
from gpusim.scene.scene import Scene
from gpusim.sensor.load import load_sensor, presets
from gpusim.sensor.sensor import Sensor
from gpusim.stress.made import FLAT, camera_of, gaussian_bank

MATRIX_SNR_DB, MATRIX_DR_DB = 45.1, 73.0


def at(sensor: Sensor, channel: str, wavelength_nm: float) -> float:
    curves = sensor.quantum_efficiency
    return float(np.interp(wavelength_nm, curves.wavelengths_nm, curves.channels[channel]))


def test_the_presets_are_those_that_are_promised():
    assert {"imx477", "imx363", "imx249-mono", "kodak-vga", "arvr-640"} <= set(presets())


def test_the_imx363_is_the_one_of_isetcam():
    """Its model in volts: swing 1023 x 0.44875 mV for 6000 e-, gain 1 at ISO 55."""
    sensor = load_sensor("imx363")
    assert (sensor.rows, sensor.cols, sensor.pixel_pitch_um) == (3024, 4032, 1.4)
    swing_v, volts_per_dn = 1023 * 0.44875e-3, 0.44875e-3
    volts_per_e = swing_v / 6000
    assert sensor.system_gain_dn_per_e == pytest.approx(volts_per_e / volts_per_dn, abs=1e-6)
    assert (sensor.full_well_e, sensor.temporal_dark_noise_e) == (6000, 5)
    assert (sensor.prnu_percent, sensor.dsnu_e, sensor.dark_current_e_per_s) == (0.7, 0, 0)
    assert (sensor.black_level_dn, sensor.bit_depth, sensor.max_dn) == (64, 10, 1023)
    # Where the converter clips: 959 DN above the black level.
    assert (sensor.max_dn - 64) / sensor.system_gain_dn_per_e == pytest.approx(5625, abs=1)
    assert sensor.site_channels() == ("R", "G", "G", "B")
    # ISETCam's gain at ISO 270, 55 / 270, divides.
    assert sensor.analogue_gains[1].iso == 270
    raised = sensor.at_gain(sensor.analogue_gains[1].gain).system_gain_dn_per_e
    assert raised == pytest.approx(sensor.system_gain_dn_per_e / (55 / 270), rel=1e-6)
    # 53.5 % in green, and the ratios of the IMX477-like curves.
    peaks = {name: curve.max() for name, curve in sensor.qe.items()}
    whole = {name: curve.max() for name, curve in load_sensor("imx477").qe.items()}
    assert peaks["G"] == 0.535
    for name in "RB":
        assert peaks[name] / peaks["G"] == pytest.approx(whole[name] / whole["G"], abs=2e-4)


def test_the_imx249_has_the_published_range():
    """EMVA 1288 release 3.1, section 2: SNR_max 45.1 dB and DR 73 dB, each to 0.05 dB."""
    sensor = load_sensor("imx249-mono")
    assert (sensor.rows, sensor.cols, sensor.pixel_pitch_um) == (1216, 1936, 5.86)
    gain, capacity_e = sensor.system_gain_dn_per_e, sensor.full_well_e
    assert 20 * math.log10(math.sqrt(capacity_e)) == pytest.approx(MATRIX_SNR_DB, abs=0.05)
    threshold_e = math.sqrt(sensor.temporal_dark_noise_e**2 + 1 / 12 / gain**2) + 0.5
    assert 20 * math.log10(capacity_e / threshold_e) == pytest.approx(MATRIX_DR_DB, abs=0.05)
    # The well is full within the last code.
    assert 4094 < sensor.black_level_dn + gain * capacity_e < 4095
    # The digitised curve of the pixel at some of its own points.
    for wavelength_nm, percent in ((433.9, 69.04), (501.3, 77.74), (603.2, 61.22), (695.7, 40.0)):
        assert 100 * at(sensor, "W", wavelength_nm) == pytest.approx(percent, abs=0.01)


def test_the_kodak_camera_is_the_one_of_the_paper():
    camera = load_camera("kodak")
    sensor = camera.sensor
    assert (sensor.rows, sensor.cols, sensor.pixel_pitch_um) == (480, 640, 7.8)
    assert len(sensor.channels) == 3
    # 0.5 nA/cm^2 over the pixel.
    assert sensor.dark_current_e_per_s == pytest.approx(0.5e-9 * 7.8e-4**2 / 1.602e-19, rel=1e-3)
    lens = first_order(camera.lens)
    assert lens.efl_mm == pytest.approx(6.6)
    assert 1 / (2 * lens.f_number) == pytest.approx(0.22, abs=1e-3)


def test_the_arvr_camera_is_the_one_of_the_paper():
    camera = load_camera("arvr")
    sensor = camera.sensor
    assert (sensor.rows, sensor.cols, sensor.channels) == (640, 640, ("W",))
    assert sensor.cols * sensor.pixel_pitch_um == pytest.approx(2534)
    assert sensor.pixel_pitch_um == pytest.approx(2 * 1.98, abs=1e-3)
    lens = first_order(camera.lens)
    assert (lens.efl_mm, lens.f_number) == (pytest.approx(3), pytest.approx(2))


def test_what_the_papers_do_not_say_is_said_to_be_assumed():
    for name in ("kodak-vga", "arvr-640"):
        sources = load_sensor(name).sources
        for field in ("full_well_e", "temporal_dark_noise_e", "prnu_percent", "quantum_efficiency"):
            assert sources[field].startswith("assumed"), (name, field)


def test_the_docs_list_presets_and_fields():
    text = (Path(__file__).parents[2] / "docs/sensors.md").read_text()
    chapter = text.partition("# Sensors")[2].partition("\n# ")[0]
    cells = [line.split("|")[1] for line in chapter.splitlines() if line.startswith("| `")]
    named = {name for cell in cells for name in re.findall(r"`(\w[\w-]*)`", cell)}
    fields = Sensor.model_fields
    assert named <= {*presets(), *fields}
    assert {*presets(), *(name for name in fields if fields[name].is_required())} <= named
    for name in cameras():
        assert f"`{name}`" in chapter or name == "mtf-only"


@pytest.mark.parametrize("name", presets())
def test_a_preset_renders_what_its_data_sheet_says(name: str):
    """An even frame at a fifth of the full well: mean and variance of each site, in DN."""
    # Transfer of charge mixes neighbours, by half a DN of Kodak's sensor: see test_ccd_chain.
    left_out = {"veiling_glare": 0.0, "parallel_cti": None, "serial_cti": None}
    sensor = load_sensor(name).roi(48, 64).model_copy(update=left_out)
    pitch = sensor.pixel_pitch_um
    half = (0.5 * pitch, 0.5 * pitch)
    bank = gaussian_bank(half, pitch_um=pitch / 8, circle_um=60 * pitch, fields=4)
    bank = with_exit_pupil(bank, np.inf)  # for a quantum efficiency by angle
    rates = spectral_weights(bank, sensor).sum(axis=1) @ FLAT
    exposure_s = 0.2 * sensor.full_well_e / float(rates.max())
    scene = Scene("even", FLAT[None], Chart(("white",), 0, ()), "E", FLAT)
    renderer = Renderer(camera_of(bank, sensor), scene, Accuracy(1e-3, 0), exposure_s=exposure_s)
    try:
        raw = renderer.capture(exposure_s, seed=5).raw.astype(np.float64)
    finally:
        renderer.release()
    gain, (py, px) = sensor.system_gain_dn_per_e, sensor.period
    # A channel's place in `rates`: spectral_weights gives one row for each of `channels`.
    for site, channel in enumerate(sensor.site_channels()):
        light_e = exposure_s * float(rates[sensor.channels.index(channel)])
        mean_e = light_e + exposure_s * sensor.dark_current_e_per_s
        spread_e = [
            math.sqrt(mean_e),
            sensor.temporal_dark_noise_e,
            sensor.dsnu_e,
            light_e * sensor.prnu_percent / 100,
            1 / math.sqrt(12) / gain,
        ]
        expected = np.array(
            [sensor.black_level_dn + gain * mean_e, gain * np.hypot.reduce(spread_e)]
        )
        values = raw[site // px :: py, site % px :: px]
        # 5 sigma of the mean of n and of a standard deviation of n, and 1e-3 of the optics.
        sigmas = 5 * expected[1] / np.sqrt(values.size * np.array([1, 2]))
        found = np.array([values.mean(), values.std()])
        off = np.abs(found - expected) - [1e-3 * gain * light_e, 0]
        assert np.all(off < sigmas), (channel, found, expected)


@pytest.mark.parametrize("name", cameras())
def test_the_lens_of_a_camera_covers_its_sensor(name: str):
    camera = load_camera(name)
    assert camera.title
    if isinstance(camera.lens, Prescription):
        corner_mm = math.hypot(camera.sensor.rows, camera.sensor.cols) / 2e3
        corner_mm *= camera.sensor.pixel_pitch_um
        rim = math.tan(math.radians(camera.lens.max_field_deg))
        assert corner_mm < first_order(camera.lens).efl_mm * rim
