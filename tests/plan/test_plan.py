"""The planner: what runs and why, and that a tighter tolerance never does less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from optics.made import BLUE, FLAT, RED, bank, monochrome, scene, sensor, shapes

from gpusim import gpu
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.optics import spectral_basis
from gpusim.optics.images import field_images
from gpusim.optics.methods import METHODS
from gpusim.plan import Accuracy, Plan, PlanStage, plan_optics
from gpusim.plan.blocks import BLOCK_BYTES
from gpusim.plan.candidates import Candidate
from gpusim.plan.costs import LAVAPIPE
from gpusim.plan.stages import NAME, sensor_runs
from gpusim.plan.ways import OVERSAMPLINGS
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.sensor.cfa import ColourFilterArray

LENS = bank(coma_um=0.5, falloff=0.1)
HALO = bank(coma_um=0.5, falloff=0.1, halo=0.02)
COLOURED = scene(shapes())


def photograph(count: int = 2, size: tuple[int, int] = (12, 16)) -> Scene:
    planes = np.ones((count, *size), np.float32)
    spectra = np.stack([FLAT, RED, BLUE])[:count]
    return Scene("photograph", spectra, Raster(planes), "D65", FLAT)


def stages(plan: Plan) -> dict[str, bool]:
    return {stage.name: stage.runs for stage in plan.stages}


def test_every_stage_says_why_it_runs_or_not():
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    assert [stage.name for stage in plan.stages] == [
        "illumination",
        "paint",
        "warp",
        "dark blocks",
        "image circle",
        "distortion",
        "lateral",
        "halo",
        "qe by angle",
        "fft rows",
        "modes",
        "fft columns",
        "inverse fft",
        "direct",
        "tail",
        "point sources",
        "mosaic",
        "flare",
        "border",
        "crosstalk",
        "prnu",
        "prnu lines",
        "gain mask",
        "dcnu",
        "exposure",
        "defects",
        "smear",
        "two numbers",
        "soft saturation",
        "noise",
        "bloom",
        "parallel cti",
        "serial cti",
        "electrical crosstalk",
        "dsnu",
        "dsnu lines",
        "offset mask",
        "reset noise",
        "read noise",
        "line noise",
        "linearity",
        "column fpn",
        "adc",
        "merge",
    ]
    assert all(stage.reason for stage in plan.stages)
    # What other stages do in passing has no cost of its own.
    in_passing = {
        "image circle",
        "distortion",
        "lateral",
        "tail",
        "flare",
        "prnu",
        "dsnu",
        "read noise",
    }
    for stage in plan.stages:
        timed = stage.runs and stage.name not in in_passing
        assert (stage.predicted_cost_s is not None and stage.predicted_cost_s > 0) == timed
    total = sum(stage.predicted_cost_s or 0.0 for stage in plan.stages)
    assert total < plan.predicted_s < 10 * total  # dispatches come on top


def test_a_stage_that_does_not_exist_is_no_stage_that_does_not_run():
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    assert not plan.runs("column fpn") and not sensor_runs(sensor())("column fpn")
    for ask in (plan.runs, sensor_runs(sensor()), lambda name: PlanStage(name, True, "")):
        with pytest.raises(ValueError, match="'colum fpn' is not a valid Stage"):
            ask("colum fpn")


def words_of(text: str) -> str:
    return " ".join(text.split())


def test_the_text_says_everything_within_100_columns():
    plan = plan_optics(HALO, sensor(), COLOURED, Accuracy(1e-2), method="fft", force=("tail",))
    text = plan.text()
    assert max(map(len, text.splitlines())) <= 100
    first_lines = [line for line in text.splitlines() if line[:4] in ("run ", "skip")]
    for line, stage in zip(first_lines, plan.stages, strict=True):
        assert line.startswith(f"{'run' if stage.runs else 'skip':5}{stage.name} ")
        assert line[NAME:].startswith(stage.reason[:40].rsplit(" ", 1)[0])
        if stage.predicted_cost_s is not None:
            assert line.endswith(f"{stage.predicted_cost_s:.3f} s")
    assert plan.name in words_of(text) and plan.rates in text and len(plan.runners_up) > 1
    for other in plan.runners_up:
        assert other.lost.split(":")[0] in words_of(text)


def test_a_chart_is_painted_and_a_photograph_warped():
    painted = stages(plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2)))
    assert painted["paint"] and not painted["warp"]
    warped = stages(plan_optics(LENS, sensor(), photograph(), Accuracy(1e-2)))
    assert warped["warp"] and not warped["paint"]


def test_a_photograph_on_the_grids_own_samples_is_not_warped():
    # The bank's image heights are ideal; the sensor has 96 x 128 pixels, two samples each.
    straight = bank(distortion=0.0)
    plan = plan_optics(straight, sensor(), photograph(size=(192, 256)), Accuracy(1e-2))
    assert plan.scales[0].grid.oversampling == 2
    assert not stages(plan)["warp"]
    assert "identity" in plan.text()
    warp = next(stage for stage in plan.stages if stage.name == "warp")
    assert warp.predicted_cost_s is None and warp.predicted_error is None
    for lens, size in ((LENS, (192, 256)), (straight, (48, 64))):
        other = plan_optics(lens, sensor(), photograph(size=size), Accuracy(1e-2))
        assert stages(other)["warp"]
        assert "identity" not in other.text()


def test_a_photograph_is_not_low_passed_again():
    sigmas = {
        what: {scale.sigma for scale in plan_optics(LENS, sensor(), what, Accuracy(1e-2)).scales}
        for what in (COLOURED, photograph())
    }
    assert sigmas == {COLOURED: {0.8}, list(sigmas)[1]: {0.0}}


def test_veiling_glare_is_there_where_the_sensor_has_it():
    assert not stages(plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2)))["flare"]
    glaring = plan_optics(LENS, sensor(veiling_glare=0.01), COLOURED, Accuracy(1e-2))
    assert stages(glaring)["flare"] and "1.00%" in glaring.text()


def test_one_spectrum_needs_one_plane():
    shades = np.outer([1, 0.1, 0.5, 0.02], FLAT)
    plan = plan_optics(LENS, sensor(), scene(shapes(), shades), Accuracy(1e-3))
    assert plan.basis.coefficients.shape == (4, 1)
    assert "1 of 4 spectra" in words_of(plan.text())
    coloured = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3))
    assert coloured.basis.coefficients.shape[1] == 3


def test_the_background_is_in_the_first_plane():
    """Where nothing else lies, one plane does."""
    plan = plan_optics(LENS, sensor(), scene(shapes(), background=3), Accuracy(1e-3))
    assert plan.basis.coefficients.shape[1] > 1
    assert not plan.basis.coefficients[3, 1:].any()


@pytest.mark.parametrize("lens", [LENS, HALO], ids=["compact", "halo"])
def test_a_tighter_tolerance_never_does_less(lens):
    nodes, planes, predicted = [], [], []
    tinges = np.stack([FLAT, 0.1 * FLAT, 0.9 * FLAT + 0.1 * RED, 0.97 * FLAT + 0.03 * BLUE])
    for tolerance in (0.1, 3e-2, 1e-2, 3e-3, 1e-3, 5e-4, 1e-4):
        plan = plan_optics(
            lens, sensor(), scene(shapes(), tinges), Accuracy(tolerance), method="fft"
        )
        nodes.append(np.prod(plan.scales[0].grid.nodes))
        planes.append(plan.basis.coefficients.shape[1])
        errors = {
            stage.name: stage.predicted_error
            for stage in plan.stages
            if stage.predicted_error is not None
        }
        # The planes may err five times as much: the worst spectrum in its weakest channel.
        assert errors.pop("paint") <= 5 * tolerance
        predicted.append(max(errors.values()))
        assert predicted[-1] <= 1.1 * tolerance
    assert nodes == sorted(nodes) and nodes[-1] > 10 * nodes[0]
    assert planes == sorted(planes) and planes[-1] > planes[0]
    assert predicted == sorted(predicted, reverse=True)


def test_the_tail_of_the_psf_goes_to_a_coarse_grid_where_that_suffices():
    plan = plan_optics(HALO, sensor(), COLOURED, Accuracy(1e-2), method="fft", force=("tail",))
    core, tail = plan.scales
    assert (core.name, tail.name) == ("core", "tail")
    assert core.grid.oversampling >= 2 and tail.pitch_um == pytest.approx(3.1)
    assert core.grid.half_size * core.pitch_um < tail.grid.half_size * tail.pitch_um
    whole = plan_optics(HALO, sensor(), COLOURED, Accuracy(5e-4)).scales
    assert [scale.name for scale in whole] in (["whole"], ["core", "tail"])
    # Together they hold the PSF: the splines of both, at the first field, are linear in it.
    images, _ = field_images(HALO.levels[0], plan.basis.rates, 1e9)
    for part, share in ((core, 0.7), (tail, 0.0)):
        total = part.kernels.splines[0].sum(axis=(2, 3), dtype=float)
        fraction = total / images[0].sum(axis=(2, 3))
        assert (fraction > share).all() and (fraction < 1).all()
    both = sum(s.kernels.splines[0].sum(axis=(2, 3), dtype=float) for s in (core, tail))
    # float32 splines of 128 x 128 samples, of rounding errors that are as often above as below.
    assert both == pytest.approx(images[0].sum(axis=(2, 3)), rel=1e-5)


def test_a_finer_grid_than_suffices_is_not_worked_out(monkeypatch: pytest.MonkeyPatch):
    """But where nothing that two samples a pixel allow stays within its limits."""
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    other = next(one for one in plan.runners_up if one.name == "4 samples a pixel")
    assert other.predicted_cost_s is None and other.predicted_error <= 1e-2
    assert other.lost == "too dear: 2 samples a pixel meet the tolerance"
    monkeypatch.setattr(Candidate, "excess", property(lambda one: 2.0))
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2, best_effort=True))
    assert any(one.name.startswith("fft, 4 samples") for one in plan.runners_up)


def test_a_psf_narrower_than_a_sample_is_oversampled_more():
    narrow = bank(sigma_um=(0.35, 0.35, 0.35), coma_um=0.0)
    assert plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3)).scales[0].grid.oversampling == 2
    fine = plan_optics(narrow, sensor(), COLOURED, Accuracy(1e-3)).scales[0].grid
    assert fine.oversampling == 4
    assert plan_optics(narrow, sensor(), COLOURED, Accuracy(0.1)).scales[0].grid.oversampling == 2
    # An even photograph has nothing to alias, one of noise as much as edges.
    even, noisy = photograph(), photograph(size=(96, 128))
    noisy.source.planes[:] = np.random.default_rng(3).uniform(0.1, 1.0, noisy.source.planes.shape)
    for scene_, samples in ((even, 2), (noisy, 4)):
        grid = plan_optics(narrow, sensor(), scene_, Accuracy(2.5e-4)).scales[0].grid
        assert grid.oversampling == samples


@pytest.mark.parametrize("pattern", [["W"], ["BG", "GR"], ["BBGG", "BBGG", "GGRR", "GGRR"]])
def test_filter_patterns_of_one_two_and_four(pattern: list[str]):
    if pattern == ["W"]:
        camera = monochrome()
    else:
        camera = sensor(cfa=ColourFilterArray(pattern=[list(row) for row in pattern]))
    plan = plan_optics(HALO, camera, COLOURED, Accuracy(1e-2), method="fft", force=("tail",))
    assert len(plan.scales) == 2
    for scale in plan.scales:
        grid = scale.grid
        assert grid.period == len(pattern) and grid.half_size % grid.stride == 0
        assert grid.length in (256, 512, 1024)
        # Sites a whole number of samples apart share kernels by channel; else each has its own, and
        # shaders/optics/fft_columns sums four at most.
        assert grid.stride % grid.period == 0 or grid.sites <= 4
        assert scale.pitch_um == pytest.approx(1.55 / grid.oversampling)


def test_planning_opens_no_device(monkeypatch):
    def refuse(*given: object, **more: object) -> None:
        raise AssertionError("a device was opened")

    monkeypatch.setattr(gpu.device, "_default", None)
    monkeypatch.setattr(Device, "open", refuse)
    monkeypatch.setattr(Device, "__init__", refuse)
    with pytest.raises(AssertionError, match="was opened"):  # a control
        gpu.default_device()
    plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    plan_optics(LENS, sensor(), photograph(), Accuracy(1e-2))


# What is refused


@pytest.mark.parametrize("tolerance", [0.0, 9e-6, 0.11, -1e-3, float("nan")])
def test_a_tolerance_out_of_range_is_refused(tolerance: float):
    with pytest.raises(UserError, match="tolerance") as caught:
        Accuracy(tolerance)
    assert caught.value.field == "tolerance" and "1e-5" in caught.value.allowed


def test_the_ends_of_the_range_are_in_it():
    assert Accuracy(1e-5, 0).probes == 0 and Accuracy(0.1).tolerance == 0.1
    assert Accuracy() == Accuracy(1e-3, None, "relative")


def test_fewer_probes_than_none_are_refused():
    with pytest.raises(UserError, match="probes") as caught:
        Accuracy(1e-3, -1)
    assert caught.value.field == "certify"


@pytest.mark.parametrize("pattern", [["RGB"], ["R", "G", "B"], ["RG", "GB", "RG"], ["RGB"] * 3])
def test_patterns_that_do_not_halve_have_a_plane_for_each_channel(pattern: list[str]):
    camera = sensor(cfa=ColourFilterArray(pattern=[list(row) for row in pattern]))
    plan = plan_optics(LENS, camera, COLOURED, Accuracy(1e-2))
    assert {(scale.grid.period, scale.grid.layers) for scale in plan.scales} == {(1, 3)}
    halved = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    assert {(scale.grid.period, scale.grid.layers) for scale in halved.scales} == {(2, 1)}
    assert plan.predicted_s > halved.predicted_s


def test_a_lens_that_changes_too_fast_is_refused():
    wild = bank(coma_um=8.0, fields=12)
    with pytest.raises(UserError, match="do not fit") as caught:
        plan_optics(wild, sensor(), COLOURED, Accuracy(2e-5), method="fft")
    assert caught.value.field == "tolerance" and f"{BLOCK_BYTES >> 20} MiB" in str(caught.value)


def test_the_nearest_tolerance_is_named_and_can_be_asked_for():
    """PSFs narrower than a sample: their alias does not follow the tolerance."""
    sharp = bank(sigma_um=(0.35, 0.35, 0.35), coma_um=0.0)
    coarse = sensor().model_copy(update={"pixel_pitch_um": 12.4, "rows": 24, "cols": 32})
    with pytest.raises(UserError, match=r"cannot be met: the alias of edges.*8 samples") as caught:
        plan_optics(sharp, coarse, COLOURED, Accuracy(1e-3))
    named = float(caught.value.allowed.split(" or more")[0])
    assert named > 2e-3 and "--best-effort" in caught.value.allowed
    met = plan_optics(sharp, coarse, COLOURED, Accuracy(named))
    assert met.shortfall == "" and met.tolerance == named
    # The named tolerance has two digits. One less in the last is refused: nothing nearer can be
    # met.
    step = 10.0 ** (np.floor(np.log10(named)) - 1)
    with pytest.raises(UserError, match="cannot be met"):
        plan_optics(sharp, coarse, COLOURED, Accuracy(named - step))
    effort = plan_optics(sharp, coarse, COLOURED, Accuracy(1e-3, best_effort=True))
    assert effort.name == met.name and effort.tolerance == named
    assert f"planned for {named:.2g} of the local signal in place of 0.001" in effort.shortfall
    assert effort.shortfall in words_of(effort.text().replace("best effort", ""))
    # And what can be met is planned as without best effort.
    again = plan_optics(sharp, coarse, COLOURED, Accuracy(named, best_effort=True))
    assert (again.name, again.shortfall) == (met.name, "")


def test_planes_that_the_shaders_do_not_carry_are_a_limit_too(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(spectral_basis, "MAX_PLANES", 1)
    with pytest.raises(UserError, match=r"cannot be met: the planes") as caught:
        plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3))
    assert "none that is in range" in caught.value.allowed  # red is not grey by far
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3, best_effort=True))
    assert "no tolerance can be met: the planes" in plan.shortfall


# Methods


@pytest.mark.parametrize("method", METHODS)
def test_a_method_that_is_asked_for_is_taken(method: str):
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), method=method)
    assert {scale.method for scale in plan.scales} == {method}
    assert plan.name.startswith(method)
    grids = tuple(f"{count} sample" for count in OVERSAMPLINGS)  # that were not worked out
    assert all(other.name.startswith((method, *grids)) for other in plan.runners_up)
    used = {"fft": {"fft rows", "fft columns", "inverse fft"}, "direct": {"direct"}}
    used["modes"] = {"modes", "fft columns", "inverse fft"}
    for stage in ("fft rows", "modes", "fft columns", "inverse fft", "direct"):
        assert plan.runs(stage) == (stage in used[method])


def test_without_a_method_the_cheapest_of_all_is_taken():
    """And it follows the rates: what is made dear is not taken."""
    chosen = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2))
    best = [
        plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), method=method).predicted_s
        for method in METHODS
    ]
    # The tail, if there is one, is by the cheapest method too, so that both are cheaper still.
    assert chosen.predicted_s <= min(best)
    tried = {other.name.split(",")[0] for other in chosen.runners_up} | {chosen.name.split(",")[0]}
    assert tried >= set(METHODS)
    dear = {"direct": "direct", "fft": "fft rows", "modes": "modes"}[chosen.scales[0].method]
    costs = replace(LAVAPIPE, ns=LAVAPIPE.ns | {dear: 1e6})
    other = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), costs)
    assert other.scales[0].method != chosen.scales[0].method


@pytest.mark.slow
def test_a_method_that_cannot_do_it_says_why():
    wide = bank(size=256, coma_um=0.5, halo=0.3)
    with pytest.raises(UserError, match="small supports") as caught:
        plan_optics(wide, sensor(), COLOURED, Accuracy(1e-5), method="direct")
    assert caught.value.field == "tolerance"
    # A looser one allows a cut, and a core that is small enough.
    named = float(caught.value.allowed.split(" or more")[0])
    plan = plan_optics(wide, sensor(), COLOURED, Accuracy(named), method="direct")
    assert plan.shortfall == "" and len(plan.scales) == 2
    wild = bank(coma_um=8.0, fields=12)
    with pytest.raises(UserError, match=r"sums of few modes .*16 modes") as caught:
        plan_optics(wild, sensor(), COLOURED, Accuracy(1e-5), method="modes")
    named = float(caught.value.allowed.split(" or more")[0])
    assert plan_optics(wild, sensor(), COLOURED, Accuracy(named), method="modes").shortfall == ""


def test_a_lens_alike_over_the_field_needs_one_mode():
    alike = bank(coma_um=0.0, falloff=0.3, lateral=(0.0, 0.0, 0.0))
    plan = plan_optics(alike, sensor(), COLOURED, Accuracy(1e-2), method="modes")
    assert "1 mode," in plan.name
