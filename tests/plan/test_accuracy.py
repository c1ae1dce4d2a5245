"""Tolerances: relative ones, those in sigmas of the noise, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from optics.made import FLAT, RED, bank, monochrome, scene, sensor
from optics.made import shapes as shapes_of

from gpusim.errors import UserError
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.plan.signal import brightest_e
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene


@pytest.mark.parametrize(
    ("text", "tolerance", "unit"),
    [
        ("1e-3", 1e-3, "relative"),
        ("0.01", 1e-2, "relative"),
        ("0.1sigma", 0.1, "sigma"),
        (" 0.05 sigma ", 0.05, "sigma"),
        ("2sigma", 2.0, "sigma"),
    ],
)
def test_a_tolerance_in_words(text: str, tolerance: float, unit: str):
    assert Accuracy.parse(text, 8) == Accuracy(tolerance, 8, unit)
    assert Accuracy.parse(Accuracy.parse(text).text) == Accuracy(tolerance, unit=unit)


@pytest.mark.parametrize(
    "text", ["", "sigma", "abc", "0.1 sigmas", "0.1sigmasigma", "nan", "nansigma", "infsigma",
             "0sigma", "-0.1sigma", "0.0009sigma", "10.1sigma", "0.2", "1e-6"]
)  # fmt: skip
def test_other_words_are_refused(text: str):
    with pytest.raises(UserError, match="tolerance") as caught:
        Accuracy.parse(text)
    assert caught.value.field == "tolerance" and "sigma" in caught.value.allowed


def test_there_are_two_units():
    with pytest.raises(UserError, match="unit") as caught:
        Accuracy(0.1, 8, "decibel")
    assert caught.value.allowed == "relative, sigma"


def test_a_relative_accuracy_is_one_already():
    assert Accuracy(1e-3, 8).relative(100.0, 3.0, 8000.0) == Accuracy(1e-3, 8)


@pytest.mark.parametrize(("brightest", "full_well"), [(500.0, 8000.0), (9e9, 8000.0), (3.0, 10.0)])
def test_no_signal_up_to_the_brightest_errs_by_more_than_the_sigmas(brightest, full_well):
    """At each signal the relative tolerance is at most k of its own sigmas, at the brightest k."""
    for k in (0.01, 0.1):
        accuracy = Accuracy(k, 8, "sigma").relative(brightest, 3.0, full_well)
        assert (accuracy.unit, accuracy.probes) == ("relative", 8)
        signal = np.geomspace(1e-3, min(brightest, full_well), 50)
        sigmas = accuracy.tolerance * signal / np.sqrt(signal + 3.0**2)
        assert sigmas.max() == sigmas[-1] <= k * (1 + 1e-12)
        if accuracy.tolerance < 0.1:  # a tenth of the signal is as loose as the engine goes
            assert sigmas[-1] == pytest.approx(k)


def test_darkness_asks_for_nothing():
    assert Accuracy(0.1, 8, "sigma").relative(0.0, 3.0, 8000.0).tolerance == 0.1


def test_what_float32_cannot_hold_is_refused_with_its_floor():
    accuracy = Accuracy(1e-3, 8, "sigma")
    with pytest.raises(UserError, match=r"cannot be met.*float32") as caught:
        accuracy.relative(1e7, 0.0, 1e7)  # 1e-3 sqrt(1e7) / 1e7 = 3e-7
    floor = float(caught.value.allowed.split("sigma")[0])
    assert floor == pytest.approx(1e-5 * np.sqrt(1e7), rel=0.1)
    assert Accuracy(1.1 * floor, 8, "sigma").relative(1e7, 0.0, 1e7).tolerance >= 1e-5


def test_the_brightest_signal_of_a_chart_is_that_of_its_brightest_material():
    lens, camera = bank(falloff=0.0), monochrome()
    white = float((spectral_weights(lens, camera).sum(axis=1) @ FLAT)[0])
    subject = scene(shapes_of(), np.stack([0.1 * FLAT, FLAT, 0.5 * FLAT, 0.2 * FLAT]))
    assert brightest_e(lens, camera, subject, 0.01) == pytest.approx(0.01 * white)
    glaring = monochrome(veiling_glare=0.5)
    assert brightest_e(lens, glaring, subject, 0.01) == pytest.approx(0.015 * white)
    # A lens that passes more light off the axis makes the brightest pixel brighter.
    assert brightest_e(bank(falloff=-0.2), camera, subject, 0.01) > 0.0119 * white
    black = scene((), np.stack([0 * FLAT]))
    assert brightest_e(lens, camera, black, np.inf) == 0.0


def test_the_brightest_signal_of_a_photograph_is_that_of_one_sample():
    lens, camera = bank(falloff=0.0), sensor()
    planes = np.zeros((2, 3, 4), np.float32)
    planes[0, 1, 2], planes[1, 1, 2] = 2.0, 3.0
    planes[0, 2, 0], planes[1, 0, 0] = 2.5, 4.0
    subject = Scene("photograph", np.stack([FLAT, RED]), Raster(planes), "D65", FLAT)
    channels = spectral_weights(lens, camera).sum(axis=1) @ np.stack([FLAT, RED]).T
    expected = (channels @ [2.0, 3.0]).max()
    assert brightest_e(lens, camera, subject, 1.0) == pytest.approx(expected)
