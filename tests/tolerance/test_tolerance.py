"""``gpusim tolerance``: a small study, resumed; budgets that are refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command_line import gpusim

from gpusim.camera import load_camera
from gpusim.errors import UserError
from gpusim.tolerance import rendered as module
from gpusim.tolerance.budget import Budget
from gpusim.tolerance.rendered import AROUND_PX, SIDE_PX, rendered
from gpusim.tolerance.study import PARTS, STUDY, Study

BUDGET = {
    "tolerances": {
        "1.thickness": {"normal": [0, 0.003]},
        "element.1-2.decentre_x_mm": {"uniform": [-0.01, 0.01]},
    },
    "samples": 6,
    "traced_percent": 10,
    "required_cy_px": 0.1,
    "raws": False,
}


def run(folder, *more):
    (folder / "budget.yaml").write_text(yaml.safe_dump(BUDGET))
    arguments = ["--budget", folder / "budget.yaml", "--out", folder / "out"]
    return gpusim("tolerance", "machine-vision", *arguments, *more)


@pytest.mark.slow
def test_a_study_is_the_same_when_it_is_resumed(tmp_path):
    first = run(tmp_path, "--json")
    assert first.code == 0, first.err
    facts = json.loads(first.out)
    design = np.array(facts["design_mtf50_cy_px"])
    assert design.shape == (9, 2) and (design > 0.05).all() and (design < 0.6).all()
    # The design is symmetric about both of the sensor's axes.
    assert design.reshape(3, 3, 2)[::-1] == pytest.approx(design.reshape(3, 3, 2), abs=2e-3)
    assert facts["agreement"]["traced"] == 1
    # Both numbers move W by a tenth of a wave or so: what is left is of their cross term.
    assert facts["agreement"]["mtf50_most_cy_px"] < 2e-3
    out = tmp_path / "out"
    for name in ("tolerance.html", "tolerance.png", "cameras.parquet"):
        assert (out / name).stat().st_size > 1000
    parts = sorted((out / PARTS).iterdir())
    assert len(parts) == 2 * 2 + 1
    # As after a kill: one part is missing, the others keep the time they were written.
    parts[0].unlink()
    written = [part.stat().st_mtime_ns for part in parts[1:]]
    assert run(tmp_path).code != 0  # the folder is not empty
    again = run(tmp_path, "--resume", "--json")
    assert {**json.loads(again.out), "seconds": 0} == {**facts, "seconds": 0}
    assert [part.stat().st_mtime_ns for part in parts[1:]] == written


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"tolerances": {"1.weight": {"normal": [0, 1]}}}, "1.weight"),
        ({"tolerances": {"1.radius": [0, 1]}}, "tolerances"),
        ({"samples": 0}, "samples"),
        ({"compensator": "tilt"}, "compensator"),
    ],
)
def test_a_wrong_budget_is_one_clear_error(tmp_path, change, said):
    path = tmp_path / "budget.yaml"
    path.write_text(yaml.safe_dump({**BUDGET, **change}))
    with pytest.raises(UserError) as refused:
        Budget.load(path)
    assert said in refused.value.screen()


@pytest.mark.parametrize("content", ["[" * 100_000, "[1]", "{}", ""])
def test_a_damaged_mark_of_a_study_is_named(tmp_path, content):
    (tmp_path / STUDY).write_text(content)
    with pytest.raises(UserError) as refused:
        Study(load_camera("machine-vision"), Budget(**BUDGET), tmp_path).prepare(resume=True)
    assert refused.value.file == tmp_path / STUDY and "--resume" in refused.value.allowed


def test_all_stands_for_each_and_a_name_alone_counts_first():
    lens = load_camera("arvr").lens
    wide, narrow = {"normal": (0, 0.1)}, {"normal": (0, 0.01)}
    budget = Budget(tolerances={"all.thickness": wide, "2.thickness": narrow})
    axes = budget.axes(lens)
    assert len(axes) == len(lens.surfaces) - 1
    assert {name for name, axis in axes.items() if axis.normal == (0, 0.01)} == {"2.thickness"}


@pytest.mark.slow
def test_edges_in_a_rendered_raw_are_as_sharp_as_the_study_says(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "PROBES", 1)
    camera = load_camera("machine-vision")
    small = replace(camera, sensor=camera.sensor.roi(360, 480))
    study = Study(
        small, Budget(**BUDGET | {"tolerances": {"1.thickness": {"normal": [0, 0.1]}}}), tmp_path
    )
    (tmp_path / PARTS).mkdir()
    focus, design = study.evaluated(np.zeros((1, 9, *study.shape)), "design")
    raw = rendered(study, study.lens.defocused(1e3 * float(focus[0])), "design")
    # Seven lines stand for the band: 1.1e-3 (15 lines); half a pixel of edges apart from the place;
    # and the certificate's 1e-3 of the signal, over a slope of two a cycle and pixel.
    assert np.abs(raw.mtf50 - design[0]).max() < 4e-3
    assert raw.total_rms < 3e-3
    side = 3 * (SIDE_PX + 2 * AROUND_PX)
    assert raw.picture.shape == (side, side, 3) and raw.picture.std() > 40
    # What is there is read: no lens is needed any more.
    assert (rendered(study, None, "design").mtf50 == raw.mtf50).all()
