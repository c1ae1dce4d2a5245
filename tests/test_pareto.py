"""The sweep: every plan certified at the same pixels, the chosen one marked, files and figure."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from optics.made import FLAT, StubCamera, bank, monochrome, scene

from gpusim import pareto
from gpusim.cli.pareto import region, table, write
from gpusim.errors import UserError
from gpusim.pareto import CHOSEN, Point, Sweep, Variant, sweep, variants
from gpusim.plan import Accuracy
from gpusim.report.pareto_figure import draw, png
from gpusim.scene.chart import Rect

CAMERA = StubCamera(bank(coma_um=3.0, falloff=0.1, halo=0.02), monochrome(48, 64))
EDGE = scene((Rect(0.1, 0.05, 0.4, 0.35, 0.1, 1),), np.stack([FLAT, 0.2 * FLAT]))
ASKED = Accuracy(1e-2, 8)


@pytest.fixture(scope="module")
def found() -> Sweep:
    """Return a sweep of one variant of each kind, and of one that cannot be made."""
    kept = ("tolerance 0.03", "0.25 x the nodes", "4 samples a pixel", "core of 6 um", "not cut")

    def refused(renderer: object) -> None:
        raise UserError("it cannot be", value="so wide", allowed="less")

    some = [v for v in variants(ASKED, 1) if v.name in kept]
    first = Variant(CHOSEN, "tolerance 0.01", ASKED)
    patch = pytest.MonkeyPatch()
    patch.setattr(pareto, "REPEATS", 1)
    impossible = Variant("knob", "impossible", ASKED, refused)
    patch.setattr(pareto, "variants", lambda *given: iter([first, *some, impossible]))
    seen = []
    try:
        result = sweep(CAMERA, EDGE, ASKED, 0.01, progress=lambda *step: seen.append(step))
    finally:
        patch.undo()
    assert ("truth", 8, 8) in seen and ("variants", 7, 7) in seen
    return result


def test_the_chosen_plan_comes_first_and_every_kind_is_there():
    everything = list(variants(ASKED, 2))
    assert everything[0] == Variant(CHOSEN, "tolerance 0.01", ASKED)
    names = [variant.name for variant in everything]
    assert len(set(names)) == len(names)
    families = {variant.family for variant in everything}
    assert families == {CHOSEN, "method", "PSF nodes", "oversampling", "cut of the PSF"}
    assert "4 samples a pixel" not in [variant.name for variant in variants(ASKED, 4)]
    sigmas = [v.accuracy for v in variants(Accuracy(0.1, 8, "sigma"), 2) if v.family == CHOSEN]
    assert {one.unit for one in sigmas} == {"sigma"} and len(sigmas) == 6
    assert max(one.tolerance for one in sigmas) == pytest.approx(3.0)


def test_all_are_certified_and_timed(found: Sweep):
    by_name = {point.name: point for point in found.points}
    assert found.probes == 8 and found.truth_s > 0 and len(by_name) == 7
    made = [point for point in found.points if not point.obstacle]
    assert [point.chosen for point in made] == [True] + [False] * 5
    assert all(
        point.wall_s > 0 and 0 < point.rms_relative <= point.worst_relative for point in made
    )
    assert by_name["tolerance 0.01"].rms_relative < 1e-2
    impossible = by_name["impossible"]
    assert impossible.wall_s is None and "so wide; allowed: less" in impossible.obstacle


def test_a_knob_changes_what_it_names(found: Sweep):
    by_name = {point.name: point for point in found.points}
    chosen = by_name["tolerance 0.01"]
    fewer = by_name["0.25 x the nodes"]
    assert fewer.nodes != chosen.nodes and fewer.predicted > 2 * chosen.predicted
    assert fewer.rms_relative > 2 * chosen.rms_relative  # coma: the nodes matter
    assert by_name["4 samples a pixel"].samples_per_pixel.startswith("4")
    assert by_name["4 samples a pixel"].rms_relative < 1.5 * chosen.rms_relative
    assert by_name["core of 6 um"].samples_per_pixel.count("+") == 1
    assert "+" not in by_name["not cut"].samples_per_pixel
    assert by_name["not cut"].rms_relative < 1.5 * chosen.rms_relative


def test_files_and_table_hold_the_points(found: Sweep, tmp_path):
    write(found, tmp_path, {"camera": "one"})
    with (tmp_path / "pareto.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [point.name for point in found.points]
    assert float(rows[0]["rms_relative"]) == found.points[0].rms_relative
    facts = json.loads((tmp_path / "pareto.json").read_text())
    assert facts["camera"] == "one" and len(facts["points"]) == len(rows)
    shown = table(found.points)
    assert shown.row_count == len(found.points) + len({p.family for p in found.points})


@pytest.mark.parametrize("unit", ["relative", "sigma"])
def test_the_figure_marks_the_chosen_plan_and_names_the_others(found: Sweep, unit: str):
    figure = draw(found.points, "title", "facts", unit, 0.01)
    assert isinstance(figure, Figure)
    axes = figure.axes[0]
    texts = [text.get_text() for text in axes.texts]
    assert "chosen: tolerance 0.01" in texts and "0.25 x the nodes" in texts
    assert "impossible" not in texts
    at = {tuple(line.get_xydata()[0]) for line in axes.lines if line.get_markersize() == 14}
    chosen = found.points[0]
    assert at == {(chosen.wall_s, getattr(chosen, f"rms_{unit}"))}
    assert png(figure).startswith(b"\x89PNG")


def test_a_region_keeps_the_sensors_shape():
    camera = SimpleNamespace(sensor=monochrome(1520, 2028))
    small = region(replace_like(camera))
    assert (small.sensor.rows, small.sensor.cols) == (384, 512)
    tiny = region(replace_like(SimpleNamespace(sensor=monochrome(48, 64))))
    assert (tiny.sensor.rows, tiny.sensor.cols) == (48, 64)


def replace_like(camera: SimpleNamespace) -> StubCamera:
    return replace(CAMERA, sensor=camera.sensor)


def test_points_of_nothing_are_left_out():
    point = Point(
        CHOSEN, "a", True, 1e-2, 1e-3, 1e-3, 2e-3, 0.1, 0.2, 0.5, 0.1, "2", "3 x 3", "8", 1
    )
    bad = Point("knob", "b", False, 1e-2, obstacle="no")
    figure = draw([point, bad], "t", "f", "relative", 1e-2)
    assert "b" not in [text.get_text() for text in figure.axes[0].texts]
