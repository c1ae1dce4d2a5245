"""Properties of the whole chain, on a camera of 96 x 128 pixels with a lens made of Gaussians."""

from __future__ import annotations

import gc
import math
import os
import re
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import wgpu
from harness import assert_close
from optics.made import FLAT, RED, ULP, StubCamera, bank, monochrome, scene, sensor, shapes
from scipy.special import ndtr

from gpusim.errors import UserError
from gpusim.gpu import Device, DeviceLostError, Recording
from gpusim.optics import paint
from gpusim.optics.spectral_basis import spectral_weights
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.plan.ways import WHOLE
from gpusim.render import Capture, Renderer, capture
from gpusim.scene.chart import Disc, Rect
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.sensor.adc_model import GainStep
from gpusim.sensor.cfa import ColourFilterArray
from gpusim.sensor.noise_model import Defects, LineNoise, ResetNoise

LENS = bank(coma_um=0.6, falloff=0.1, halo=0.01)
CAMERA = StubCamera(LENS, sensor())
EXPOSURE_S = 0.01
COARSE = Accuracy(tolerance=1e-2, probes=0)
PER_PLANE = ("fft rows", "fft columns", "products", "paint", "edges", "kernels", "spectra")
TAIL = ("tail",)  # cut PSFs, though they are cheaper whole on a frame so small
EVEN = scene(spectra=FLAT[None])
PITCH = 1.55
# What two ways to the same sum may differ by: see optics/test_convolve, and paint's weights agree.
ROUNDING = 300 * ULP


@contextmanager
def rendering(
    camera, subject, accuracy=COARSE, force=TAIL, method="fft", **more
) -> Iterator[Renderer]:
    renderer = Renderer(camera, subject, accuracy, force=force, method=method, **more)
    try:
        yield renderer
    finally:
        renderer.release()


def rates(camera, subject, accuracy=COARSE, **more) -> np.ndarray:
    """Return electrons/s of each pixel, in float64."""
    with rendering(camera, subject, accuracy, **more) as renderer:
        return renderer.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with rendering(CAMERA, scene(shapes())) as one:
        yield one


@pytest.fixture(scope="module")
def whole(renderer: Renderer) -> Capture:
    return renderer.capture(EXPOSURE_S, seed=5, keep=("rate", "electrons"))


def test_the_plan_of_these_tests_uses_all_parts(renderer: Renderer):
    plan = renderer.plan
    assert [scale.name for scale in plan.scales] == ["core", "tail"]
    assert (
        len({*renderer.on_device.sources[0].needed.values()}) > 1
    )  # some blocks need fewer planes
    assert np.prod(plan.scales[0].grid.blocks) > 4


# What the light does


# Round PSFs, alike over the field, with tails: kernels do not change from node to node. (Coma and
# lateral colour grow with the height, and so magnify: they make an even field darker.)
ALIKE = {"coma_um": 0.0, "falloff": 0.0, "halo": 0.02, "lateral": (0.0, 0.0, 0.0)}


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.13, -0.21)])
def test_energy_of_an_object_is_conserved(place: tuple[float, float]):
    """The electrons of all pixels are those of the disc's area, wherever the PSF put them."""
    lens = bank(**ALIKE, distortion=0.0)
    camera = StubCamera(lens, monochrome())
    half_um = 96 * PITCH / 2
    radius = 0.2
    dot = scene((Disc(*place, radius, 1),), np.stack([0 * FLAT, FLAT]))
    with rendering(camera, dot) as one:
        assert len(one.plan.scales) == 2
        found = one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
    even = spectral_weights(lens, camera.sensor).sum(axis=1)[0] @ FLAT
    expected = even * np.pi * (radius * half_um / PITCH) ** 2
    # A disc of 24 sigma: 0.1 / 24^2 of a ring as wide as its Gaussian, 2 % of its area: 4e-6;
    # weights good to 1e-6 but for edges, where they err to both sides (5e-4 of 10 % of the area);
    # PSFs' energy through their splines 3e-5.
    assert found.sum() == pytest.approx(expected, rel=1e-4)


def dot_image(
    real: np.ndarray, flare: np.ndarray, shares: np.ndarray, shape: tuple[int, int]
) -> np.ndarray:
    """Return the light of points (P, 2), um, in each pixel, as the test lens spreads it.

    Gaussians through apertures: three quarters of them on the chief ray and a quarter, 1.2 times as
    wide, displaced by the flare (P, 2). `shares` of light by wavelength.
    """
    image = np.zeros(shape)
    for share, sigma in zip(shares, (0.95, 1.0, 1.15), strict=True):
        for part, width, place in ((0.75, sigma, real), (0.25, 1.2 * sigma, real + flare)):
            boxes = [
                np.diff(ndtr((PITCH * (np.arange(n + 1) - n / 2) - at[:, None]) / width), axis=1)
                for n, at in zip(shape[::-1], place.T, strict=True)
            ]
            image += share * part * np.einsum("py,px->yx", boxes[1], boxes[0]) / len(real)
    return image


def test_coma_flares_outwards_in_every_direction():
    """Three dots, in no line and at no angle that a mirror or a transposition leaves alone.

    x right, y down. A quarter of the light lies 4 um outwards at the rim, and linearly less inside.
    """
    lens = bank(coma_um=4.0, falloff=0.0, lateral=(0.0, 0.0, 0.0), distortion=-0.03)
    camera = StubCamera(lens, monochrome())
    half_um = 96 * PITCH / 2
    radius = 0.06
    places = [(0.95, 0.1), (-0.2, 0.75), (-0.8, -0.45)]
    dots = tuple(Disc(*place, radius, 1) for place in places)
    found = rates(camera, scene(dots, np.stack([0 * FLAT, FLAT])))

    steps = (np.arange(30) + 0.5) / 30
    r, phi = np.meshgrid(radius * half_um * np.sqrt(steps), 2 * np.pi * steps)  # equal areas
    around = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1).reshape(-1, 2)
    weights = spectral_weights(lens, camera.sensor)[0] @ FLAT
    expected = {1.0: 0.0, -1.0: 0.0}
    for way in expected:
        for place in np.array(places):
            ideal = place * half_um + around
            height = np.hypot(*ideal.T)[:, None]
            real = ideal / height * lens.real_from_ideal(height)[0]
            flare = way * 4.0 * real / lens.image_circle_um
            expected[way] += dot_image(real, flare, weights, found.shape)
    # Barrel distortion makes the dots smaller: by up to 3 x 0.03 (75 / 165)^2 of their area.
    light = found.sum() / expected[1.0].sum()
    assert light / (np.pi * (radius * half_um / PITCH) ** 2) == pytest.approx(0.99, abs=0.01)
    # The plan's tolerance is for one edge; a dot has two.
    assert_close(found / light, expected[1.0], atol=2 * COARSE.tolerance * expected[1.0].max())
    # A control: flares the other way.
    assert np.abs(found / light - expected[-1.0]).max() > 0.2 * expected[1.0].max()


def test_the_signal_is_linear_in_the_light(whole: Capture):
    spectra = 3.0 * scene(shapes()).spectra
    found = rates(CAMERA, scene(shapes(), spectra))
    assert_close(found, 3.0 * whole.rate, atol=ROUNDING * found.max())


def test_an_even_field_is_the_weights_times_the_illumination():
    lens = bank(**ALIKE | {"falloff": 0.1})
    found = rates(StubCamera(lens, CAMERA.sensor), EVEN)
    y, x = (np.indices(found.shape) + 0.5 - np.array([48, 64])[:, None, None]) * PITCH
    radius = np.hypot(x, y)
    light = [np.interp(radius, lens.real_height_um[:, 1], k) for k in lens.relative_illumination.T]
    weights = spectral_weights(lens, CAMERA.sensor) @ FLAT
    expected = np.empty(found.shape)
    for site, channel in enumerate([2, 1, 1, 0]):  # B G / G R
        part = np.s_[site // 2 :: 2, site % 2 :: 2]
        expected[part] = np.einsum("l,lyx->yx", weights[channel], np.stack(light)[:, *part])
    # Bilinear between nodes, as far apart as the tolerance allows.
    assert_close(found, expected, rtol=COARSE.tolerance)


def test_an_even_field_through_an_even_lens_is_constant():
    lens = bank(**ALIKE)
    found = rates(StubCamera(lens, CAMERA.sensor), EVEN)
    weights = spectral_weights(lens, CAMERA.sensor).sum(axis=1) @ FLAT
    expected = np.tile(weights[[2, 1]], (48, 64)).repeat(2, axis=0)
    expected[1::2, 0::2], expected[1::2, 1::2] = weights[1], weights[0]
    # Energies of kernels through their splines: 3e-5 in each of two scales (see
    # optics/test_kernels), and what their ends cut off the ringing of the band's end: 1e-4.
    assert_close(found, expected, rtol=2e-4)


def test_the_certificate_is_met():
    with rendering(CAMERA, scene(shapes()), Accuracy(tolerance=1e-2, probes=10)) as one:
        seen = []
        shot = one.capture(EXPOSURE_S, progress=lambda *step: seen.append(step))
    certificate = shot.certificate
    assert certificate.met and certificate.probes == len(certificate.points) == 10
    assert 1e-6 < certificate.rms_relative < 1e-2
    assert shot.rate is None
    assert seen[-1] == ("certify", 10, 10)
    rendered = [step for step in seen if step[0] == "render"]
    assert [done for _, done, _ in rendered] == list(range(1, rendered[-1][2] + 1))


@pytest.mark.parametrize("method", ["direct", "modes", None])
def test_each_method_meets_the_certificate(method: str | None):
    accuracy = Accuracy(tolerance=1e-2, probes=10)
    with rendering(CAMERA, scene(shapes()), accuracy, force=(), method=method) as one:
        shot = one.capture(EXPOSURE_S, keep=("rate",))
        tiled = one.capture(EXPOSURE_S, tile_px=50, keep=("rate",))
    assert shot.certificate.met and 1e-6 < shot.certificate.rms_relative
    if method is not None:
        assert method in shot.times_s and "fft rows" not in shot.times_s
    assert_close(tiled.rate, shot.rate, atol=0)


def test_where_the_psf_is_alike_everywhere_one_mode_serves():
    """One PSF for all; PSF nodes, forced, change nothing beyond the kernels' rounding."""
    camera = StubCamera(bank(**ALIKE), monochrome())
    tight = Accuracy(1e-3, 0)
    found = {}
    for method in ("modes", "fft"):
        with rendering(camera, scene(shapes()), tight, force=(), method=method) as one:
            found[method] = one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
            if method == "modes":
                assert {convolve.rank for convolve in one.on_device.convolutions} == {1}
    # Energies of turned kernels through their splines, 3e-5 (see the even field), of two kernels;
    # and the ends of both, which cut off the ringing of the band's end: 1e-4.
    assert_close(found["modes"], found["fft"], atol=2e-4 * found["fft"].max())
    # The control: where PSFs change over the field, one mode is not enough.
    with rendering(CAMERA, scene(shapes()), tight, force=(), method="modes") as one:
        assert one.on_device.convolutions[0].rank > 1


def test_a_filter_pattern_of_four_by_four_meets_the_certificate():
    """Sixteen sites, of which each sees its own channel, in the core of the PSF and in its tail."""
    quad = ColourFilterArray(pattern=[list("BBGG")] * 2 + [list("GGRR")] * 2)
    lens = bank(coma_um=0.6, falloff=0.1, halo=0.1)
    camera = StubCamera(lens, sensor(48, 64, cfa=quad))
    with rendering(camera, scene(shapes()), Accuracy(tolerance=1e-2, probes=16)) as one:
        assert [scale.name for scale in one.plan.scales] == ["core", "tail"]
        assert one.capture(EXPOSURE_S).certificate.met


def test_veiling_glare_is_added_evenly(whole: Capture):
    glaring = StubCamera(LENS, sensor(veiling_glare=0.02))
    with rendering(glaring, scene(shapes())) as one:
        found = one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
        glare = one.glare.astype(float)
    added = np.tile(glare.reshape(2, 2), (48, 64))
    assert 0.01 < (added / whole.rate.mean()).mean() < 0.03
    assert_close(found - whole.rate, added, atol=2 * ULP * found.max())


# What must not matter


@pytest.mark.parametrize("tile_px", [34, 51, 64])
def test_tiles_change_not_one_bit(renderer: Renderer, whole: Capture, tile_px: int):
    found = renderer.capture(EXPOSURE_S, seed=5, tile_px=tile_px, keep=("rate", "electrons"))
    assert_close(found.rate, whole.rate, atol=0)
    assert_close(found.electrons, whole.electrons, atol=0)
    assert_close(found.raw, whole.raw, atol=0)


def test_the_same_seed_gives_the_same_frame_and_another_does_not(
    renderer: Renderer, whole: Capture
):
    again = renderer.capture(EXPOSURE_S, seed=5, keep=("rate",))
    assert_close(again.raw, whole.raw, atol=0)
    assert_close(again.rate, whole.rate, atol=0)
    for other in ({"seed": 5, "frame": 1}, {"seed": 6}, {"seed": 5 + 2**40}):
        shot = renderer.capture(EXPOSURE_S, keep=("rate",), **other)
        assert_close(shot.rate, whole.rate, atol=0)
        assert 0.5 < np.mean(shot.raw != whole.raw) < 1


def test_shots_of_a_bracket_have_noise_of_their_own():
    """One seed, one frame number: another exposure or gain is another draw, the same is not."""
    even = {"prnu_percent": 0.0, "dsnu_e": 0.0, "temporal_dark_noise_e": 3.0}
    steps = [GainStep(gain=1), GainStep(gain=4)]
    plain = monochrome(**even, analogue_gains=steps)
    deviates = {}
    for gain in (1, 4):
        with rendering(StubCamera(bank(), plain.at_gain(gain)), scene(shapes())) as one:
            for exposure_s in (EXPOSURE_S, 1.001 * EXPOSURE_S, EXPOSURE_S):
                shot = one.capture(exposure_s, seed=5, keep=("rate", "electrons"))
                mean = exposure_s * shot.rate.astype(float)
                found = ((shot.electrons - mean) / np.sqrt(mean + 9)).ravel()
                if (again := deviates.get((gain, exposure_s))) is not None:
                    assert_close(found, again, atol=0)
                deviates[gain, exposure_s] = found
    n = found.size
    matrix = np.corrcoef(list(deviates.values()))
    assert matrix.shape == (4, 4)
    # Draws are independent, normal with 1 / n: 5 sigma.
    assert np.abs(matrix - np.eye(4)).max() < 5 / math.sqrt(n)


def test_one_frame_alone_is_as_in_a_series():
    with rendering(CAMERA, scene(shapes()), force=(), method=None) as one:
        one.capture(EXPOSURE_S, seed=4)
        whole = one.capture(EXPOSURE_S, seed=5, keep=("electrons",))
    alone = capture(
        CAMERA, scene(shapes()), exposure_s=EXPOSURE_S, seed=5, accuracy=COARSE, keep=("electrons",)
    )
    assert_close(alone.raw, whole.raw, atol=0)
    assert_close(alone.electrons, whole.electrons, atol=0)
    assert alone.rate is None and alone.certificate is None


def test_planes_that_are_left_out_are_zero(monkeypatch, whole: Capture):
    """All planes in all blocks, against those that the planner found to be needed."""
    listed = paint.primitives_by_block

    def everything(chart, coefficients, *more):
        seen, needed = listed(chart, coefficients, *more)
        return seen, dict.fromkeys(needed, coefficients.shape[1])

    monkeypatch.setattr(paint, "primitives_by_block", everything)
    found = rates(CAMERA, scene(shapes()))
    assert_close(found, whole.rate.astype(float), atol=ROUNDING * found.max())


QUIET = {"prnu_percent": 0.0, "dsnu_e": 0.0, "temporal_dark_noise_e": 0.0}


FIRST = sensor().first_row, sensor().first_col  # defects are counted on the chip
MUCH = {
    "dcnu_percent": 50.0,
    "full_well_knee": 0.8,
    "lines": LineNoise(prnu_row_percent=1, dsnu_column_e=3, row_noise_e=2),
    "reset_noise": ResetNoise(noise_e=4),
    "defects": Defects(
        pixels=[
            {"row": FIRST[0] + 20, "col": FIRST[1] + 30, "kind": "stuck", "value": 77},
            {"row": FIRST[0] + 21, "col": FIRST[1] + 30, "kind": "dead"},
        ],
        hot_fraction=0.01,
        hot_e_per_s=1e5,
    ),
}


def test_a_sensor_with_every_noise_is_the_same_in_tiles():
    camera = StubCamera(LENS, sensor(**MUCH))
    with rendering(camera, scene(shapes())) as one:
        assert all(
            map(one.plan.runs, ("dcnu", "soft saturation", "defects", "prnu lines", "line noise"))
        )
        kept = {"seed": 5, "keep": ("electrons",)}
        shot = one.capture(EXPOSURE_S, **kept)
        part = one.capture(EXPOSURE_S, tile=(27, 18, 9, 7), **kept)
        cut = one.capture(EXPOSURE_S, tile_px=32, **kept)
        warm = one.capture(EXPOSURE_S, temperature_c=80, **kept)
    assert_close(part.electrons, shot.electrons[18:25, 27:36].copy(), atol=0)
    assert_close(cut.electrons, shot.electrons, atol=0)
    assert shot.electrons[20, 30] == 77 and shot.electrons[21, 30] < 50
    assert (shot.temperature_c, warm.temperature_c) == (25.0, 80.0)
    # Dark current 640 times as high, and the hot pixels' too
    assert warm.electrons.mean() > shot.electrons.mean() + 5


def test_a_temperature_that_is_none_is_refused(renderer: Renderer):
    with pytest.raises(UserError, match="not a temperature"):
        renderer.capture(EXPOSURE_S, temperature_c=-274)


@pytest.mark.parametrize(
    ("camera", "stages"),
    [
        (StubCamera(LENS, monochrome(**QUIET)), ("mosaic", "prnu", "dsnu", "read noise")),
        (StubCamera(LENS, sensor(**QUIET)), ("prnu", "dsnu", "read noise")),
        (StubCamera(LENS, sensor()), ("prnu lines", "dcnu", "dsnu lines", "reset noise")),
        (StubCamera(LENS, sensor()), ("line noise",)),
    ],
    ids=["monochrome", "colour", "lines", "line noise"],
)
def test_stages_at_identity_are_left_out_and_forcing_them_changes_nothing(camera, stages):
    shots = []
    for force in (TAIL, (*TAIL, *stages)):
        with rendering(camera, scene(shapes()), force=force) as one:
            shots.append(one.capture(EXPOSURE_S, seed=5, keep=("rate", "electrons")))
            assert [one.plan.runs(stage) for stage in stages] == [force != TAIL] * len(stages)
    left_out, forced = shots
    assert_close(left_out.raw, forced.raw, atol=0)
    assert_close(left_out.electrons, forced.electrons, atol=0)
    assert_close(left_out.rate, forced.rate, atol=0)
    if "mosaic" in stages:
        assert "mosaic" not in left_out.times_s and "mosaic" in forced.times_s
    # The control: a sensor that needs them runs them, and its frame is another.
    made = monochrome if "mosaic" in stages else sensor
    needs = StubCamera(LENS, made(**({} if "prnu" in stages else MUCH)))
    with rendering(needs, scene(shapes())) as one:
        assert all(one.plan.runs(stage) for stage in stages if stage != "mosaic")
        assert np.any(one.capture(EXPOSURE_S, seed=5).raw != left_out.raw)


def test_what_a_lens_does_not_do_is_left_out_and_forcing_it_changes_nothing():
    """Neither distortion nor lateral colour: polynomials and shifts, forced, are ones and zeros."""
    camera = StubCamera(bank(lateral=(0.0, 0.0, 0.0), distortion=0.0), sensor())
    names = ("distortion", "lateral")
    found = []
    for force in (TAIL, (*TAIL, *names)):
        with rendering(camera, scene(shapes()), force=force) as one:
            assert [one.plan.runs(name) for name in names] == [force != TAIL] * 2
            found.append(one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float))
    # Forced, the PSFs go through float32 transforms, and the edges through polynomials: positions
    # of 300 samples err by 300 ULP, with up to 1 / (sqrt(2 pi) 0.8) of an edge to the sample.
    assert_close(found[1], found[0], atol=ROUNDING * found[0].max() + 300 * ULP * found[0].max())
    assert np.any(found[1] != found[0])
    # The control: a lens that has both.
    with rendering(CAMERA, scene(shapes())) as one:
        assert all(map(one.plan.runs, names))


def test_without_noise_the_frame_is_the_mean_signal_up_to_the_full_well(whole: Capture):
    small = StubCamera(LENS, sensor(full_well_e=float(whole.rate.max()) * EXPOSURE_S / 2))
    with rendering(small, scene(shapes()), noise=False) as one:
        shot = one.capture(EXPOSURE_S, seed=5, keep=("rate", "electrons"))
        again = one.capture(EXPOSURE_S, seed=6)
        assert not any(map(one.plan.runs, ("noise", "prnu", "dsnu", "read noise")))
    assert "noise" not in shot.times_s
    assert_close(shot.rate, whole.rate, atol=0)
    assert_close(again.raw, shot.raw, atol=0)
    full = small.sensor.full_well_e
    dark_e = EXPOSURE_S * small.sensor.dark_current_e_per_s
    mean = np.minimum(whole.rate.astype(float) * EXPOSURE_S + dark_e, full)
    assert_close(shot.electrons, mean, rtol=4 * ULP)
    assert 0.01 < np.mean(shot.electrons == np.float32(full)) < 0.99
    dn = small.sensor.system_gain_dn_per_e * shot.electrons + small.sensor.black_level_dn
    assert np.abs(shot.raw - dn).max() <= 0.5 + 1e-3


def test_planes_that_the_camera_cannot_tell_apart_are_left_out():
    """Shades of one spectrum: one plane. A plane for each changes nothing beyond rounding."""
    shades = np.outer([1, 0.1, 0.5, 0.02], FLAT)
    found = {}
    # Rates with which planes are free: the blocks are the same then.
    free = {name: 0.0 for name in PER_PLANE}
    costs = replace(LAVAPIPE, ns=LAVAPIPE.ns | free)
    for force in (TAIL, (*TAIL, "spectra")):
        with rendering(CAMERA, scene(shapes(), shades), force=force, costs=costs) as one:
            found[one.plan.basis.coefficients.shape[1]] = one.capture(
                EXPOSURE_S, keep=("rate",)
            ).rate.astype(float)
    assert sorted(found) == [1, 4]
    assert_close(found[1], found[4], atol=ROUNDING * found[4].max())


def test_blocks_beyond_the_image_circle_are_left_out(monkeypatch):
    """A circle within the frame: what lies well beyond it is black, and forced it stays so."""
    lens = bank(coma_um=0.6, falloff=0.1, circle_um=60.0, size=32)
    camera = StubCamera(lens, monochrome())
    with rendering(camera, EVEN, Accuracy(3e-3, 0), force=()) as one:
        assert 0 in one.on_device.sources[0].needed.values()
        assert "beyond the image circle" in one.plan.text()
        plan = one.plan
        found = one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
    bounds = paint.block_bounds_um

    def all_lit(*given):
        low, high, lit = bounds(*given)
        return low, high, np.ones_like(lit)

    monkeypatch.setattr(paint, "block_bounds_um", all_lit)
    # The same plan: with more blocks to work on, another layout may be the cheapest.
    with rendering(camera, EVEN, Accuracy(3e-3, 0), plan=plan) as one:
        assert 0 not in one.on_device.sources[0].needed.values()
        forced = one.capture(EXPOSURE_S, keep=("rate",)).rate.astype(float)
    assert found[0, 0] == 0 and found.max() > 0
    assert_close(found, forced, atol=ROUNDING * forced.max())


def test_kernels_of_mirror_images_are_left_out(monkeypatch):
    """Made all the same, they change nothing beyond rounding; the plan says how many are made."""
    loose = Accuracy(1e-2, 0)
    with rendering(CAMERA, scene(shapes()), loose, force=(WHOLE,), method="fft") as one:
        assert [convolve.folds for convolve in one.on_device.convolutions] == [(True, True)]
        plan = one.plan
        shot = one.capture(EXPOSURE_S, keep=("rate",))
    rows = next(stage for stage in plan.stages if stage.name == "fft rows")
    said = re.findall(r"kernels of (\d+)", rows.reason)
    assert sum(map(int, said)) == shot.work["nodes"]
    monkeypatch.setattr("gpusim.optics.convolve.folds_of", lambda *given: (False, False))
    with rendering(CAMERA, scene(shapes()), loose, plan=plan) as one:
        every = one.capture(EXPOSURE_S, keep=("rate",))
    assert every.work["nodes"] > shot.work["nodes"]
    assert_close(shot.rate, every.rate.astype(float), atol=ROUNDING * every.rate.max())


def test_memory_is_given_back(device: Device):
    before = device.pool.in_use
    one = Renderer(CAMERA, scene(shapes()), COARSE)
    assert device.pool.in_use > before
    one.capture(EXPOSURE_S)
    held = device.pool.in_use  # with the kernels, which the next frame needs as well
    one.drop_light()
    shot = one.capture(EXPOSURE_S)
    assert device.pool.in_use == held
    assert shot.work["nodes"] == 0 < shot.work["blocks"]
    one.release()
    assert device.pool.in_use == before


# What comes back


def test_exposure_makes_digital_numbers_of_the_rates(renderer: Renderer, whole: Capture):
    camera = CAMERA.sensor
    assert whole.raw.dtype == np.uint16 and whole.raw.shape == (96, 128)
    mean = whole.rate * EXPOSURE_S
    codes = camera.system_gain_dn_per_e * mean + camera.black_level_dn
    # Over 12288 pixels: noise of at most sqrt(500) + 3 electrons, each, PRNU 0.7 %.
    assert (whole.raw - codes).mean() == pytest.approx(0, abs=4 * 26 * 0.47 / np.sqrt(12288) + 0.2)
    assert np.abs(whole.raw - codes).max() < 7 * 26 * 0.47
    twice = renderer.capture(2 * EXPOSURE_S, keep=("rate",))
    assert_close(twice.rate, whole.rate, atol=0)
    signal = twice.raw.mean() - camera.black_level_dn, whole.raw.mean() - camera.black_level_dn
    assert signal[0] == pytest.approx(2 * signal[1], rel=0.01)


def test_a_capture_says_how_it_was_made(renderer: Renderer, whole: Capture):
    assert whole.camera is CAMERA and whole.plan is renderer.plan and whole.accuracy is COARSE
    assert (whole.seed, whole.frame, whole.exposure_s) == (5, 0, EXPOSURE_S)
    assert set(whole.prepare_s) == {"lens", "plan", "scene", "kernels", "halo"}
    running = {
        "paint",
        "fft rows",
        "fft columns",
        "inverse fft",
        "mosaic",
        "exposure",
        "noise",
        "adc",
    }
    assert set(whole.times_s) == running and min(whole.times_s.values()) > 0
    assert whole.device["adapter"] and whole.wall_s > 0
    white = spectral_weights(LENS, CAMERA.sensor).sum(axis=1) @ FLAT * EXPOSURE_S
    assert list(whole.white_e) == ["R", "G", "B"]
    assert_close(np.array(list(whole.white_e.values())), white, rtol=1e-12)


def photograph(planes: np.ndarray, other: np.ndarray = RED) -> Scene:
    return Scene("photograph", np.stack([FLAT, other]), Raster(planes), "D65", FLAT)


def test_an_even_photograph_is_an_even_chart():
    lens = bank(**ALIKE)
    camera = StubCamera(lens, CAMERA.sensor)
    planes = np.stack([np.full((6, 8), 0.5), np.full((6, 8), 0.25)]).astype(np.float32)
    with rendering(camera, photograph(planes, 0.4 * FLAT)) as one:
        shot = one.capture(EXPOSURE_S, keep=("rate",))
        assert {"warp"} <= set(shot.times_s) and "paint" not in shot.times_s
    weights = spectral_weights(lens, camera.sensor).sum(axis=1) @ (0.5 * FLAT + 0.25 * 0.4 * FLAT)
    expected = np.tile(weights[[2, 1]], (48, 64)).repeat(2, axis=0)
    expected[1::2, 0::2], expected[1::2, 1::2] = weights[1], weights[0]
    assert_close(shot.rate.astype(float), expected, rtol=2e-4)  # as for the chart


def test_a_photograph_meets_the_certificate_and_tiles_alike():
    rng = np.random.default_rng(6)
    planes = rng.uniform(0.2, 1, (2, 24, 32)).astype(np.float32)
    with rendering(CAMERA, photograph(planes), Accuracy(tolerance=1e-2, probes=6)) as one:
        shot = one.capture(EXPOSURE_S, keep=("rate",))
        tiled = one.capture(EXPOSURE_S, tile_px=52, keep=("rate",))
    assert shot.certificate.met and 1e-6 < shot.certificate.rms_relative
    assert_close(tiled.rate, shot.rate, atol=0)
    assert_close(tiled.raw, shot.raw, atol=0)


# Rectangles, and memory


def inside(rect: tuple[int, int, int, int]) -> tuple[slice, slice]:
    x, y, width, height = rect
    return np.s_[y : y + height, x : x + width]


RECTANGLES = [
    (0, 0, 128, 96),
    (0, 0, 1, 1),
    (127, 95, 1, 1),
    (17, 31, 40, 23),
    (64, 1, 3, 95),
    (1, 50, 127, 2),
]


@pytest.mark.parametrize("rect", RECTANGLES)
def test_a_rectangle_is_that_of_the_frame_bit_for_bit(
    renderer: Renderer, whole: Capture, rect: tuple[int, int, int, int]
):
    found = renderer.capture(EXPOSURE_S, seed=5, tile=rect, keep=("rate", "electrons"))
    assert found.rect == (rect[1], rect[0], rect[3], rect[2])
    for name in ("raw", "rate", "electrons"):
        part = np.ascontiguousarray(getattr(whole, name)[inside(rect)])
        assert_close(getattr(found, name), part, atol=0)


WIDE = StubCamera(bank(coma_um=0.6, falloff=0.1, halo=0.01, circle_um=360.0), sensor(240, 320))


def wide_photograph() -> Scene:
    rng = np.random.default_rng(6)
    return photograph(rng.uniform(0.2, 1, (2, 60, 80)).astype(np.float32))


@pytest.mark.parametrize("subject", [scene(shapes()), wide_photograph()], ids=["chart", "photo"])
def test_a_rectangle_alone_takes_less_work_and_gives_the_same_bits(subject: Scene):
    rng = np.random.default_rng(11)
    with rendering(WIDE, subject) as one:
        full = one.capture(EXPOSURE_S, seed=3, keep=("rate",))
    for _ in range(2):
        x, y = (int(n) for n in rng.integers(0, (260, 180)))
        rect = (x, y, 41, 37)
        with rendering(WIDE, subject) as one:
            part = one.capture(EXPOSURE_S, seed=3, tile=rect, keep=("rate",))
        assert_close(part.raw, np.ascontiguousarray(full.raw[inside(rect)]), atol=0)
        assert_close(part.rate, np.ascontiguousarray(full.rate[inside(rect)]), atol=0)
        assert part.work["blocks"] < full.work["blocks"] / 2
        # The lens has no mirror images. With one that has them the whole frame takes few more.
        every = sum(math.prod(scale.grid.nodes) for scale in full.plan.scales)
        assert part.work["nodes"] < every * 2 / 3
        # Those on the axes are their own mirror images.
        assert part.work["nodes"] <= full.work["nodes"] < 0.6 * every
        assert part.memory["peak_bytes"] < full.memory["peak_bytes"]


def test_a_rectangle_is_certified_by_probes_inside_it(whole: Capture):
    with rendering(CAMERA, scene(shapes()), Accuracy(tolerance=1e-2, probes=4)) as one:
        part = one.capture(EXPOSURE_S, tile=(33, 21, 30, 25))
    assert part.certificate.met and part.certificate.probes == 4
    for probe in part.certificate.points:  # their places are those in the frame
        assert 21 <= probe.row < 46 and 33 <= probe.col < 63
        assert probe.render == pytest.approx(whole.rate[probe.row, probe.col] * EXPOSURE_S)


@pytest.mark.parametrize("subject", [scene(shapes()), wide_photograph()], ids=["chart", "photo"])
def test_a_small_budget_is_held_and_changes_not_one_bit(subject: Scene):
    with rendering(WIDE, subject, force=()) as one:
        full = one.capture(EXPOSURE_S, seed=3)
        least = one.on_device.least_bytes()
    assert "kernels" not in full.times_s  # all of them fit: they were made beforehand
    assert full.memory["budget_bytes"] == one.device.pool.budget
    # Glare, tables of the chart, and a few kernels more than a block has.
    budget = one.device.pool.in_use + least + (3 << 20)
    small = capture(
        WIDE,
        subject,
        exposure_s=EXPOSURE_S,
        seed=3,
        accuracy=COARSE,
        memory_bytes=budget,
        method="fft",
    )
    assert small.memory == {
        "budget_bytes": budget,
        "peak_bytes": small.memory["peak_bytes"],
    }
    assert small.memory["peak_bytes"] <= budget < full.memory["peak_bytes"]
    assert small.times_s["kernels"] > 0 and small.work["nodes"] >= full.work["nodes"]
    assert_close(small.raw, full.raw, atol=0)


def test_a_budget_below_the_smallest_tile_is_refused(device: Device):
    with rendering(CAMERA, scene(shapes()), force=()) as one:
        least = one.on_device.least_bytes()
    before = device.pool.in_use
    given = {"exposure_s": 0.1, "accuracy": COARSE, "method": "fft"}
    with pytest.raises(UserError, match="does not hold the smallest tile") as caught:
        capture(CAMERA, scene(shapes()), **given, memory_bytes=before + least // 2)
    assert caught.value.field == "memory" and "at least" in caught.value.allowed
    assert device.pool.in_use == before
    allowed = int((float(caught.value.allowed.split()[2]) + 0.1) * 2**20)  # a tenth of a MiB
    found = capture(CAMERA, scene(shapes()), **given, memory_bytes=allowed)
    assert found.memory["peak_bytes"] <= allowed


class Limited:
    """A device without memory: for all beyond so many bytes, or for large buffers of a label."""

    def __init__(self, device: Device, nbytes: float, label: str = "", largest: int = 0) -> None:
        self.real, self.pool = device.gpu, device.pool
        self.nbytes, self.label, self.largest = nbytes, label, largest
        self.refused = 0

    def create_buffer(self, *, label: str, size: int, usage: int) -> object:
        """Return a buffer, or say that there is no memory."""
        self.check(label, size)
        return self.real.create_buffer(label=label, size=size, usage=usage)

    def create_texture(self, *, label: str, size: tuple[int, int, int], **given: object) -> object:
        """Return a texture of texels of 16 bytes, or say that there is no memory."""
        self.check(label, 16 * math.prod(size))
        return self.real.create_texture(label=label, size=size, **given)

    def check(self, label: str, nbytes: int) -> None:
        """Refuse what is more than there is."""
        full = self.pool.in_use + self.pool.idle + nbytes > self.nbytes
        if full or (label == self.label and nbytes > self.largest):
            self.refused += 1
            raise wgpu.GPUOutOfMemoryError("Not enough memory left.")


def limited(monkeypatch: pytest.MonkeyPatch, device: Device, *limits: object) -> Limited:
    device.pool.clear()
    adapter = Limited(device, *limits)
    monkeypatch.setattr(device.pool, "_device", adapter)
    return adapter


def test_an_adapter_with_less_than_the_budget_gives_the_same_bits(monkeypatch, device: Device):
    subject = wide_photograph()
    with rendering(WIDE, subject) as one:
        full = one.capture(EXPOSURE_S, seed=3)
        least = one.on_device.least_bytes()
    adapter = limited(monkeypatch, device, device.pool.in_use + least + (2 << 20))
    with rendering(WIDE, subject) as one:
        for _ in range(2):
            found = one.capture(EXPOSURE_S, seed=3)
            assert_close(found.raw, full.raw, atol=0)
    assert adapter.refused and found.memory["peak_bytes"] < full.memory["peak_bytes"]
    assert "kernels" in found.times_s


def test_where_the_memory_ends_tiles_are_halved(monkeypatch, device: Device):
    """No planes of more than 100 KiB: tiles of a quarter of the frame."""
    subject = wide_photograph()
    with rendering(WIDE, subject) as one:
        full = one.capture(EXPOSURE_S, seed=3)
        before = device.pool.budget
        adapter = limited(monkeypatch, device, np.inf, "rates", 100 << 10)
        steps = []
        found = one.capture(EXPOSURE_S, seed=3, progress=lambda *step: steps.append(step))
    assert full.work["tiles"] == 1 and found.work["tiles"] > 2 and adapter.refused > 1
    assert found.notes[-1].startswith("GPU memory ran out: tiles of at most ")
    assert_close(found.raw, full.raw, atol=0)
    assert device.pool.budget == before
    assert steps[-1][1] == steps[-1][2]


def test_planning_is_a_phase_between_the_lens_and_the_render(device: Device):
    steps = []
    one = Renderer(
        WIDE, wide_photograph(), Accuracy(1e-2, 0), device, lambda *step: steps.append(step)
    )
    one.release()
    assert steps[-2:] == [("plan", 0, 1), ("plan", 1, 1)]


def test_where_the_smallest_tile_does_not_fit_it_says_what_is_needed(monkeypatch, device: Device):
    subject = wide_photograph()
    with rendering(WIDE, subject) as one:
        least = one.on_device.least_bytes()
    before = device.pool.in_use
    with rendering(WIDE, subject) as one:
        limited(monkeypatch, device, device.pool.in_use + least // 2)  # in use: the scene's
        with pytest.raises(UserError, match="does not hold the smallest tile") as caught:
            one.capture(EXPOSURE_S, seed=3)
    assert caught.value.field == "memory" and "MiB" in caught.value.value
    assert "at least" in caught.value.allowed
    assert device.pool.in_use == before


def test_a_lost_device_ends_the_render_and_says_so(monkeypatch):
    own = Device.open(os.environ.get("GPUSIM_ADAPTER"))
    one = Renderer(CAMERA, scene(shapes()), COARSE, own)
    run, left = Recording.run, [3]

    def breaks_off(self: Recording, *given: object) -> object:
        left[0] -= 1
        if not left[0]:
            own.gpu.destroy()
        return run(self, *given)

    monkeypatch.setattr(Recording, "run", breaks_off)
    with pytest.raises(DeviceLostError, match="device was lost"):
        one.capture(EXPOSURE_S)
    one.release()
    assert own.lost


def test_planes_may_be_kept_in_files(renderer: Renderer, whole: Capture, tmp_path: Path):
    found = renderer.capture(EXPOSURE_S, seed=5, keep=("rate",), folder=tmp_path)
    assert isinstance(found.raw, np.memmap) and isinstance(found.rate, np.memmap)
    assert_close(np.load(tmp_path / "dn.npy"), whole.raw, atol=0)
    assert_close(np.load(tmp_path / "rate.npy"), whole.rate, atol=0)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["dn.npy", "rate.npy"]


# Tolerances in sigmas


def test_a_tolerance_in_sigmas_plans_for_the_exposure_and_is_met():
    """Dim light asks for less; without an exposure the plan counts on the full well."""
    accuracy = Accuracy(0.3, 6, "sigma")
    subject = scene(shapes())
    nodes = {}
    for exposure_s in (0.001, 0.05, None):
        one = Renderer(CAMERA, subject, accuracy, exposure_s=exposure_s)
        try:
            nodes[exposure_s] = np.prod(one.plan.scales[0].grid.nodes)
            if exposure_s == 0.001:
                certificate = one.capture(0.001).certificate
                assert certificate.met and 1e-6 < certificate.rms_sigma < 0.3
                with pytest.raises(UserError, match="exposure") as caught:
                    one.capture(0.0011)
                assert "0.001 s or less" in caught.value.allowed
        finally:
            one.release()
    assert nodes[0.001] < nodes[0.05] <= nodes[None]
    shot = capture(CAMERA, subject, exposure_s=0.001, accuracy=accuracy)
    assert shot.certificate.met and shot.accuracy is accuracy


# What is refused


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("exposure", {"exposure_s": 0.0}),
        ("exposure", {"exposure_s": -1.0}),
        ("exposure", {"exposure_s": float("inf")}),
        ("exposure", {"exposure_s": float("nan")}),
        ("seed", {"seed": -1}),
        ("seed", {"seed": 2**64}),
        ("frame", {"frame": -1}),
        ("frame", {"frame": 2**32}),
        ("tile-size", {"tile_px": 1}),
        ("tile-size", {"tile_px": 0}),
        ("tile", {"tile": (0, 0, 129, 1)}),
        ("tile", {"tile": (0, 0, 1, 97)}),
        ("tile", {"tile": (128, 0, 1, 1)}),
        ("tile", {"tile": (-1, 0, 5, 5)}),
        ("tile", {"tile": (3, 3, 0, 5)}),
        ("tile", {"tile": (3, 3, 5, -2)}),
    ],
)
def test_values_out_of_range_are_refused(renderer: Renderer, field: str, given: dict):
    with pytest.raises(UserError, match="out of range") as caught:
        renderer.capture(**{"exposure_s": EXPOSURE_S, **given})
    assert caught.value.field == field and caught.value.allowed
    assert (
        caught.value.value == next(iter(given.values()))
        or given["exposure_s"] != given["exposure_s"]
    )


def test_the_smallest_sensors_work():
    for rows, cols in ((2, 2), (3, 5)):
        camera = StubCamera(LENS, sensor().model_copy(update={"rows": rows, "cols": cols}))
        found = rates(camera, scene((Rect(0, 0, 0.5, 0.5, 0.2, 1),)))
        assert found.shape == (rows, cols) and np.isfinite(found).all() and found.min() > 0


def test_a_renderer_goes_with_its_last_name(monkeypatch):
    """Its kernels are hundreds of megabytes, too few objects for the collector of cycles to come.

    The direct sum is refused: the error once held the plan's frames, and these the renderer.
    """
    monkeypatch.setattr("gpusim.plan.parts.DIRECT_REACH", 0)
    gc.collect()
    gc.disable()
    try:
        with rendering(CAMERA, scene(shapes()), Accuracy(1e-2, 4), (), None) as one:
            one.capture(EXPOSURE_S)
            assert any("does not fit" in other.lost for other in one.plan.runners_up)
        gone = weakref.ref(one)
        del one
        assert gone() is None
    finally:
        gc.enable()
