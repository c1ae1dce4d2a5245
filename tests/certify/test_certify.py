"""The certificate: where it looks, how it counts, and that it sees what is wrong."""

from __future__ import annotations

import itertools
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from harness import assert_close
from optics.made import FLAT, StubCamera, bank, monochrome, scene, sensor

from gpusim.certify import ExactModel, Measure, Placed, Share, certify, choose_probes
from gpusim.certify import engine as certify_module
from gpusim.certify.budget import EXACT, Judged, settled
from gpusim.certify.probes import FEWEST, MOST, rounds
from gpusim.gpu.wgsl import shaders_root
from gpusim.optics import convolve
from gpusim.plan import Accuracy
from gpusim.render import Renderer
from gpusim.scene.chart import Rect

# Where it looks


@pytest.mark.parametrize("count", [1, 2, 9, 16, 64])
@pytest.mark.parametrize("shape", [(96, 128), (128, 30), (7, 5)])
def test_probes_are_spread_over_the_field(shape: tuple[int, int], count: int):
    rate = np.random.default_rng(1).uniform(1, 2, shape)
    probes = choose_probes(rate, 2, count)
    assert probes.shape == (count, 2)
    assert (probes >= 0).all() and (probes < shape).all()
    if count >= 16 and min(shape) > 20:
        for half in (probes[: count // 2], probes[count // 2 :]):
            for axis in (0, 1):  # on both sides of the middle, and out towards the borders
                assert (
                    half[:, axis].min()
                    < shape[axis] / 3
                    < shape[axis] * 2 / 3
                    < half[:, axis].max()
                )


def test_no_probes_are_none():
    assert choose_probes(np.ones((9, 9)), 2, 0).shape == (0, 2)


def test_half_of_the_probes_lie_on_the_steepest_edges():
    rate = np.ones((80, 80))
    rng = np.random.default_rng(2)
    steps = {}
    for row in range(4):  # four by four parts, a faint and a steep step in each
        for col in range(4):
            at = (20 * row + rng.integers(3, 9), 20 * col + rng.integers(3, 17))
            rate[at] = 1.5
            steep = (20 * row + rng.integers(12, 17), 20 * col + rng.integers(3, 17))
            rate[steep] = 9.0
            steps[row, col] = steep
    probes = choose_probes(rate, 2, 32)
    on_steps = 0
    for row, col in probes[16:]:
        steep = steps[row // 20, col // 20]
        # On the bright pixel itself, or on the next of its colour.
        on_steps += (row, col) in {steep, (steep[0] + 2, steep[1]), (steep[0], steep[1] + 2)}
    assert on_steps == 16
    assert len({(row // 20, col // 20) for row, col in probes[16:]}) == 16


def test_the_filter_pattern_is_no_edge():
    """Sites of different sensitivity, and one faint step between pixels of one colour."""
    rate = np.tile([[1.0, 5.0], [5.0, 20.0]], (20, 20))
    rate[10, 16] += 0.3
    probe = choose_probes(rate, 2, 2)[1]
    assert tuple(probe) in {(10, 16), (12, 16), (10, 18)}


def test_two_renders_are_probed_alike():
    rate = np.random.default_rng(3).uniform(1, 2, (50, 60))
    assert_close(choose_probes(rate.copy(), 2, 20), choose_probes(rate, 2, 20), atol=0)


@pytest.mark.parametrize(("count", "first"), [(256, 64), (100, 30), (5, 5), (1, 1), (64, 64)])
def test_rounds_hold_every_probe_once_and_edges_in_proportion(count: int, first: int):
    found = rounds(count, first)
    assert [len(one) for one in found][:1] == [first]
    assert sorted(np.concatenate(found)) == list(range(count))
    for before, one in pairwise(itertools.accumulate(map(len, found))):
        assert one in (2 * before, count)
    for one in found:
        edges = np.count_nonzero(one >= count - count // 2)
        assert abs(edges - len(one) / 2) <= 1


# How it counts


class FakeCore:
    """1000 electrons/s plus ten times the row, whatever the scene; black in column 0."""

    def __init__(self, *given: object, **more: object) -> None:
        pass

    def chart(self, chart: object, pixels: np.ndarray) -> np.ndarray:
        """Return the electrons/s at pixels (P, 2)."""
        return np.where(pixels[:, 1] == 0, 0.0, 1000.0 + 10 * pixels[:, 0])


def certificate(monkeypatch, rate, glare=0.0, tolerance=1e-2, count=20, **changes):
    monkeypatch.setattr(certify_module, "ExactCore", FakeCore)
    camera = sensor(*rate.shape, **{"temporal_dark_noise_e": 3.0, **changes})
    subject = scene()
    placed = subject.source.placed(10.0)
    exact = ExactModel(bank(), camera, subject, placed)
    by = Measure(camera, 0.1, Accuracy(tolerance, count))
    return certify(exact, whole(rate), np.broadcast_to(glare, 4), by)


def whole(rate: np.ndarray) -> Placed:
    return Placed(rate, (0, 0, *rate.shape))


def sound(rows: int = 30, cols: int = 40) -> np.ndarray:
    rate = 1000.0 + 10 * np.arange(rows)[:, None] + np.zeros(cols)
    rate[:, 0] = 0.0
    return rate


def test_a_sound_render_has_no_error(monkeypatch):
    found = certificate(monkeypatch, sound())
    assert found.rms_relative == found.worst_relative == found.rms_sigma == found.worst_sigma == 0
    assert found.met and found.probes == len(found.points) == 20


def test_a_planted_error_is_measured_in_both_units(monkeypatch):
    found = certificate(monkeypatch, 1.003 * sound())
    truth = np.array([1000.0 + 10 * point.row for point in found.points if point.col]) * 0.1
    assert found.rms_relative == pytest.approx(
        0.003 * np.sqrt(np.mean([p.col > 0 for p in found.points]))
    )
    sigma = 0.003 * truth / np.sqrt(truth + 9)
    assert found.worst_sigma == pytest.approx(sigma.max())
    seen = np.array([point.sigma for point in found.points if point.col])
    assert_close(seen, sigma, rtol=1e-9)
    for point in found.points:
        if point.col:
            assert point.render == pytest.approx(1.003 * point.truth)
            assert point.truth == pytest.approx((1000 + 10 * point.row) * 0.1)


def test_the_worst_probe_is_named_and_may_fail_the_certificate_alone(monkeypatch):
    points = certificate(monkeypatch, sound()).points
    bad = next(point for point in points[3:] if point.col)
    for excess, met in ((0.0999, True), (0.12, False)):
        rate = sound()
        rate[bad.row, bad.col] *= 1 + excess
        # Which pixels are probed depends on the render, but not those of the spread half.
        found = certificate(monkeypatch, rate, tolerance=0.01, count=400)
        assert found.worst_position == (bad.row, bad.col)
        assert found.worst_relative == pytest.approx(excess)
        assert found.rms_relative < 0.01
        assert found.met is met


def test_an_rms_above_the_tolerance_is_not_met(monkeypatch):
    assert certificate(monkeypatch, 1.0099 * sound(), tolerance=0.01).met
    assert not certificate(monkeypatch, 1.0101 * sound()[:, 1:].repeat(2, 1), tolerance=0.01).met


def test_light_where_there_is_none_is_an_error_of_all(monkeypatch):
    rate = sound()
    rate[:, 0] = 1e-3
    found = certificate(monkeypatch, rate, count=400)
    dark = [point for point in found.points if point.col == 0]
    assert dark and all(point.relative == 1.0 for point in dark)
    assert all(point.sigma == pytest.approx(1e-4 / 3.0) for point in dark)


def test_without_noise_there_are_no_sigmas(monkeypatch):
    rate = sound()
    rate[:, 0] = 5.0
    found = certificate(monkeypatch, rate, count=400, temporal_dark_noise_e=0.0)
    assert {point.sigma for point in found.points if point.col == 0} == {0.0}


def test_a_tolerance_in_sigmas_is_judged_in_sigmas(monkeypatch):
    rate = 1.003 * sound()
    found = certificate(monkeypatch, rate)
    rms = found.rms_sigma
    for tolerance, met in ((1.01 * rms, True), (0.99 * rms, False)):
        monkeypatch.setattr(certify_module, "ExactCore", FakeCore)
        camera, subject = sensor(30, 40, temporal_dark_noise_e=3.0), scene()
        exact = ExactModel(bank(), camera, subject, subject.source.placed(10.0))
        by = Measure(camera, 0.1, Accuracy(tolerance, 20, "sigma"))
        judged = certify(exact, whole(rate), np.zeros(4), by)
        assert judged.met is met
        assert judged.rms_relative == found.rms_relative
        # A fixed share of the signal is most sigmas where the signal is largest: the last rows.
        assert judged.worst_position[0] == max(point.row for point in judged.points if point.col)
        assert "sigma of the noise" in judged.confidence
    assert "sigma" not in found.confidence


def test_beyond_the_full_well_no_sigmas_are_counted(monkeypatch):
    """Rows of 100 to 129 electrons; the well holds 115, up to which an error of 10 % is seen."""
    found = certificate(monkeypatch, 1.1 * sound(), count=400, full_well_e=115.0)
    for point in found.points:
        if point.col:
            seen = min(1.1 * point.truth, 115.0) - min(point.truth, 115.0)
            noise = np.sqrt(min(point.truth, 115.0) + 9)
            assert point.sigma == pytest.approx(seen / noise)
            assert point.relative == pytest.approx(0.1)
    assert 0.0 in {point.sigma for point in found.points if point.col}


def test_glare_is_part_of_the_exact_model_by_site(monkeypatch):
    glare = np.array([10.0, 20.0, 30.0, 40.0])
    rate = sound() + np.tile(glare.reshape(2, 2), (15, 20))
    found = certificate(monkeypatch, rate, glare=glare, count=100)
    assert found.worst_relative < 1e-12
    swapped = sound() + np.tile(glare.reshape(2, 2).T, (15, 20))
    assert certificate(monkeypatch, swapped, glare=glare, count=100).worst_relative > 0.005


def test_it_says_what_the_number_of_probes_supports(monkeypatch):
    """The rule of three: fewer than 3/n, at 95 % confidence."""
    assert "15.0%" in certificate(monkeypatch, sound()).confidence
    assert "3.0%" in certificate(monkeypatch, sound(), count=100).confidence
    assert "100.0%" in certificate(monkeypatch, sound(), count=2).confidence


def test_as_many_probes_are_taken_as_settle_the_verdict(monkeypatch):
    """Even errors settle it at once, on either side; two kinds, close to the tolerance, never."""
    rate = sound(90, 120)
    for factor, met in ((1.005, True), (1.02, False)):
        found = certificate(monkeypatch, factor * rate, count=None)
        assert (found.probes, found.met) == (FEWEST, met)
        assert f"{FEWEST} probes of {MOST} settle the verdict" in found.notes[-1]
    halves = np.where(np.arange(rate.shape[1]) // 10 % 2, 1.0135, 1.002)  # 0.97 tolerances RMS
    found = certificate(monkeypatch, halves * rate, count=None)
    assert found.probes == MOST and not any("settle" in note for note in found.notes)
    assert certificate(monkeypatch, 1.005 * rate, count=20).probes == 20


@pytest.mark.parametrize(
    ("mean", "rare", "bank", "expected"),
    [
        (0.5, 0.0, Judged(EXACT, 0.0, ()), True),
        (2.0, 0.0, Judged(EXACT, 0.0, ()), True),  # not met, for certain
        (0.5, 0.0, Judged(EXACT, 0.4, ()), True),
        (0.8, 3.0, Judged(EXACT, 0.0, ()), False),
        (0.7, 6.0, Judged(EXACT, 0.0, ()), False),
        (0.1, 11.0, Judged(EXACT, 0.0, ()), True),  # one probe is beyond what any may be
        (0.1, 0.5, Judged(Share(0.98, 1.0, 8), 0.0, ()), True),
        (0.1, 2.0, Judged(Share(0.98, 1.0, 8), 0.0, ()), False),
    ],
)
def test_a_verdict_is_settled_three_standard_errors_from_the_tolerance(
    mean: float, rare: float, bank: Judged, *, expected: bool
):
    """64 errors, in tolerances: two of them are rare ones."""
    found = np.full(64, mean)
    found[:2] = rare or mean
    assert settled(found, bank, 1.0) is expected


def test_progress_is_told(monkeypatch):
    monkeypatch.setattr(certify_module, "ExactCore", FakeCore)
    subject, seen = scene(), []
    camera = sensor(30, 40)
    exact = ExactModel(bank(), camera, subject, subject.source.placed(10.0))
    by = Measure(camera, 0.1, Accuracy(1e-2, 3))
    certify(exact, whole(sound()), np.zeros(4), by, progress=lambda *step: seen.append(step))
    assert seen == [(1, 3), (2, 3), (3, 3)]


# That it sees what is wrong

CAMERA = StubCamera(bank(coma_um=0.6, falloff=0.1), monochrome(48, 64))
EDGE = scene((Rect(0.1, 0.05, 0.4, 0.35, 0.1, 1),), np.stack([FLAT, 0.2 * FLAT]))
ACCURACY = Accuracy(tolerance=5e-3, probes=8)


def rms(accuracy: Accuracy = ACCURACY) -> float:
    renderer = Renderer(CAMERA, EDGE, accuracy, method="fft")  # whose parts are spoilt below
    try:
        return renderer.capture(0.01).certificate.rms_relative
    finally:
        renderer.release()


@pytest.fixture(scope="module")
def sound_rms() -> float:
    return rms()


def test_the_sound_chain_meets_it(sound_rms: float):
    assert 1e-6 < sound_rms < ACCURACY.tolerance / 2


def test_kernels_one_percent_off_are_seen(monkeypatch, sound_rms: float):
    right = convolve.kernel_spectra

    def brighter(*given, **how):
        return right(*given, **how) * np.float32(1.01)

    monkeypatch.setattr(convolve, "kernel_spectra", brighter)
    assert rms() == pytest.approx(0.01, abs=2 * sound_rms)
    assert rms() > 2 * sound_rms


def test_light_that_lands_a_tenth_of_a_pixel_off_is_seen(monkeypatch, sound_rms: float):
    right = convolve.kernel_spectra

    def shifted(*given, **how):
        *given, outputs = given
        moved = [(channel, x + 0.2, y) for channel, x, y in outputs]  # two samples are a pixel
        return right(*given, moved, **how)

    monkeypatch.setattr(convolve, "kernel_spectra", shifted)
    assert rms() > 5 * sound_rms


@pytest.mark.parametrize(
    ("shader", "line", "planted"),
    [
        (
            "optics/fft_rows",
            "return vec4f(a * (1.0 - s), a * s, b * (1.0 - s), b * s);",
            "return vec4f(a * (0.97 - s), a * s, b * (0.97 - s), b * s);",
        ),
        ("optics/paint", "planes[d] = s.low.x;", "planes[d] = 0.99 * s.low.x;"),
        ("optics/inverse_fft", "rates[i] += pair.x;", "rates[i] += pair.x;"),
    ],
    ids=["a weight", "a factor", "nothing"],
)
def test_a_wrong_shader_is_seen(
    monkeypatch, tmp_path: Path, sound_rms: float, shader: str, line: str, planted: str
):
    root = tmp_path / "shaders"
    shutil.copytree(shaders_root(), root)
    file = root / f"{shader}.wgsl"
    assert line in file.read_text()
    file.write_text(file.read_text().replace(line, planted))
    monkeypatch.setenv("GPUSIM_SHADERS_DIR", str(root))
    if planted == line:  # a control: the copy itself changes nothing
        assert rms() == pytest.approx(sound_rms, rel=1e-9)
    else:
        assert rms() > 2 * sound_rms
