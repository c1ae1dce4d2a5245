"""The bank's part of the certificate: a sound bank passes, and each defect in one turns it red.

The double Gauss of the demonstration camera at f/2.8, traced anew in float64 around the corner of
its sensor, behind an edge of 1 : 5; nothing is rendered.
"""

from dataclasses import fields as dataclass_fields
from dataclasses import replace

import numpy as np
import pytest
from optics.made import FLAT, monochrome, scene

from gpusim.certify import ExactModel, Measure, Placed, compare
from gpusim.certify.bank import WIDER, bank_share
from gpusim.formats.lens_file import load_prescription
from gpusim.plan import Accuracy
from gpusim.psf.compute import compute_bank
from gpusim.psf.halo import distances_um
from gpusim.psf.sampling import default_fields_deg
from gpusim.reference.exact_model import ExactCore
from gpusim.scene.chart import Rect
from gpusim.scene.spectra import WAVELENGTHS_NM

SENSOR = monochrome(1520, 2028)
ORIGIN, SHAPE = (1300, 1700), (96, 128)
EDGE = scene((Rect(0.0, 0.0, 3.0, 0.72, 0.08, 1),), np.stack([FLAT, 0.2 * FLAT]))
LINES_NM = np.arange(400.0, 701.0, 25.0)
RED_AT = Accuracy(tolerance=1e-3)
EXPOSURE_S = 0.01


@pytest.fixture(scope="module")
def lens():
    return load_prescription("double-gauss").scaled(8.3).stopped(2.8).limited(14.3)


@pytest.fixture(scope="module")
def sound(lens):
    return compute_bank(lens, LINES_NM, default_fields_deg(lens, 15))


@pytest.fixture(scope="module")
def placed():
    return EDGE.source.placed(SENSOR.rows / 2 * SENSOR.pixel_pitch_um)


@pytest.fixture(scope="module")
def rate(sound, placed):
    """Give what tells where edges are, and how bright: the scene, hardly blurred."""
    row, col = np.indices(SHAPE)
    x = (col + ORIGIN[1] + 0.5 - SENSOR.cols / 2) * SENSOR.pixel_pitch_um
    y = (row + ORIGIN[0] + 0.5 - SENSOR.rows / 2) * SENSOR.pixel_pitch_um
    x, y, _ = sound.ideal_points(x, y)
    (edge,) = placed.primitives
    inside = 1 / (1 + np.exp(edge.distance(x, y) / 2.0))
    where = np.array([ORIGIN])
    exact = ExactCore(sound.levels[0], SENSOR, EDGE.spectra, WAVELENGTHS_NM).chart(placed, where)[0]
    share = 1 + (0.2 - 1) * inside
    return (exact * share / share[0, 0]).astype(np.float32)


@pytest.fixture
def judged(lens, placed, rate):
    """Judge a bank: its share of the error, and whether a render without other errors is met."""

    def judge(bank):
        exact, by = ExactModel(bank, SENSOR, EDGE, placed), Measure(SENSOR, EXPOSURE_S, RED_AT)
        found = bank_share(exact, lens, Placed(rate, (*ORIGIN, *SHAPE)), by)
        pixels = np.argwhere(rate > 0)[:50]
        own = rate[tuple(pixels.T)].astype(float)
        shares = {"bank": found.share, "window": found.window}
        certificate = compare(by, pixels, own, own, seconds=0.0, **shares)
        return found, certificate.met

    return judge


def test_a_sound_bank_is_within_the_tolerance(sound, judged):
    found, met = judged(sound)
    assert met and 0 < found.share.rms < 0.2 * RED_AT.tolerance
    assert found.window < 0.1 * RED_AT.tolerance


def of_fields(bank, kept):
    """Return some fields of a bank."""
    parts = {"halo": bank.halo[:, kept]}
    for one in dataclass_fields(bank):
        value = getattr(bank, one.name)
        if np.ndim(value) and len(value) == len(bank.field_deg):
            parts[one.name] = value[kept]
    return replace(bank, **parts)


def five_nm_off(bank):
    """Say of each PSF that it is of a wavelength 5 nm longer."""
    lines = bank.wavelengths_nm + 5
    return replace(bank, wavelengths_nm=lines, reference_nm=bank.reference_nm + 5)


def halved(bank):
    """Cut the PSFs at half their radius, and tell the halo nothing."""
    size = bank.psf.shape[-1]
    inside = distances_um(size, bank.pitch_um) < size / 4 * bank.pitch_um
    return replace(bank, psf=bank.psf * inside.astype(np.float32))


def of_unit_sum(bank):
    """Put the light that lands outside the window into it."""
    total = bank.psf.sum(axis=(2, 3), keepdims=True, dtype=float)
    return replace(bank, psf=(bank.psf / total).astype(np.float32), halo=np.zeros_like(bank.halo))


def test_what_a_narrow_window_leaves_to_the_halo_is_seen(lens, sound, judged, monkeypatch):
    """The judge finds half of what one with a window twice as wide as its own finds, and more.

    The light that a rim throws beyond r goes as 1 / r: half of what lies outside a window lies
    within one twice as wide. A judge with the bank's own window would share what the bank lacks.
    """
    narrow = compute_bank(lens, LINES_NM, sound.field_deg, size=96)
    found, _ = judged(narrow)
    monkeypatch.setattr("gpusim.certify.bank.WIDER", 2 * WIDER)
    wider, _ = judged(narrow)
    assert found.share.rms > 0.5 * wider.share.rms > 0.2 * RED_AT.tolerance


@pytest.mark.parametrize("defect", [five_nm_off, halved, of_unit_sum])
def test_a_defect_in_the_bank_turns_the_certificate_red(sound, judged, defect):
    found, met = judged(defect(sound))
    assert not met and found.share.rms > RED_AT.tolerance


def test_a_field_that_is_dropped_turns_the_certificate_red(sound, judged):
    """Cubics bridge a gap of 300 um between fields, and not one of 600 um.

    Towards the rim, where the lens changes most, 150 um.
    """
    found, met = judged(of_fields(sound, [0, 2, 4, 6, 8, 10, 11, 12, 13, 14]))
    assert met and found.share.rms < 0.7 * RED_AT.tolerance
    found, met = judged(of_fields(sound, [0, 2, 4, 6, 8, 12, 14]))
    assert not met and found.share.rms > RED_AT.tolerance
