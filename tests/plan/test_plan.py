"""The planner: what runs and why, and that a tighter tolerance never does less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from optics.made import BLUE, FLAT, RED, at_lines, bank, monochrome, scene, sensor, shapes

from gpusim import gpu
from gpusim.errors import UserError
from gpusim.gpu import Device
from gpusim.optics import fold
from gpusim.optics.grid import SimGrid
from gpusim.optics.images import field_images
from gpusim.optics.kernels import core_window, distances_um, field_kernels
from gpusim.optics.methods import METHODS
from gpusim.plan import Accuracy, Plan, PlanStage, layout, plan_optics
from gpusim.plan.candidates import Candidate
from gpusim.plan.costs import LAVAPIPE, Costs
from gpusim.plan.layout import BLOCK_BYTES, Memory, cheapest_grid, planes_at_nodes
from gpusim.plan.predict import Edge, cells_within, cut_error, edge_integral, even_error, node_error
from gpusim.plan.problem import CUTS_UM
from gpusim.plan.stages import sensor_runs
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
        "rows",
        "modes",
        "columns",
        "lattice",
        "direct",
        "tail",
        "splat",
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
        "knee",
        "noise",
        "bloom",
        "parallel cti",
        "serial cti",
        "coupling",
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
        assert line[18:].startswith(stage.reason[:40].rsplit(" ", 1)[0])
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
        # shaders/optics/columns sums four at most.
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


# Predicted errors


def test_an_edge_sees_a_frequency_by_its_reciprocal():
    f = np.linspace(0.1, 0.7, 4001)
    assert edge_integral(f, 3.0 * f) == pytest.approx(2 * 3.0 * 0.6 / (2 * np.pi))
    assert edge_integral(f, np.ones(4001)) == pytest.approx(np.log(7) / np.pi, rel=1e-5)
    assert edge_integral(f, -f) > 0


def test_what_the_coarse_grid_loses_falls_with_the_cut():
    images, _ = field_images(HALO, at_lines(HALO, np.ones((1, 1, 3))), 1e9)
    lost = [cut_error(images, 0.5, 3.1, monochrome(), cut) for cut in CUTS_UM[:4]]
    assert lost == sorted(lost, reverse=True) and lost[0] > 1e-6
    finer = cut_error(images, 0.5, 1.55, monochrome(), CUTS_UM[0])
    assert finer < lost[0]
    assert cut_error(3 * images, 0.5, 3.1, monochrome(), 6.0) == pytest.approx(lost[0])
    small = np.zeros((1, 1, 1, 128, 128))
    small[..., 64, 64] = 1.0
    assert cut_error(small, 0.5, 3.1, monochrome(), 6.0) == 0


def first_kernels(lens):
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    return field_kernels(images, places, 0.5, 0.775, np.ones(images.shape[-2:]))


def test_nodes_err_by_the_square_of_their_spacing():
    half_um = (99.2, 74.4)
    # The kernels of a field that never changes are alike at all nodes, but for splines in f32.
    still = bank(coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0))
    assert node_error(first_kernels(still), 0.775, 20.0, half_um, 20.0) < 1e-4
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    wide, close = (node_error(kernels, 0.775, 20.0, half_um, spacing) for spacing in (24.0, 12.0))
    assert wide > 5 * 1e-4
    assert wide / close == pytest.approx(4, rel=0.3)  # kinks at the fields, 7 um apart, disturb it


def test_beside_a_harder_edge_nodes_err_more():
    """By the light of the dark side, which blur fills: less than the contrasts themselves."""
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    errors = [
        node_error(kernels, 0.775, 20.0, half_um, 24.0, Edge(contrast, 2))
        for contrast in (1.0, 2.0, 4.0, 16.0)
    ]
    assert errors[0] == 0.0
    assert errors == sorted(errors)
    assert errors[2] < errors[3] < 4 * errors[2]
    few, many = (
        cells_within(kernels, 0.775, 20.0, half_um, 1e-3, 20.0, Edge(contrast, 2))[0]
        for contrast in (2.0, 16.0)
    )
    assert np.prod(few) < np.prod(many)


def test_an_edges_error_is_that_of_pixels_over_their_light():
    """A response that errs by a hundredth everywhere, and a step: the dark side is 1/8 of white."""
    off, whole = np.full(65, 0.01), np.concatenate([np.zeros(32), [0.5], np.ones(32)])
    found = Edge(8.0, 1).square(off, whole)
    seen = 1 / 8 + 7 / 8 * np.array([0.0, 0.5, 1.0])  # within a pixel of the middle
    assert found == pytest.approx(np.mean((7 / 8 * 0.01 / seen) ** 2))


def test_a_scene_of_one_tone_needs_nodes_for_the_kernels_sums_alone():
    """Coma moves light within a kernel: edges see it, one tone does not; it sees what falls off."""

    def errors_of(kernels) -> tuple[float, float]:
        half_um, cells = (99.2, 74.4), (8, 6)
        edge = node_error(kernels, 0.775, 20.0, half_um, 2 * 99.2 / 8)
        return edge, even_error(kernels, half_um, (2 * 99.2, 2 * 74.4), cells)

    even = first_kernels(bank(coma_um=3.0, falloff=0.0, fields=24))
    edge, tone = errors_of(even)
    assert edge > 3e-4 and tone < 0.1 * edge
    dim = first_kernels(bank(coma_um=0.0, falloff=0.3, fields=24))
    edge, tone = errors_of(dim)
    assert tone > 0.5 * edge > 1e-5
    # In the plan: fewer nodes, and no alias that asks for a finer grid.
    lens = bank(sigma_um=(0.35,) * 3, coma_um=3.0, falloff=0.0, fields=24)
    one, many = scene((), np.stack([FLAT])), scene(shapes()[:1], np.stack([FLAT, 0.5 * FLAT]))
    grids = [
        plan_optics(lens, sensor(), what, Accuracy(1e-3), method="fft").scales[0].grid
        for what in (one, many)
    ]
    assert np.prod(grids[0].cells) < 0.5 * np.prod(grids[1].cells)
    assert (grids[0].oversampling, grids[1].oversampling) == (2, 4)


def test_the_error_of_an_even_scene_is_that_of_a_parabola_between_nodes():
    """Light falls as 1 - 0.3 (r / 165)^2: straight lines err by f'' h^2 / sqrt(720) each way."""
    kernels = first_kernels(bank(coma_um=0.0, falloff=0.3, lateral=(0.0,) * 3, fields=24))
    half_um, sides = (82.5, 62.0), (2 * 82.5, 2 * 62.0)
    found = even_error(kernels, half_um, sides, (5, 4))
    curved = 2 * 0.3 / kernels.places.radius_um[-1] ** 2
    expected = curved * np.hypot(33.0**2, 31.0**2) / np.sqrt(720)
    # Over what is left of the light, 0.7 to 1.
    assert expected < found < expected / 0.7
    # What changes at one height alone is seen where it does: a ring at 0.6 of the field.
    sums = np.ones(len(kernels.splines))
    sums[13:16] += 0.03
    ringed = replace(kernels, splines=kernels.splines * sums[:, None, None, None, None])
    assert even_error(ringed, half_um, sides, (5, 4)) > 1.5 * found


def test_cells_keep_the_error_that_they_are_allowed():
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    found = {}
    for allowed in (4e-3, 1e-3, 2.5e-4):
        cells, error = cells_within(kernels, 0.775, 20.0, half_um, allowed, 20.0)
        assert error <= allowed
        # One cell fewer each way would not do: the error goes with the square.
        assert error * (max(cells) / (max(cells) - 1)) ** 2 > allowed * 0.9
        found[allowed] = cells
    assert found[4e-3] < found[1e-3] < found[2.5e-4]
    # Where nothing changes one cell does; where pixels see more than the sensor around it, cells of
    # half its narrower side, 74.4 um, over 2 x 199.2 and 2 x 174.4 um.
    still = first_kernels(bank(coma_um=0.0, falloff=0.0, lateral=(0.0, 0.0, 0.0)))
    assert cells_within(still, 0.775, 20.0, half_um, 1e-3, 20.0)[0] == (1, 1) < found[4e-3]
    assert cells_within(still, 0.775, 20.0, half_um, 1e-3, 100.0)[0] == (6, 6)


def test_cells_cover_what_pixels_see_around_the_sensor():
    """As many more as the sensor is wider with it, for the same error."""
    half_um = (99.2, 74.4)
    kernels = first_kernels(bank(coma_um=3.0, fields=24))
    narrow, wide = (
        cells_within(kernels, 0.775, 20.0, half_um, 2.5e-4, beyond_um) for beyond_um in (0.0, 99.2)
    )
    assert wide[1] <= 2.5e-4 and narrow[1] <= 2.5e-4
    for few, many, half in zip(narrow[0], wide[0], half_um, strict=True):
        # Each is rounded up to whole cells.
        assert abs(many - few * (half + 99.2) / half) <= (half + 99.2) / half


def test_before_a_sensor_of_one_pixel_cells_are_no_smaller_than_they_must_be():
    """16 samples of 0.775 um, over 2 x (0.775 + 20) um: not half a pixel, which no grid allows."""
    kernels = first_kernels(bank(coma_um=0.5))
    assert cells_within(kernels, 0.775, 20.0, (0.775, 0.775), 1e-2, 20.0)[0] == (4, 4)
    # A row of pixels as well; half its length is no cell either.
    assert cells_within(kernels, 0.775, 20.0, (31.0, 0.775), 1e-2, 20.0)[0] == (10, 4)


def test_a_tail_that_changes_over_the_field_needs_nodes_of_its_own():
    lens = bank(fields=24)
    images, places = field_images(lens, at_lines(lens, np.ones((1, 1, 3))), 1e9)
    n = images.shape[-1]
    tail = 1 - core_window(distances_um(n, 0.5), 8.0)
    # A ring 15 um off, as bright everywhere or growing with the field.
    halo = np.abs(distances_um(n, 0.5) - 15.0) < 1.0
    halo = halo / halo.sum()
    heights = np.append(places.radius_um, places.radius_um[1])  # the last beyond the axis
    grows = (heights / places.radius_um[-1])[:, None, None, None, None] ** 2
    energy = images.sum(axis=(3, 4), keepdims=True)
    found = [
        cells_within(
            field_kernels(images + part * energy * halo, places, 0.5, 3.1, tail),
            3.1,
            40.0,
            (99.2, 74.4),
            5e-2,
            40.0,
        )[0]
        for part in (0.2, 0.2 * grows)
    ]
    assert max(found[0]) < min(found[1])


# What is refused


@pytest.mark.parametrize("tolerance", [0.0, 9e-6, 0.11, -1e-3, float("nan")])
def test_a_tolerance_out_of_range_is_refused(tolerance: float):
    with pytest.raises(UserError, match="tolerance") as caught:
        Accuracy(tolerance)
    assert caught.value.field == "tolerance" and "1e-5" in caught.value.allowed


def test_the_ends_of_the_range_are_in_it():
    assert Accuracy(1e-5, 0).probes == 0 and Accuracy(0.1).tolerance == 0.1
    assert Accuracy() == Accuracy(1e-3, 256, "relative")


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
    monkeypatch.setattr(fold, "MAX_PLANES", 1)
    with pytest.raises(UserError, match=r"cannot be met: the planes") as caught:
        plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3))
    assert "none that is in range" in caught.value.allowed  # red is not grey by far
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-3, best_effort=True))
    assert "no tolerance can be met: the planes" in plan.shortfall


# Layout of blocks


def layouts(
    planes: int,
    cells: tuple[int, int],
    rows: int = 1520,
    cols: int = 2028,
    costs: Costs = LAVAPIPE,
) -> SimGrid:
    def needed(grid: SimGrid) -> dict[tuple[int, int], int]:
        return dict.fromkeys(np.ndindex(grid.blocks), planes)

    def work(grid: SimGrid, needed: dict[tuple[int, int], int]) -> dict[str, float]:
        return costs.transforms(grid, 3, np.array(list(needed.values())))

    def preparation(grid: SimGrid, needed: dict[tuple[int, int], int]) -> float:
        nodes = 3 * planes_at_nodes(grid, needed).sum()
        sampled = costs.seconds("kernels", nodes * (2 * grid.half_size) ** 2)
        return sampled + costs.seconds("spectra", nodes * grid.length**2)

    def memory(grid: SimGrid, needed: dict[tuple[int, int], int]) -> Memory:
        node = 3 * max(needed.values()) * grid.length**2 * 4
        return Memory(4 * node, node)

    camera = sensor().model_copy(update={"rows": rows, "cols": cols})
    return cheapest_grid(camera, 4, 2, 31.0, cells, needed, work, memory, preparation).grid


# By the table two ways to cut are nearly a tie, and the one node more than cells decides.
CHEAP_KERNELS = replace(LAVAPIPE, ns=LAVAPIPE.ns | {"kernels": 3.0, "spectra": 0.75})


def test_blocks_are_full_where_more_nodes_cost_less_than_more_transforms():
    """A photograph in three planes, of which all blocks need all: 176 samples of 256 - 2 x 40."""
    grid = layouts(3, (16, 12), costs=CHEAP_KERNELS)
    # Two blocks of 132 samples for each cell took 1.8 times as many transforms.
    assert (grid.block, grid.cells, grid.blocks) == ((176, 176), (24, 18), (24, 18))
    # Where cells of the tolerance hold whole blocks, no node is added; nor where nodes are dear.
    assert layouts(3, (12, 9), costs=CHEAP_KERNELS).cells == (12, 9)
    dear = replace(LAVAPIPE, ns=LAVAPIPE.ns | {"kernels": 3e3, "spectra": 750.0})
    assert layouts(3, (16, 12), costs=dear).cells == (16, 12)


def test_what_memory_holds_all_kernels_does_not_bound_the_frame():
    """12 and 48 megapixels are cut as 3 are: the kernels of all their nodes take gigabytes."""
    small = layouts(3, (16, 12), costs=CHEAP_KERNELS)
    for factor in (2, 4):
        cells, size = (16 * factor, 12 * factor), (1520 * factor, 2028 * factor)
        grid = layouts(3, cells, *size, costs=CHEAP_KERNELS)
        assert grid.length == small.length
        assert grid.block[0] == pytest.approx(small.block[0], rel=0.05)
        assert grid.blocks[0] == pytest.approx(factor * small.blocks[0], rel=0.05)


def test_nodes_closer_than_a_few_samples_are_refused():
    assert layouts(1, (42, 34), 96, 128).block == (8, 8)
    with pytest.raises(UserError, match="changes too fast") as caught:
        layouts(1, (43, 34), 96, 128)
    assert "44 x 35 PSF nodes" in caught.value.value
    assert "at least 8 samples apart" in caught.value.allowed


def test_a_psf_wider_than_the_longest_transform_is_refused(monkeypatch):
    monkeypatch.setattr(layout, "TRANSFORMS", (36,))
    with pytest.raises(UserError, match="too wide") as caught:
        plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), method="fft")
    assert "sim samples wide" in caught.value.value and "4 samples" in caught.value.allowed


# Methods


@pytest.mark.parametrize("method", METHODS)
def test_a_method_that_is_asked_for_is_taken(method: str):
    plan = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), method=method)
    assert {scale.method for scale in plan.scales} == {method}
    assert plan.name.startswith(method)
    grids = tuple(f"{count} sample" for count in OVERSAMPLINGS)  # that were not worked out
    assert all(other.name.startswith((method, *grids)) for other in plan.runners_up)
    used = {"fft": {"rows", "columns", "lattice"}, "direct": {"direct"}}
    used["modes"] = {"modes", "columns", "lattice"}
    for stage in ("rows", "modes", "columns", "lattice", "direct"):
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
    dear = {"direct": "direct", "fft": "rows", "modes": "modes"}[chosen.scales[0].method]
    costs = replace(LAVAPIPE, ns=LAVAPIPE.ns | {dear: 1e6})
    other = plan_optics(LENS, sensor(), COLOURED, Accuracy(1e-2), costs)
    assert other.scales[0].method != chosen.scales[0].method


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
