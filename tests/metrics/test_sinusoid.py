"""Sinusoids: frequency and amplitude against the closed form, their uncertainty, refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from command_line import assert_refused, gpusim

from gpusim.errors import UserError
from gpusim.metrics.picture import Plane
from gpusim.metrics.sinusoid import Bend, measure_sinusoid

OPEN = (-np.inf, np.inf)
BOX = (7, 5, 70, 60)
MEAN, MODULATION = 0.4, 0.6


def wave(f_x, f_y, shape=(72, 90)):
    """Return the mean over each pixel's square of 0.4 (1 + 0.6 cos), with a slope of the light."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    own = np.sinc(f_x) * np.sinc(f_y) * np.cos(2 * np.pi * (f_x * x + f_y * y) + 0.7)
    return MEAN * (1 + MODULATION * own) + 3e-4 * (x - 42)


@pytest.mark.parametrize(
    ("f_x", "f_y"), [(1 / 3, 0), (0.25, 0), (0.2, 0), (0, 1 / 3), (0.173, -0.09), (0.061, 0.04)]
)
def test_frequency_and_amplitude_are_those_of_the_closed_form(f_x, f_y):
    found = measure_sinusoid(Plane(wave(f_x, f_y), None, OPEN), BOX)
    # The law is the pattern's own: nothing but rounding is left.
    assert found.frequency_cy_px.value == pytest.approx(np.hypot(f_x, f_y), rel=1e-6)
    assert found.frequency_y.value == pytest.approx(f_y, abs=1e-7)
    aperture = np.sinc(f_x) * np.sinc(f_y)
    assert found.amplitude.value == pytest.approx(MEAN * MODULATION * aperture, rel=1e-6)
    assert found.modulation.value == pytest.approx(MODULATION * aperture, rel=1e-5)
    # At 1/4 cycle/px and beyond, twice the frequency looks like another one.
    assert found.harmonic is None if max(f_x, f_y) >= 0.25 else found.harmonic < 1e-6


def test_a_second_harmonic_is_found():
    values = wave(0.11, 0.02)
    values += 0.1 * (values - MEAN) ** 2
    found = measure_sinusoid(Plane(values, None, OPEN), BOX)
    # c (a cos)^2 = c a^2 / 2 (1 + cos 2); the slope of the light takes part in it, a little.
    own = MEAN * MODULATION * np.sinc(0.11) * np.sinc(0.02)
    assert found.harmonic == pytest.approx(0.1 * own / 2, rel=0.05)


def test_a_filter_arrays_photosites_are_measured_where_they_lie():
    values = wave(0.13, 0.05)
    rows, cols = np.indices(values.shape)
    sites = np.array([[False, True], [False, False]])
    values[(rows % 2 != 0) | (cols % 2 != 1)] = -5.0  # other filters: none of it may be seen
    found = measure_sinusoid(Plane(values, sites, OPEN), BOX)
    assert found.frequency_x.value == pytest.approx(0.13, abs=1e-6)
    assert found.amplitude.value == pytest.approx(0.24 * np.sinc(0.13) * np.sinc(0.05), rel=1e-5)


def test_uncertainties_are_the_spread_of_noisy_pictures():
    rng, clean = np.random.default_rng(5), wave(0.21, 0.03)
    runs = 25
    found = [
        measure_sinusoid(Plane(clean + 0.05 * rng.normal(size=clean.shape), None, OPEN), BOX)
        for _ in range(runs)
    ]
    for name in ("frequency_x", "frequency_y", "amplitude", "frequency_cy_px"):
        values = np.array([getattr(one, name).value for one in found])
        stated = np.mean([getattr(one, name).u for one in found])
        # A spread of 25 values is known to 14 %; three of those.
        assert values.std(ddof=1) == pytest.approx(stated, rel=0.43), name


def test_what_cannot_be_measured_is_refused():
    plane = Plane(wave(0.2, 0), None, OPEN)
    noise = Plane(np.random.default_rng(1).normal(size=(72, 90)), None, OPEN)
    for one, box, words in (
        (plane, (60, 0, 70, 60), "leaves the picture"),
        (plane, (0, 0, 12, 60), "too small"),
        (Plane(plane.values, None, (0.0, 0.5)), BOX, "clipped"),
        (Plane(np.full((72, 90), 0.5), None, OPEN), BOX, "no wave"),
        (noise, (0, 0, 16, 16), "no wave"),
    ):
        with pytest.raises(UserError, match=words):
            measure_sinusoid(one, box)


def test_the_command_writes_its_files(tmp_path):
    np.save(tmp_path / "wave.npy", np.concatenate([wave(0.25, 0), wave(0.2, 0.05)], axis=1))
    out = tmp_path / "out"
    ran = gpusim(
        "measure", "spectra", tmp_path / "wave.npy", "--roi", "5,5,70,60", "--roi", "100,5,70,60",
        "--out", out,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    first, second = json.loads((out / "spectra.json").read_text())["waves"]
    assert first["frequency_cy_px"]["value"] == pytest.approx(0.25, abs=1e-6)
    assert second["frequency_y"]["value"] == pytest.approx(0.05, abs=1e-6)
    rows = list(csv.reader((out / "spectra.csv").open()))
    assert len(rows) == 202 and len(rows[0]) == 3
    assert (out / "spectra.png").stat().st_size > 20_000
    assert "Second harmonic" in (out / "spectra.html").read_text()
    assert_refused(gpusim("measure", "spectra", tmp_path / "wave.npy", "--roi", "1,2"), "--roi")


CENTRE, CORNER, BENT = (160.0, 120.0), 200.0, (0.08, -0.01)


def distorted(f_x, f_y):
    """Return a wave of the undistorted picture, seen by r_u = r_d (1 + k_1 r_d^2 + k_2 r_d^4)."""
    y, x = np.mgrid[:240, :320] + 0.5
    x, y = x - CENTRE[0], y - CENTRE[1]
    square = (x**2 + y**2) / CORNER**2
    ratio = 1 + BENT[0] * square + BENT[1] * square**2
    return MEAN * (1 + MODULATION * np.cos(2 * np.pi * ratio * (f_x * x + f_y * y)))


@pytest.mark.parametrize(("f_x", "f_y"), [(0.2, 0.0), (0.0, 0.25), (0.12, -0.07)])
@pytest.mark.parametrize("corner", [(20, 16), (140, 100), (270, 180), (20, 100)])
def test_the_frequency_without_distortion_is_that_of_the_chart(f_x, f_y, corner):
    found = measure_sinusoid(Plane(distorted(f_x, f_y), None, OPEN), (*corner, 24, 24))
    straight = Bend(BENT, CENTRE, CORNER).undistorted(found)
    # Over 24 px the frequency changes by 6 k_1 f r / 200 px * 24 px, 5 % at r = 0.8, evenly about
    # the middle but for the next power, (12 / 200)^2 * 6 k_1 = 0.2 %.
    assert straight == pytest.approx(np.hypot(f_x, f_y), rel=2e-3)


def test_distortion_is_a_number_or_what_measure_distortion_writes(tmp_path):
    np.save(tmp_path / "wave.npy", distorted(0.2, 0.0))
    file = tmp_path / "distortion.json"
    models = {"chosen": {"coefficients": list(BENT)}}
    file.write_text(json.dumps({"centre_px": list(CENTRE), "corner_px": CORNER, "models": models}))

    def ran(distortion, *how):
        done = gpusim(
            "measure", "spectra", tmp_path / "wave.npy", "--roi", "148,10,24,24", "--distortion",
            distortion, *how,
        )  # fmt: skip
        assert done.code == 0, done.err
        return done.out

    assert "without distortion" in ran(file, "--out", tmp_path / "out")
    assert "Undistorted, c/px" in (tmp_path / "out" / "spectra.html").read_text()
    (one,) = json.loads((tmp_path / "out" / "spectra.json").read_text())["waves"]
    assert one["undistorted_cy_px"] == pytest.approx(0.2, rel=2e-3)
    assert one["frequency_cy_px"]["value"] == pytest.approx(
        one["over_undistorted"] * one["undistorted_cy_px"], rel=1e-12
    )
    (one,) = json.loads(ran("-3", "--json"))["waves"]
    assert one["over_undistorted"] == pytest.approx(1 / 0.97, rel=1e-12)
    for wrong in ("-100", "nan", tmp_path / "wave.npy"):
        ran = gpusim("measure", "spectra", tmp_path / "wave.npy", "--distortion", wrong)
        assert_refused(ran, "distortion")
