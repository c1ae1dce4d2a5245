"""tools/bench.py: its jobs on small frames, what it prints, and how it refuses."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from fake_capture import fake_capture
from harness import assert_close
from optics import made

from gpusim.gpu import Device, Kernel
from gpusim.optics.images import field_images, mirrored
from gpusim.psf.bank import Bank

TOOLS = Path(__file__).parent.parent / "tools"
STAGES = ["paint", "warp", "fft-rows", "fft-columns", "inverse-fft", "modes", "direct"]
STAGES += ["mosaic", "crosstalk", "exposure", "noise", "adc", "sensor-12mp"]
STAGES += ["smear", "cti-linear", "cti-trap"]
DEVELOP = ["develop-12mp", "develop-12mp-directional"]
FRAMES = ["render-demo", "frame-12mp", "frame-12mp-mono", "scaling"]
SMALL = (128, 168)  # a fraction of a second for each stage
# Largest difference from the reference over its largest value. Rounding to f32 is below 2e-6 in
# transforms of 256 and in sums of that many; coordinates of a few hundred samples times a spline's
# slope give 2e-5 more for warp, and paint's formula for discs errs by 0.1 (0.8/38.7)^2 = 5e-5.
# A mean that is rounded may take the count across a step: one electron of 2000, and the rest.
WORST = {"paint": 1e-4, "warp": 4e-5} | dict.fromkeys(STAGES[2:], 4e-6) | {"sensor-12mp": 5.1e-4}


def tool(name: str) -> ModuleType:
    sys.path.insert(0, str(TOOLS))  # it imports its neighbours
    spec = importlib.util.spec_from_file_location(name, TOOLS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    sys.path.remove(str(TOOLS))
    return module


@pytest.fixture(scope="module")
def jobs() -> ModuleType:
    return tool("bench_jobs")


@pytest.fixture(scope="module")
def own_device() -> Device:
    """Return a device whose memory goes with this module: the jobs keep theirs to their end."""
    return Device.open(os.environ.get("GPUSIM_ADAPTER"))


def bench(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, str(TOOLS / "bench.py"), *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_the_list_names_every_job_in_a_line_of_its_own():
    done = bench("--list")
    assert done.returncode == 0
    lines = [line.split(maxsplit=1) for line in done.stdout.splitlines()]
    whole = [
        *FRAMES,
        "regret",
        "tolerances",
        "psf-bank",
        "psf-refocus",
        *DEVELOP,
        "burst",
        "preview-sensor",
        "preview-pan",
        "preview-focus",
    ]
    assert [name for name, _ in lines] == [*whole, *STAGES]
    assert all(what for _, what in lines)


def test_a_burst_is_its_frames_one_by_one(device: Device):
    job = tool("bench_jobs").JOBS["burst"][1](device, SMALL)
    assert job.error == {"pixels that differ": 0} and job.pixels == 20 * 128 * 128


def test_a_job_prints_one_line_of_json_and_appends_it_to_a_file(tmp_path: Path):
    file = tmp_path / "figures.jsonl"
    file.write_text("before\n")
    done = bench("adc", "--json", "--megapixels", 0.05, "--out", file)
    assert done.returncode == 0, done.stderr
    assert file.read_text() == "before\n" + done.stdout
    found = json.loads(done.stdout)
    assert found["name"] == "adc"
    assert 0 < found["best_s"] <= found["median_s"]
    assert 0.045e6 < found["pixels"] <= 0.05e6
    assert found["ratio"] == pytest.approx(found["best_s"] / found["peers"]["copy"])
    assert found["bytes"] == 8 * found["pixels"]
    assert "flops" not in found
    assert found["bytes_per_s"] == pytest.approx(found["bytes"] / found["best_s"])
    assert found["error"]["worst"] == 0.0
    assert all(isinstance(found[name], str) for name in ("adapter", "driver"))
    assert found["commit"] is None or isinstance(found["commit"], str)


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_runs_and_is_compared_with_its_reference(
    jobs: ModuleType, own_device: Device, stage: str
):
    job = jobs.JOBS[stage][1](own_device, SMALL)
    job.run()
    assert job.pixels == SMALL[0] * SMALL[1]
    assert job.nbytes >= 4 * job.samples > 0
    assert (job.flops > 0) == (
        stage in ("fft-rows", "fft-columns", "inverse-fft", "modes", "direct")
    )
    assert 0 <= job.error["worst"] <= WORST[stage]
    for run, share in job.peers.values():
        run()
        assert share >= 1


@pytest.mark.parametrize("name", DEVELOP)
def test_development_is_timed_beside_others(jobs: ModuleType, own_device: Device, name: str):
    job = jobs.JOBS[name][1](own_device, SMALL)
    made = job.run()
    assert made.picture.shape == (*SMALL, 3)
    # Rounding to 16 bits, and to f32 where the curve is steepest: 12.92 times some 2^-24.
    assert 0 <= job.error["worst"] <= 1.5e-5
    assert sum(job.facts(made)["stages_s"].values()) > 0
    for run, share in job.peers.values():
        run()
        assert share >= 1
    assert any("LibRaw" in peer for peer in job.peers)


def test_operations_are_counted_as_usual(jobs: ModuleType, own_device: Device):
    assert jobs.of_transforms(3, 256) == 3 * 5 * 256 * 8
    # One block of this frame, of 256 samples: rows of it one by one.
    grid = jobs.sim_grid(SMALL)
    rows = jobs.JOBS["fft-rows"][1](own_device, SMALL)
    blocks = grid.blocks[0] * grid.blocks[1]
    assert rows.flops == blocks * grid.block[1] * 5 * grid.length * np.log2(grid.length)


def test_operations_stand_beside_multiply_adds_alone(own_device: Device):
    found = json.loads(bench("inverse-fft", "--json", "--megapixels", 0.05).stdout)
    assert found["flops_per_s"] == pytest.approx(found["flops"] / found["best_s"])
    assert found["arithmetic_flops_per_s"] > found["flops_per_s"]
    # A line is a product and a sum of four numbers, and there are as many as are counted.
    tools = tool("bench")
    lines = tools.ARITHMETIC.count("* f + f;")
    assert lines * 4 * 2 * tools.TURNS == tools.PER_INVOCATION
    groups = []
    recorded = Kernel.record

    def record(kernel: Kernel, rec: object, count: tuple, params: dict, **buffers: object) -> None:
        groups.append((count, buffers["to"]))
        recorded(kernel, rec, count, params, **buffers)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Kernel, "record", record)
        run = tools.arithmetic(own_device, 3 * 64 * tools.PER_INVOCATION - 1)
    run()
    ((count, target),) = groups
    assert count == (3, 1, 1)
    # x = x / 2 + 1 / 2 leads to one, from anywhere: eight chains.
    assert_close(own_device.read(target), np.full(4 * 64 * 3, 8, np.float32), atol=0)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fft-columsn"], "fft-columns"),
        ([], "render-demo"),
        (["adc", "--megapixels", "0"], "0.02 to 12.3"),
    ],
)
def test_what_is_wrong_is_said_without_a_traceback(arguments: list[str], said: str):
    done = bench(*arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_the_photograph_of_the_frames_has_colours_highlights_and_shadows(jobs: ModuleType):
    planes = jobs.photograph(96, 128).source.planes
    assert planes.shape == (3, 96, 128) and planes.min() > 0
    assert planes.max() == 10.0 and np.quantile(planes, 0.02) < 0.05
    assert np.linalg.matrix_rank(planes.reshape(3, -1)) == 3
    again = jobs.photograph(96, 128).source.planes
    assert np.array_equal(planes, again)


class Lens:
    """A lens of Gaussians in place of the double Gauss, whose bank takes seconds."""

    title = "Gaussians"

    def bank(self, progress: object) -> Bank:
        """Return its PSFs, of 64 um."""
        return made.bank(size=128, circle_um=200.0, coma_um=0.6, halo=0.02)


def test_the_psfs_of_the_frames_end_63_samples_from_side_to_side(jobs: ModuleType):
    bank = jobs.FrameCamera(made.sensor(*SMALL), Lens()).bank()
    assert bank.psf.shape[-1] * bank.pitch_um == pytest.approx(63 * 0.775, abs=bank.pitch_um)
    assert bank.psf.sum(axis=(2, 3)) == pytest.approx(1, abs=1e-5)


def test_the_psfs_of_the_frames_stay_those_of_a_lens_with_an_axis(jobs: ModuleType):
    """However much light they cut: kernels of mirrored nodes are mirror images."""

    class Even:
        def bank(self, progress: object) -> Bank:
            whole = Lens().bank(progress)
            return replace(whole, psf=np.full_like(whole.psf, 1 / 128**2))

    bank = jobs.FrameCamera(made.sensor(*SMALL), Even()).bank()
    images, places = field_images(bank, made.at_lines(bank, np.ones((1, 1, 3))), 1e9)
    assert mirrored(images[:, 0], places)
    assert bank.psf.sum(axis=(2, 3)) == pytest.approx(1, abs=1e-5)


def test_a_frame_is_certified_once_and_tells_what_it_took(
    jobs: ModuleType, own_device: Device, monkeypatch: pytest.MonkeyPatch
):
    """Renders made by hand: black and white in one plane, beside colour."""
    asked = []

    class Render:
        def __init__(self, camera: object, scene: object, accuracy: object, *more: object) -> None:
            self.certified = accuracy.probes > 0
            asked.append((scene.name, accuracy.text, accuracy.probes))

        def capture(self, exposure_s: float, tile: tuple | None) -> object:
            return fake_capture(self.certified)

        def release(self) -> None:
            asked.append("released")

    monkeypatch.setattr(jobs, "Renderer", lambda *given, exposure_s: Render(*given))
    monkeypatch.setattr(
        jobs, "frame_camera", lambda *given: jobs.FrameCamera(made.sensor(*SMALL), Lens())
    )
    job = jobs.JOBS["frame-12mp-mono"][1](own_device, SMALL)
    best = job.run()
    assert (job.error["rms_sigma"], job.error["worst"], job.error["met"]) == (1e-2, 2e-3, False)
    assert job.run().certificate is None  # the second time there is none to wait for
    render, share = job.peers["frame-12mp"]
    render()
    assert share == 1 and job.pixels == SMALL[0] * SMALL[1]
    names = ["slanted-edge", "slanted-edge", "photograph"]
    probes = [jobs.FRAME_PROBES, 0, jobs.FRAME_PROBES]
    sigma = ["0.1 sigma"] * 3
    assert asked[::2] == list(zip(names, sigma, probes, strict=True))
    assert asked[1::2] == ["released"] * 3
    facts = job.facts(best)
    assert facts["planes"] == 3 and facts["memory"]["peak_bytes"] < facts["peak_rss_bytes"]


def test_a_frame_is_rendered(jobs: ModuleType, own_device: Device):
    """By the renderer itself, which knows this lens by its bank alone."""
    camera = jobs.FrameCamera(made.sensor(*SMALL), Lens())
    render = jobs.FrameRender(own_device, camera, jobs.photograph(*SMALL))
    render.error["measure"] = "not certified here"
    capture = render(tile=(40, 40, 16, 16))
    assert capture.raw.shape == (16, 16) and jobs.frame_facts(capture)["planes"] == 3


def test_scaling_goes_by_the_pixel(jobs: ModuleType, monkeypatch: pytest.MonkeyPatch):
    """Four sizes of one lens: the first call, to warm up, renders a corner of each."""
    seen, tiles = [], []

    class Render:
        def __init__(self, device: object, camera: object, scene: object) -> None:
            self.error = {}
            seen.append((camera, scene.source.planes.shape))

        def __call__(self, tile: tuple | None, further_s: float = 0.0) -> str:
            tiles.append((tile, further_s))
            self.first_s, self.further = 0.004, [0.002, 0.0005, 0.001]
            return "a capture"

    monkeypatch.setattr(jobs, "FrameRender", Render)
    monkeypatch.setattr(jobs, "frame_facts", lambda capture: {"of": capture})
    job = jobs.JOBS["scaling"][1](None, (48, 64))
    job.run()
    job.run()
    assert tiles == [((0, 0, 16, 16), 0.0)] * 4 + [(None, jobs.FURTHER_S)] * 4
    facts = job.facts(None)
    assert len(facts["sizes"]) == 4 and facts["largest_over_smallest"] >= 1
    assert all(size["of"] == "a capture" for size in facts["sizes"].values())
    for size in facts["sizes"].values():
        assert size["ns_per_pixel"] == pytest.approx(4 * size["further_ns_per_pixel"])
        assert size["further_frames"] == 3
    counts = [c.sensor.rows * c.sensor.cols for c, _ in seen[4:]]
    assert facts["further_largest_over_smallest"] == pytest.approx(max(counts) / min(counts))
    sides = [(c.sensor.rows, c.sensor.cols) for c, _ in seen[4:]]
    assert sides == [(14, 18), (28, 36), (48, 64), (96, 128)]
    assert [shape for _, shape in seen[4:]] == [(3, 7, 9), (3, 14, 18), (3, 24, 32), (3, 48, 64)]
    assert len({camera.lens.max_field_deg for camera, _ in seen}) == 1
    assert job.pixels == sum(c.sensor.rows * c.sensor.cols for c, _ in seen[4:])


def test_tolerances_are_certified_and_what_is_not_met_is_counted(jobs, own_device, monkeypatch):
    monkeypatch.setattr(jobs, "TOLERANCES", (3e-2, 1e-3))
    lens = {Lens.title: Lens}
    job = jobs.tolerances_job(own_device, (32, 40), lens, ("slanted-edge",), 6)
    facts = job.facts(None)
    assert [found["tolerance"] for found in facts["certified"]] == [3e-2, 1e-3]
    assert facts["not_met"] == sum(not found["met"] for found in facts["certified"]) == 0
    errors = [found["rms"] for found in facts["certified"]]
    assert job.error["worst"] == max(e / t for e, t in zip(errors, jobs.TOLERANCES, strict=True))


@pytest.mark.slow
def test_the_regret_of_each_scene_and_lens_is_in_the_table(jobs, own_device, monkeypatch):
    regret = sys.modules["bench_regret"]
    everything = [v.name for v in regret.variants(regret.Accuracy(1e-3, 6), 1)]
    kept = ("tolerance 0.001", "0.5 x the nodes")
    monkeypatch.setattr(regret, "SLOWER", [name for name in everything if name not in kept])
    monkeypatch.setattr(regret, "BUDGET_S", 0.0)
    given = {
        "job": jobs.Job,
        "lenses": {Lens.title: Lens},
        "scenes": ("slanted-edge",),
        "probes": 6,
    }
    job = regret.regret_job(own_device, (32, 40), **given)
    job.run()
    assert job.facts(None) == {"cells": []}  # it warms up
    job.run()
    cells = job.facts(None)["cells"]
    assert [cell["scene"] for cell in cells] == ["slanted-edge"]
    for cell in cells:
        assert cell["met"] and cell["points"][0]["name"] == kept[0]
        assert {point["name"] for point in cell["points"]} <= set(kept)
        fastest = next(p for p in cell["points"] if p["name"] == cell["fastest"])
        assert fastest["frame_s"] <= cell["frame_s"] and fastest["met"]
    assert job.error["regret"] == max(cell["regret"] for cell in cells) >= 1
    assert job.error["without"] == 0
    on_processor = own_device.report()["type"] == "CPU"
    assert job.error["clock"] == ("processor time" if on_processor else "wall clock")
