"""The sweep: every plan certified at the same pixels and timed in turns; regret, files, figure."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Ran, assert_refused, gpusim
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from optics.made import FLAT, StubCamera, bank, monochrome, scene
from rich.console import Console

from gpusim.cli import pareto as command
from gpusim.cli.pareto import region, regret_in_words, table, write
from gpusim.errors import UserError
from gpusim.gpu import default_device
from gpusim.pareto import CHOSEN, Point, Sweep, Variant, knobs, sweep, turns, variants
from gpusim.pareto.turns import KINDS, ROUNDS, _Run
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.render import Renderer
from gpusim.report.pareto_figure import draw, placed, png
from gpusim.scene.chart import Rect

CAMERA = StubCamera(bank(coma_um=3.0, falloff=0.1, halo=0.02), monochrome(48, 64))
EDGE = scene((Rect(0.1, 0.05, 0.4, 0.35, 0.1, 1),), np.stack([FLAT, 0.2 * FLAT]))
ASKED = Accuracy(1e-2, 8)
KEPT = ("tolerance 0.01", "tolerance 0.03", "0.25 x the nodes", "4 samples a pixel")
KEPT += ("core of 6 um", "not cut")


@pytest.fixture(scope="module")
def found() -> Sweep:
    """Return a sweep of some variants, of one that cannot be made, and of the chosen plan again."""

    def refused(renderer: object) -> None:
        raise UserError("it cannot be", value="so wide", allowed="less")

    some = [variant for variant in variants(ASKED, 1) if variant.name in KEPT]
    impossible = Variant("knob", "impossible", ASKED, refused)
    again = Variant("knob", "again", ASKED, lambda renderer: (renderer.planning.plan(), {}))
    patch = pytest.MonkeyPatch()
    # Rates that are measured in two processes at once may choose another plan the next time.
    patch.setattr(turns, "adapter_costs", lambda device: LAVAPIPE)
    patch.setattr(knobs, "variants", lambda *given: iter([*some, impossible, again]))
    seen = []
    try:
        result = sweep(
            CAMERA, EDGE, ASKED, 0.01, progress=lambda *step: seen.append(step), budget_s=0.0
        )
    finally:
        patch.undo()
    assert ("truth", 8, 8) in seen and ("certificates", 8, 8) in seen
    return result


def by_name(swept: Sweep) -> dict[str, Point]:
    return {point.name: point for point in swept.points}


# Variants


def test_the_chosen_plan_comes_first_and_every_kind_is_there():
    everything = list(variants(ASKED, 2))
    assert everything[0] == Variant(CHOSEN, "tolerance 0.01", ASKED)
    names = [variant.name for variant in everything]
    assert len(set(names)) == len(names)
    families = {variant.family for variant in everything}
    assert families == {
        CHOSEN, "runner-up", "method", "PSF nodes", "oversampling", "cut of the PSF"
    }  # fmt: skip
    assert "4 samples a pixel" not in [variant.name for variant in variants(ASKED, 8)]
    sigmas = [v.accuracy for v in variants(Accuracy(0.1, 8, "sigma"), 2) if v.family == CHOSEN]
    assert {one.unit for one in sigmas} == {"sigma"} and len(sigmas) == 6
    assert max(one.tolerance for one in sigmas) == pytest.approx(3.0)
    # Best effort is for the tolerance that was asked for, not for those beside it.
    effort = list(variants(replace(ASKED, best_effort=True), 2))
    assert {v.accuracy.best_effort for v in effort if v.family == CHOSEN} == {True, False}
    assert effort[0].accuracy.best_effort


def test_a_knob_changes_what_it_names(found: Sweep):
    points = by_name(found)
    fewer, finer = points["0.25 x the nodes"], points["4 samples a pixel"]
    assert finer.samples_per_pixel.startswith("4")
    assert "+" not in points["not cut"].samples_per_pixel
    assert points["core of 6 um"].samples_per_pixel.count("+") == 1
    # Coma: the nodes matter. The finer grid and the whole PSF have those of the plan by transforms.
    assert fewer.nodes != finer.nodes and fewer.predicted > 2 * finer.predicted
    assert fewer.engine_rms > 2 * finer.engine_rms
    assert points["tolerance 0.03"].total_rms > finer.engine_rms


def test_the_runners_up_are_the_planners_next(found: Sweep):
    """In the order of the predicted time, the chosen first, and each within the tolerance."""
    accuracy, given = replace(ASKED, probes=0), {"exposure_s": 0.01, "costs": LAVAPIPE}
    chosen = Renderer(CAMERA, EDGE, accuracy, default_device(), **given)
    try:
        plans = chosen.planning.plans(4)
        names = [chosen.plan.name, *(other.name for other in chosen.plan.runners_up)]
    finally:
        chosen.release()
    assert plans[0].name == names[0] == by_name(found)["tolerance 0.01"].plan
    assert [plan.name for plan in plans] == names[: len(plans)] and len(plans) > 1
    costs = [plan.predicted_s + plan.kernels_s for plan in plans]
    assert costs == sorted(costs)


def test_a_runner_up_that_is_not_there_is_an_obstacle():
    planning = SimpleNamespace(plans=lambda count: ["the chosen", "another"])
    renderer = SimpleNamespace(planning=planning)
    with pytest.raises(UserError, match="no such plan") as caught:
        knobs._runner_up(3)(renderer)
    assert caught.value.allowed == "1 at most"


# Certificates


def test_all_are_certified_at_the_same_pixels(found: Sweep):
    made = [point for point in found.points if not point.obstacle]
    assert [point.name for point in found.points] == [*KEPT, "impossible"]  # the same is not shown
    assert [point.chosen for point in made] == [True] + [False] * (len(made) - 1)
    assert all(0 < point.engine_rms <= point.total_rms <= point.total_worst for point in made)
    chosen, certificate = found.points[0], found.certificate
    assert (chosen.total_rms, chosen.total_worst) == (
        certificate.total_rms,
        certificate.total_worst,
    )
    assert chosen.met == certificate.met and chosen.total_rms < 1e-2
    impossible = by_name(found)["impossible"]
    assert impossible.frame_s is None and "so wide; allowed: less" in impossible.obstacle


def test_the_lenss_and_the_sensors_errors_are_in_every_total():
    """3-4-12 triangle with an engine of none, and a window that is added whole."""
    renderer = Renderer(CAMERA, EDGE, Accuracy(1e-2, 8), default_device(), exposure_s=0.01)
    try:
        capture = renderer.capture(0.01, keep=("rate",))
    finally:
        renderer.release()
    real = capture.certificate
    parts = {"bank_rms": 4e-3, "sensor_rms": 3e-3, "window": 2e-3}
    parts |= {"bank_worst": 4e-2, "sensor_worst": 3e-2}
    judge = turns._judge(CAMERA, renderer, replace(real, **parts), 0.01)
    again = judge(capture.rate, renderer.glare, ASKED)
    assert again.engine_rms == pytest.approx(real.engine_rms, rel=1e-9)
    assert again.engine_worst == pytest.approx(real.engine_worst, rel=1e-9)
    expected = np.hypot(real.engine_rms, 5e-3) + 2e-3
    assert again.total_rms == pytest.approx(expected, rel=1e-9)
    assert again.total_worst == pytest.approx(np.hypot(real.engine_worst, 5e-2) + 2e-3, rel=1e-9)
    # One more electron in a hundred everywhere is an engine's error of a hundredth.
    more = judge(1.01 * capture.rate, renderer.glare, ASKED)
    assert more.engine_rms == pytest.approx(1e-2, abs=2 * real.engine_rms)


# Times and regret


def test_times_are_medians_with_quartiles(found: Sweep):
    assert found.rounds == ROUNDS  # no budget: the fewest
    for point in found.points:
        if not point.obstacle:
            assert 0 < point.frame_low_s <= point.frame_s <= point.frame_high_s
            assert 0 < point.first_low_s <= point.first_s <= point.first_high_s
            assert point.first_s > point.frame_s  # it plans, too


class Clock:
    """Renderers whose times are given: each frame costs what its plan says, times the hour's."""

    def __init__(self, hours: list[float]) -> None:
        self.hours, self.seen, self.now = iter(hours), [], 0.0

    def __call__(self, asked: Accuracy, plan: SimpleNamespace | None) -> SimpleNamespace:
        """Return a renderer of one plan at the next hour."""
        self.seen.append(plan.name)
        hour = next(self.hours)

        def spend(seconds: float) -> None:
            self.now += hour * seconds

        spend(1.0)  # the scene
        return SimpleNamespace(
            capture=lambda exposure_s: spend(plan.frame_s),
            planning=SimpleNamespace(plan=lambda: spend(10.0)),
            drop_light=lambda: None,
            release=lambda: None,
        )

    def time(self, runs: list[_Run], budget_s: float = 0.0) -> int:
        """Time some runs by this clock."""
        return turns._time(
            runs, self, 0.01, budget_s=budget_s, report=lambda *step: None, clock=lambda: self.now
        )


def run_of(name: str, frame_s: float, rms: float = 0.0, family: str = "knob") -> _Run:
    """Return a run of a plan that takes so long, with a certified error."""
    change = None if family == CHOSEN else (lambda renderer: None)
    variant = Variant(family, name, ASKED, change)
    plan = SimpleNamespace(name=name, frame_s=frame_s)
    return _Run(variant, plan, {}, SimpleNamespace(total_rms=rms, total_worst=5 * rms))


def test_a_drift_of_the_machine_hits_all_alike():
    """The machine slows down by a twentieth with each plan: ratios within a round are kept.

    There and back: in each round a plan and its neighbour are one step of the drift apart, so each
    ratio errs by 5 % in one round and by as much the other way in the next.
    """
    hours = [1.05**step for step in range(8)]
    clock = Clock(hours)
    runs = [run_of("chosen", 2.0, family=CHOSEN), run_of("other", 1.0)]
    assert clock.time(runs) == ROUNDS
    assert clock.seen == ["chosen", "other", "other", "chosen", "chosen", "other"]
    ratios = np.divide(*(run.times["frame"] for run in runs))
    np.testing.assert_allclose(ratios, [2 / 1.05, 2 * 1.05, 2 / 1.05], rtol=1e-12)
    # First frames: 10 s of the chosen's planning, 1 of the scene.
    chosen, other = (run.times["first"][0] for run in runs)
    assert chosen == pytest.approx(10 + 1 + 2)
    assert other == pytest.approx(10 + 1.05 * (1 + 1))


def test_rounds_end_with_the_budget(monkeypatch: pytest.MonkeyPatch):
    seconds = iter(range(1000))
    monkeypatch.setattr(turns.time, "perf_counter", lambda: float(next(seconds)))
    runs = [run_of("chosen", 2.0, family=CHOSEN)]
    # The clock is read at the begin and after each round: a second each.
    assert Clock([1.0] * 99).time(runs, 7.0) == 7


def test_regret_is_over_the_fastest_that_meets_the_same_tolerance():
    chosen = run_of("chosen", 0, 5e-3, CHOSEN)
    slow, fast, wrong, spiky = (
        run_of("slow", 0, 1e-3),
        run_of("fast", 0, 9e-3),
        run_of("wrong", 0, 2e-2),
        run_of("spiky", 0, 9e-3),
    )
    spiky.certificate.total_worst = 0.11  # beyond ten times 1e-2
    runs = [chosen, slow, fast, wrong, spiky]
    times = ([3.0, 6.0, 3.3], [4.0, 8.0, 4.0], [2.0, 4.0, 2.0], [0.1] * 3, [0.1] * 3)
    for run, own in zip(runs, times, strict=True):
        for kind in KINDS:
            run.times[kind] = own
    assert turns._regret(chosen, runs, "frame") == (1.5, "fast")
    # The fastest regrets nothing; who misses the tolerance, and who is no planner, has none.
    assert turns._regret(chosen, [chosen, slow, wrong], "frame") == (1.0, "chosen")
    assert turns._regret(fast, runs, "frame") == (None, "")
    chosen.certificate.total_rms = 1.1e-2
    assert turns._regret(chosen, runs, "frame") == (None, "")


def test_the_sweep_has_the_regret_of_the_planners_plans(found: Sweep):
    points = by_name(found)
    for name in ("tolerance 0.01", "tolerance 0.03"):
        point = points[name]
        assert point.regret >= 1 and point.first_regret >= 1
        assert points[point.fastest].total_rms <= point.tolerance
        assert points[point.fastest].frame_s <= point.frame_s
    assert points["not cut"].regret is None


# Files, table and figure


def test_files_and_table_hold_the_points(found: Sweep, tmp_path):
    write(found, tmp_path, {"camera": "one"})
    with (tmp_path / "pareto.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [point.name for point in found.points]
    assert float(rows[0]["total_rms"]) == found.points[0].total_rms
    assert float(rows[0]["regret"]) == found.points[0].regret
    facts = json.loads((tmp_path / "pareto.json").read_text())
    assert facts["camera"] == "one" and len(facts["points"]) == len(rows)
    shown = table(found.points, "relative")
    assert shown.row_count == len(found.points) + len({p.family for p in found.points})


@pytest.mark.parametrize("width", [100, 80, 70])
def test_the_table_cuts_nothing_on_narrow_terminals(width: int):
    # The longest that there are: names of the planner's plans, times in ms, errors that are marked.
    times = {name: 0.1234 for name in ("frame_s", "frame_low_s", "frame_high_s", "first_s")}
    point = Point(
        CHOSEN, "tolerance 0.0003", True, 3e-4, "", 2.3e-4, 1.2e-3, 1.2e-2, regret=1.23, **times
    )
    console = Console(width=width, file=io.StringIO())
    console.print(table((point,), "relative"))
    shown = console.file.getvalue()
    assert "…" not in shown
    for figure in ("123 ms", "1.2e-03 !", "1.2e-02", "2.3e-04", "1.23", "0.0003", "predicted"):
        assert figure in shown


def test_the_regret_in_words():
    point = Point(CHOSEN, "a", True, 1e-2, regret=1.234, fastest="b", first_regret=1.0)
    point = replace(point, first_fastest="a")
    words = regret_in_words(point, "frame")
    assert words.endswith('prepared frame: 1.23, the time over that of "b"')
    assert "first frame: 1, no plan" in regret_in_words(point, "first")
    assert "does not meet" in regret_in_words(replace(point, regret=None), "frame")


def marks_of(figure: Figure, size: float) -> list[set[tuple[float, float]]]:
    """Return where marks of a size lie, in each panel."""
    return [
        {tuple(line.get_xydata()[0]) for line in axes.lines if line.get_markersize() == size}
        for axes in figure.axes[:2]
    ]


@pytest.mark.parametrize("unit", ["relative", "sigma"])
def test_the_figure_marks_the_chosen_plan_and_lists_the_others(found: Sweep, unit: str):
    figure = draw(found.points, "title", "facts", unit)
    chosen, points = found.points[0], by_name(found)
    rings = marks_of(figure, 14.0)
    assert rings[0] == {(p.frame_s, p.total_rms) for p in (chosen, points[chosen.fastest])}
    assert rings[1] == {(p.first_s, p.total_rms) for p in (chosen, points[chosen.first_fastest])}
    listed = [text.get_text() for text in figure.texts]
    shown = [point for point in found.points if not point.obstacle]
    assert {f"{chosen.name}, chosen", *(point.name for point in shown[1:])} <= set(listed)
    assert "impossible" not in listed
    assert f"{chosen.regret:.2f} prepared, {chosen.first_regret:.2f} first" in " ".join(listed)
    for axes in figure.axes[:2]:
        numbers = [text.get_text() for text in axes.texts]
        assert numbers == [str(number) for number in range(1, len(shown) + 1)]
    file = png(figure)
    assert file.startswith(b"\x89PNG") and len(file) < 200_000


def crowd() -> tuple[Point, ...]:
    """Return 25 points, 20 of which lie within a few per cent of one another."""
    rng = np.random.default_rng(5)
    near = np.exp(rng.normal(0, 0.03, (20, 3)))
    far = np.exp(rng.normal(0, 1.0, (5, 3)))
    return tuple(
        Point(
            CHOSEN if number < 6 else "knob", f"plan {number}", number == 0, 1e-3,
            total_rms=3e-4 * rms, total_worst=2e-3 * rms, met=True,
            frame_s=0.2 * frame, frame_low_s=0.19 * frame, frame_high_s=0.21 * frame,
            first_s=0.9 * first, first_low_s=0.8 * first, first_high_s=frame + first,
            regret=1.0, fastest="plan 0", first_regret=1.0, first_fastest="plan 0",
        )
        for number, (rms, frame, first) in enumerate(np.concatenate([near, far]))
    )  # fmt: skip


def test_no_label_of_the_figure_overlaps_another_or_a_mark():
    """By the extents that the renderer draws, not by those that were planned."""
    figure = draw(crowd(), "title", "facts", "relative")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    scale = figure.dpi / 72
    for axes in figure.axes[:2]:
        boxes = [Text.get_window_extent(text, canvas.get_renderer()) for text in axes.texts]
        assert len(boxes) == 25
        for one, other in combinations(boxes, 2):
            wide = min(one.x1, other.x1) - max(one.x0, other.x0)
            high = min(one.y1, other.y1) - max(one.y0, other.y0)
            assert min(wide, high) <= 0.5  # pixels
        for line in axes.lines:
            if line.get_linestyle() != "None" and len(line.get_xdata()) > 1:
                continue
            ((x, y),) = axes.transData.transform(line.get_xydata())
            half = 0.7 * line.get_markersize() * scale / 2  # a round mark's, to its corners
            for box in boxes:
                assert not (box.x0 < x + half and box.x1 > x - half
                            and box.y0 < y + half and box.y1 > y - half)  # fmt: skip
    rows = [text for text in figure.texts if text.get_fontsize() == 7.4]
    extents = [text.get_window_extent(canvas.get_renderer()) for text in rows if text.get_text()]
    for one, other in combinations(extents, 2):
        assert not one.padded(-1).overlaps(other.padded(-1))
    assert min(box.y0 for box in extents) > 0 and max(box.x1 for box in extents) < 13 * 120


def test_texts_are_placed_next_to_their_marks_where_there_is_room():
    (alone,) = placed([(50.0, 50.0)], [6.0], [(8.0, 6.0)], (0, 0, 100, 100))
    assert np.hypot(*np.subtract(alone, 50)) < 12
    # In the corner there is room on one side only.
    ((x, y),) = placed([(2.0, 2.0)], [6.0], [(8.0, 6.0)], (0, 0, 100, 100))
    assert x >= 4 and y >= 3


# The command


@pytest.fixture
def swept(monkeypatch: pytest.MonkeyPatch, found: Sweep) -> dict[str, object]:
    """Put the sweep from above in place of the work; return what it was asked for."""
    given: dict[str, object] = {"met": True}

    def instead(camera: object, scene: object, accuracy: Accuracy, *_: object, **__) -> Sweep:
        given["accuracy"] = accuracy
        certificate = replace(found.certificate, met=given["met"])
        return replace(found, certificate=certificate, shortfall=given.get("shortfall", ""))

    monkeypatch.setattr(command, "sweep", instead)
    return given


def swept_to(out: object, *options: object) -> Ran:
    return gpusim("pareto", "demo", "slanted-edge", "--out", out, *options)


def test_the_exit_code_is_that_of_the_chosen_plans_certificate(swept: dict, tmp_path, found: Sweep):
    ran = swept_to(tmp_path, "--tolerance", 1e-2)
    assert (ran.code, ran.err) == (0, "")
    assert {file.name for file in tmp_path.iterdir()} == {"pareto.csv", "pareto.json", "pareto.png"}
    facts = json.loads((tmp_path / "pareto.json").read_text())
    chosen = found.points[0]
    assert (facts["regret"], facts["fastest"]) == (chosen.regret, chosen.fastest)
    assert facts["first_regret"] == chosen.first_regret and facts["rounds"] == ROUNDS
    assert all(regret_in_words(chosen, kind) in ran.out for kind in KINDS)
    assert max(map(len, ran.out.splitlines()[:12])) <= 100
    swept["met"] = False
    ran = swept_to(tmp_path, "--tolerance", 1e-2)
    assert ran.code == 1 and "BEYOND the tolerance of 0.01" in ran.out
    assert json.loads((tmp_path / "pareto.json").read_text())["met"] is False


def test_a_best_effort_is_passed_on_and_shown(swept: dict, tmp_path):
    assert swept_to(tmp_path).code == 0 and swept["accuracy"].best_effort is False
    swept |= {"met": False, "shortfall": "planned for 0.02: the alias"}
    ran = swept_to(tmp_path, "--best-effort")
    assert ran.code == 1 and swept["accuracy"].best_effort is True
    assert "best effort: planned for 0.02: the alias" in ran.out
    facts = json.loads((tmp_path / "pareto.json").read_text())
    assert facts["shortfall"] == "planned for 0.02: the alias"


def test_a_sweep_without_probes_is_refused(tmp_path):
    assert_refused(swept_to(tmp_path, "--certify", 0), "--certify", "1 or more")


def test_a_region_keeps_the_sensors_shape():
    camera = SimpleNamespace(sensor=monochrome(1520, 2028))
    small = region(replace_like(camera))
    assert (small.sensor.rows, small.sensor.cols) == (384, 512)
    tiny = region(replace_like(SimpleNamespace(sensor=monochrome(48, 64))))
    assert (tiny.sensor.rows, tiny.sensor.cols) == (48, 64)


def replace_like(camera: SimpleNamespace) -> StubCamera:
    return replace(CAMERA, sensor=camera.sensor)
