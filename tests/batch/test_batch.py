"""A batch loses nothing: whatever is killed, it ends with the bytes of an uninterrupted run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from pyarrow import parquet
from typer.testing import CliRunner

from gpusim.batch import cost, kept
from gpusim.batch.kept import LIGHTS
from gpusim.batch.run import prepared, status, tasks_of
from gpusim.batch.run import run as run_batch
from gpusim.batch.sweep import Sweep
from gpusim.batch.work import Task, rendered, work
from gpusim.cli.app import app
from gpusim.disk import beside
from gpusim.errors import UserError
from gpusim.isp.tiff import write_tiff
from gpusim.plan import Accuracy
from gpusim.plan.costs import LAVAPIPE
from gpusim.plan.deadline import first_frame_s
from gpusim.render import planning
from gpusim.scene import make_scene
from gpusim.scene.exr import units_of

CAMERA = {
    "title": "small",
    "lens": {"mtf": "diffraction-limited"},
    "sensor": {"preset": "imx477", "rows": 32, "cols": 48},
}
SWEEP = {
    "camera": "small.yaml",
    "scenes": ["colorchecker"],
    "axes": {"seed": {"range": [0, 6]}, "exposure_s": [0.005, 0.02]},
    "tolerance": "1e-2",
    "probes": 8,
    "outputs": ["raw", "truth"],
}
TAKEN = 1.7e9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(yaml.safe_dump(CAMERA))
    return tmp_path


def written(folder: Path, **changes: object) -> Path:
    path = folder / "sweep.yaml"
    path.write_text(yaml.safe_dump(SWEEP | changes, sort_keys=False))
    return path


def files_of(out: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in out.glob("frame-*") if p.suffix != ".json"}


def run(*words: object):
    return CliRunner().invoke(app, ["batch", *map(str, words)])


def test_frames_that_share_a_light_are_exposed_once(folder: Path, monkeypatch):
    exposures = []
    right = kept.exposed
    monkeypatch.setattr(kept, "exposed", lambda *given: exposures.append(1) or right(*given))
    axes = SWEEP["axes"] | {"luminance_cd_m2": [100, 300]}
    sweep = Sweep.load(written(folder, axes=axes, probes=4))
    assert len(sweep) == 24 and len({frame.light_key for frame in sweep.frames}) == 2
    out = folder / "out"
    out.mkdir()
    found = [one for task in tasks_of(sweep, out, TAKEN) for one in work(task)]
    assert len(exposures) == 2 and [one["number"] for one in found] == list(range(24))
    assert all(one["certificate_met"] for one in found)
    assert [len(task.numbers) for task in tasks_of(sweep, folder / "new", TAKEN)] == [10, 2, 10, 2]
    # What is there is left alone.
    before = {path: path.stat().st_mtime_ns for path in out.glob("frame-*")}
    assert not tasks_of(sweep, out, TAKEN)
    assert before == {path: path.stat().st_mtime_ns for path in out.glob("frame-*")}


def test_the_frames_are_those_of_the_library(folder: Path):
    axes = {"seed": [3], "iso": [100, 400], "noise": [True, False], "exposure_s": [0.005, 0.02]}
    sweep = Sweep.load(written(folder, axes=axes))
    out = folder / "out"
    out.mkdir()
    for task in tasks_of(sweep, out, TAKEN):
        work(task)
    import rawpy

    light = kept.exposed(sweep.frames[0])
    pairs = list(rendered(sweep.frames))
    assert [frame.number for frame, _ in pairs] == list(range(8))
    for frame, taken in pairs:
        alone = light.at(sensor=frame.sensor()).capture(**frame.read_out)
        assert (taken.raw == alone.raw).all()
        assert taken.noise == frame.settings["noise"]
        with rawpy.imread(str(out / f"{frame.name}.dng")) as raw:
            assert (raw.raw_image == alone.raw).all()
        assert units_of(out / f"{frame.name}.truth.exr") == "DN"
        assert taken.exposure_s == frame.settings["exposure_s"]


@pytest.mark.parametrize(
    "axes, touched",
    [
        ({"serial_number": [0, 1]}, "sensor"),
        ({"sensor.temporal_dark_noise_e": [1.0, 30.0]}, "sensor"),
        ({"iso": [100, 400]}, "sensor"),
        ({"temperature_c": {"linspace": [20, 60, 2]}}, "sensor"),
        ({"sensor.fill_factor": [0.5, 0.9]}, "light"),
        ({"illuminant": ["D65", "A"]}, "light"),
    ],
)
def test_each_axis_touches_what_it_should(folder: Path, axes: dict, touched: str):
    frames = Sweep.load(written(folder, axes=axes)).frames
    assert len({frame.light_key for frame in frames}) == (1 if touched == "sensor" else 2)
    given = [(one.sensor(), one.read_out, one.scene_options) for one in frames]
    assert given[0] != given[1]


def test_lens_axes_change_the_lens(folder: Path):
    camera = CAMERA | {"lens": {"prescription": "tessar", "focal_length_mm": 5.0}}
    (folder / "small.yaml").write_text(yaml.safe_dump(camera))
    axes = {"f_number": [4.0, 8.0], "lens.1.radius": [0.0, 0.01]}
    frames = Sweep.load(written(folder, axes=axes)).frames
    lenses = [frame.camera().lens for frame in frames]
    assert {lens.f_number for lens in lenses} == {4.0, 8.0}
    radii = [lens.surfaces[0].radius for lens in lenses]
    assert radii[1] - radii[0] == pytest.approx(0.01) and len({f.light_key for f in frames}) == 4
    plane = written(folder, axes={"lens.2.radius": [0.01]})  # the second surface is a plane
    with pytest.raises(UserError) as error:
        Sweep.load(plane)
    assert error.value.field == "axes.lens.2.radius" and "curvature" in error.value.allowed
    with pytest.raises(UserError) as error:  # a glass of index -1.3
        Sweep.load(written(folder, axes={"lens.1.nd": [-3.0]}))
    assert (error.value.field, error.value.allowed) == ("nd", "greater than 1")
    bent = Sweep.load(written(folder, axes={"lens.2.curvature": [0.001]})).frames[0]
    assert bent.camera().lens.surfaces[1].vertex_curvature == pytest.approx(0.001)


@pytest.mark.parametrize(
    "changes, field",
    [
        ({"axes": {"exposur_s": [1]}}, "axes.exposur_s"),
        ({"axes": {"f_number": [4]}}, "axes.f_number"),  # of a ready-made lens
        ({"axes": {"iso": [123]}}, "iso"),
        ({"outputs": ["tiff"]}, "outputs"),
        ({"scenes": ["nothing-*.exr"]}, "scenes"),
        ({"camera": "nosuch"}, "CAMERA"),
        ({"tolerance": "7"}, "tolerance"),
        ({"combine": "sample"}, "samples"),
        ({"what": 1}, "what"),
        ({"axes": {"exposure_s": ["1/60"]}}, "axes.exposure_s"),  # YAML reads a text
        ({"axes": {"exposure_s": {"linspace": [0, 1, 3]}}}, "axes.exposure_s"),
        ({"axes": {"seed": [0.5]}}, "axes.seed"),
        ({"axes": {"iso": [None]}}, "axes.iso"),
        ({"axes": {"temperature_c": [-400]}}, "axes.temperature_c"),
        ({"axes": {"noise": ["maybe"]}}, "axes.noise"),
        ({"axes": {"luminance_cd_m2": [True]}}, "axes.luminance_cd_m2"),
        ({"axes": {"gain": [3.3]}}, "gain"),
        ({"axes": {"illuminant": ["D65", "D5"]}}, "axes.illuminant"),
        ({"axes": {"sensor.full_well_e": [9000, -1]}}, "full_well_e"),
        ({"camera": "arvr", "axes": {"lens.1.nd": [0.0], "lens.99.nd": [0.0]}}, "axes.lens.99.nd"),
        ({"camera": "arvr", "axes": {"f_number": [4, 0.5]}}, "f_number"),
        ({"tile": [0, 0, 9999, 4]}, "tile"),
    ],
)
def test_mistakes_are_told_before_the_work(folder: Path, changes: dict, field: str):
    done = run(written(folder, **changes), "--out", folder / "out")
    assert isinstance(done.exception, UserError) and done.exception.field == field
    assert not (folder / "out").exists()


def test_mistakes_in_python_are_told_alike():
    given = {"camera": "mtf-only", "scenes": ["colorchecker"], "rows": 32, "cols": 48}
    with pytest.raises(UserError, match="perhaps scenes is meant"):
        Sweep(camera="mtf-only", scene=["colorchecker"])
    for axes in ({"isso": [100]}, {"seed": [0.5]}):
        with pytest.raises(UserError, match=f"axes.{next(iter(axes))}"):
            Sweep(**given, axes=axes).dataset()


def test_a_setting_left_to_the_camera_is_no_mistake(folder: Path):
    axes = {"exposure_s": [None, 0.01], "temperature_c": [None, 20], "noise": [True, False]}
    assert len(Sweep.load(written(folder, axes=axes))) == 8


def test_a_frame_that_fails_is_told_and_the_others_are_there(folder: Path):
    sweep = Sweep.load(written(folder, axes={"exposure_s": [0.01, 0.02], "frame": [0, 2**32]}))
    out = folder / "out"
    out.mkdir()
    found = [one for task in tasks_of(sweep, out, TAKEN) for one in work(task)]
    failed = [one for one in found if "error" in one]
    assert len(failed) == 2 and all("frame" in one["error"] for one in failed)
    assert len(status(sweep, out).done) == 2


def test_the_dry_run_counts_and_plans(folder: Path):
    before = set(folder.iterdir())
    axes = {"seed": {"range": [0, 6]}, "luminance_cd_m2": [100, 200]}
    done = run(written(folder, axes=axes), "--dry-run", "--json")
    facts = json.loads(done.output)
    assert facts["frames"] == 12 and facts["lights"] == 2 and facts["pixels_a_frame"] == 32 * 48
    light, frame = (facts[f"planned_s_a_{what}"] for what in ("light", "frame"))
    # All three are rounded: to 1 ms, 0.1 ms and 1 ms.
    assert facts["planned_s"] == pytest.approx(2 * light + 12 * frame, abs=2.2e-3)
    assert light > 0
    assert set(folder.iterdir()) == before | {folder / "sweep.yaml"}


def test_a_sweep_for_a_time_is_counted_by_what_the_time_affords(folder: Path, monkeypatch):
    """As its renders are planned; the loosest tolerance takes other seconds."""
    monkeypatch.setattr(cost, "adapter_costs", lambda device, **more: LAVAPIPE)
    sweep = Sweep.load(written(folder, tolerance="as good as 2 s allows"))
    camera = sweep.frames[0].camera()
    scene = make_scene("colorchecker", frame=camera.frame)
    afforded = Accuracy(3e-2)
    expected = first_frame_s(planning.planning(camera, scene, afforded, LAVAPIPE).plan())
    monkeypatch.setattr(planning, "resolved", lambda *given, **more: (afforded, "2 s afford it"))
    found = cost.cost_of(sweep)
    assert found.light_s + found.frame_s == pytest.approx(expected, rel=1e-12)  # a sum's rounding


def test_what_killed_workers_left_half_written_goes_when_the_batch_goes_on(folder: Path):
    sweep, out = Sweep.load(written(folder)), folder / "out"
    prepared(sweep, out, resume=False)
    kept = {"sweep.json", ".lights", "frame-000001.dng", ".scheduler-17.json"}
    half = {".3246-frame-000023.dng", ".3246-.3246-frame-000023.truth.exr", ".9-light-e0.json"}
    for name in (kept | half) - {"sweep.json"}:
        (out / name).touch()
    prepared(sweep, out, resume=True)
    assert {path.name for path in out.iterdir()} == kept


def test_a_raw_whose_writing_was_killed_goes_too(folder: Path, monkeypatch):
    sweep, out = Sweep.load(written(folder)), folder / "out"
    prepared(sweep, out, resume=False)
    there = set(out.iterdir())

    def killed(part: Path, path: Path) -> None:
        raise SystemExit  # nothing that the writer handles

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(SystemExit):
        write_tiff(beside(out / "frame-000001.dng"), np.zeros((2, 2), np.uint16), {}, {})
    assert len(set(out.iterdir()) - there) == 1
    monkeypatch.undo()
    prepared(sweep, out, resume=True)
    assert set(out.iterdir()) == there


@pytest.mark.parametrize("content", ["[" * 100_000, "[1]", '{"number": 1}', "", "\0"])
def test_damaged_accounts_are_named(folder: Path, content: str):
    sweep, out = Sweep.load(written(folder)), folder / "out"
    taken = prepared(sweep, out, resume=False)
    sidecar = out / "frame-000000.json"
    sidecar.write_text(content)
    for read in (lambda: status(sweep, out), lambda: work(Task(sweep, (0,), str(out), taken))):
        with pytest.raises(UserError) as caught:
            read()
        assert caught.value.file == sidecar and "rendered again" in caught.value.allowed
    (out / "sweep.json").write_text(content)
    with pytest.raises(UserError) as caught:
        prepared(sweep, out, resume=True)
    assert caught.value.file == out / "sweep.json" and "new folder" in caught.value.allowed


def test_a_time_of_raws_that_is_none_is_refused(folder: Path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "noon")
    with pytest.raises(UserError) as caught:
        prepared(Sweep.load(written(folder)), folder / "out", resume=False)
    assert caught.value.field == "SOURCE_DATE_EPOCH"


def command(folder: Path, *words: object) -> list[str]:
    return [
        sys.executable,
        "-m",
        "gpusim",
        "batch",
        str(folder / "sweep.yaml"),
        *map(str, words),
    ]


def environment() -> dict[str, str]:
    return os.environ | {"SOURCE_DATE_EPOCH": str(int(TAKEN))}


@pytest.mark.slow
def test_a_batch_that_is_killed_ends_with_the_same_bytes(folder: Path):
    """Client and workers are killed several times amid 60 frames; --resume ends the work."""
    sweep = written(folder, axes={"seed": {"range": [0, 60]}})
    whole, cut = folder / "whole", folder / "cut"
    given = {"check": True, "env": environment(), "timeout": 300}
    subprocess.run(command(folder, "--out", whole, "-q"), **given)
    for attempt in range(4):
        more = ["--resume"] if attempt else []
        process = subprocess.Popen(
            command(folder, "--out", cut, "-q", *more), env=environment(), start_new_session=True
        )
        wanted = min(60, 12 * (attempt + 1))
        ends = time.monotonic() + 120
        while len(list(cut.glob("frame-*.dng"))) < wanted and time.monotonic() < ends:
            if process.poll() is not None:
                break
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(command(folder, "--out", cut, "-q", "--resume"), **given)
    assert files_of(cut) == files_of(whole) and len(files_of(cut)) == 120
    numbers = [one["number"] for one in status(Sweep.load(sweep), cut).done]
    assert numbers == list(range(60))
    assert not list(cut.glob(".*-frame-*")) and not (cut / ".lights").exists()


@pytest.mark.slow
def test_an_interrupt_says_one_line(folder: Path):
    written(folder, axes={"seed": {"range": [0, 60]}})
    out = folder / "out"
    process = subprocess.Popen(
        command(folder, "--out", out, "-q"), env=environment(), stderr=subprocess.PIPE, text=True
    )
    ends = time.monotonic() + 120
    while not (out / LIGHTS).exists() and time.monotonic() < ends:  # a worker is at work
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    said = process.communicate(timeout=60)[1].strip()
    assert said == "stopped by SIGINT: what is made stays, and --resume goes on"
    assert process.returncode != 0


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_frame(folder: Path):
    import psutil

    written(folder, axes={"seed": {"range": [0, 60]}})
    out = folder / "out"
    process = subprocess.Popen(command(folder, "--out", out, "-q"), env=environment())
    ends = time.monotonic() + 120
    while len(list(out.glob("frame-*.json"))) < 5 and time.monotonic() < ends:
        time.sleep(0.02)
    workers = [
        one
        for server in psutil.Process(process.pid).children()
        if "forkserver" in " ".join(server.cmdline())
        for one in server.children()
    ]
    assert workers
    for one in workers:
        one.kill()
    assert process.wait(timeout=240) == 0
    assert len(list(out.glob("frame-*.json"))) == 60


def test_who_waits_for_a_light_sees_how_far_it_is(folder: Path):
    from distributed import Client, LocalCluster

    told = []
    sweep = Sweep.load(written(folder, axes={"seed": [1]}, probes=4))
    alone = {"n_workers": 1, "threads_per_worker": 1, "processes": False}
    with LocalCluster(**alone, dashboard_address=None) as cluster, Client(cluster) as client:
        found = run_batch(
            sweep, folder / "out", client=client, progress=lambda *one: told.append(one)
        )
    assert len(found.done) == 1 and not found.failed
    phases = {what: total for what, done, total in told if done == total}
    assert phases["frames"] == 1 and phases["light: certify"] == 4


@pytest.mark.slow
def test_a_batch_gives_a_table_and_a_page(folder: Path):
    done = run(written(folder), "--out", folder / "out", "--json")
    assert done.exit_code == 0, done.output
    facts = json.loads(done.output)
    assert facts["done"] == facts["new"] == 12 and not facts["failed"]
    table = parquet.read_table(folder / "out" / "frames.parquet").to_pydict()
    assert table["set.seed"] == [seed for seed in range(6) for _ in (0, 1)]
    assert np.all(np.diff(table["number"]) == 1)
    page = (folder / "out" / "batch.html").read_text()
    assert page.count("data:image/jpeg") == 12 and "mean of the raw" in page
    again = run(written(folder), "--out", folder / "out")
    assert isinstance(again.exception, UserError) and "--resume" in again.exception.allowed
    other = run(written(folder, axes={"seed": [1]}), "--out", folder / "out", "--resume")
    assert isinstance(other.exception, UserError) and "another sweep" in other.exception.problem
