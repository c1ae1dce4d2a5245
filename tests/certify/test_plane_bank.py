"""The bank's part of the certificate for a lens without an axis: defects turn it red.

The double Gauss of the demonstration camera at f/2.8 with its second element moved, over a grid of
field angles, traced anew at points that are no nodes, behind an edge of 1 : 5; nothing is rendered.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from optics.made import FLAT, monochrome, scene

from gpusim.certify import ExactModel, Measure, Placed
from gpusim.certify import bank as bank_module
from gpusim.certify.bank import bank_share
from gpusim.certify.places import pixels_near, points_of
from gpusim.formats.lens_file import load_prescription
from gpusim.plan import Accuracy
from gpusim.psf.compute_plane import compute_plane_bank
from gpusim.psf.halo import distances_um
from gpusim.reference.exact_model import ExactCore
from gpusim.scene.chart import Rect
from gpusim.scene.spectra import WAVELENGTHS_NM

SENSOR = monochrome(1000, 1000)
ORIGIN, SHAPE = (600, 700), (300, 200)
EDGE = scene((Rect(0.0, 0.0, 3.0, 0.5, 0.08, 1),), np.stack([FLAT, 0.2 * FLAT]))
SIDE_DEG = np.linspace(-6.0, 6.0, 7)
LINES_NM = np.arange(400.0, 701.0, 75.0)
ASKED = Accuracy(tolerance=1e-3)


@pytest.fixture(scope="module")
def lens():
    whole = load_prescription("double-gauss").scaled(8.3).stopped(2.8).limited(8.6)
    return whole.with_element_moved(3, 5, (0.02, 0.01), (0.1, 0.0))


@pytest.fixture(scope="module")
def sound(lens):
    settings = {"reference_nm": LINES_NM[2], "size": 64}
    return compute_plane_bank(lens, LINES_NM, SIDE_DEG, SIDE_DEG, **settings)


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
    where = np.array([[ORIGIN[0] + SHAPE[0] - 1, ORIGIN[1]]])
    exact = ExactCore(sound.levels[0], SENSOR, EDGE.spectra, WAVELENGTHS_NM).chart(placed, where)[0]
    share = 1 + (0.2 - 1) * inside
    return (exact * share / share[-1, 0]).astype(np.float32)


@pytest.fixture
def judged(lens, placed, rate):
    def judge(bank, of=None):
        exact = ExactModel(bank, SENSOR, EDGE, placed)
        shown, by = Placed(rate, (*ORIGIN, *SHAPE)), Measure(SENSOR, 0.01, ASKED)
        return bank_share(exact, of or lens, shown, by)

    return judge


def test_a_sound_bank_is_within_the_tolerance_and_says_how_it_was_judged(sound, judged):
    found = judged(sound)
    assert 0 < found.share.rms < 0.7 * ASKED.tolerance
    assert any("image points" in note and "traced anew" in note for note in found.notes)


def of_fields(bank, kept):
    """Return some columns of fields of a bank."""
    names = ("chief_x_um", "chief_y_um", "psf", "relative_illumination")
    parts = {name: getattr(bank, name)[:, kept] for name in names}
    x_deg = bank.field_x_deg[kept]
    return replace(bank, field_x_deg=x_deg, halo=bank.halo[:, :, kept], **parts)


def a_fifth_of_a_step_off(bank):
    """Say of each PSF that it is of a wavelength 15 nm longer."""
    lines = bank.wavelengths_nm + 15
    return replace(bank, wavelengths_nm=lines, reference_nm=bank.reference_nm + 15)


def halved(bank):
    """Cut the PSFs at half their radius, and tell the halo nothing."""
    size = bank.psf.shape[-1]
    inside = distances_um(size, bank.pitch_um) < size / 4 * bank.pitch_um
    return replace(bank, psf=bank.psf * inside.astype(np.float32))


def upside_down(bank):
    """Turn the PSFs about the x axis."""
    return replace(bank, psf=bank.psf[..., ::-1, :])


def without_a_column(bank):
    return of_fields(bank, [0, 1, 2, 6])


@pytest.mark.parametrize("defect", [a_fifth_of_a_step_off, halved, upside_down, without_a_column])
def test_a_defect_in_the_bank_turns_the_certificate_red(sound, judged, defect):
    assert judged(defect(sound)).share.rms > ASKED.tolerance


def test_a_ready_made_bank_is_judged_by_its_own_fields(sound, judged):
    found = judged(sound, object())
    assert 0 < found.share.rms < ASKED.tolerance
    assert any("every other field" in note for note in found.notes)
    few = of_fields(sound, [0, 3, 6])
    assert judged(few, object()).share.rms == 0


def test_places_lie_next_to_the_middles_of_cells_and_in_the_frame(sound, rate):
    points, numbers = points_of(sound, SENSOR, SHAPE, ORIGIN, between=True)
    assert len(points) == len(set(numbers)) > 1
    field = np.stack(sound.field_deg(*points.T))
    share = np.mod(field - SIDE_DEG[0], 2.0) / 2.0
    # Whole cells are judged in their middles; cells that the frame cuts are judged where it ends.
    assert (np.abs(share - 0.5).max(axis=0) < 0.05).any() and (np.abs(share - 0.5) < 0.5).all()
    pixels, owners = pixels_near(SENSOR, rate, ORIGIN, points)
    middle = (pixels[:, ::-1] + 0.5 - 500) * SENSOR.pixel_pitch_um
    assert np.abs(middle - points[owners]).max() <= 129 * SENSOR.pixel_pitch_um


def test_lenses_are_traced_over_wider_windows_than_the_banks(sound, monkeypatch):
    asked = {}

    def traced(lens, **settings):
        asked.update(settings)
        return SimpleNamespace(levels=())

    monkeypatch.setattr(bank_module, "cached_traced_plane_field", traced)
    bank_module._traced_points(sound, object(), np.zeros((1, 2)), None)
    assert asked["size"] == bank_module.WIDER * sound.psf.shape[-1]
    assert asked["pitch_um"] == sound.pitch_um
