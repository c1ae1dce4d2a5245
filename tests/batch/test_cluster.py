"""The files for clusters: a SLURM script that runs on loopback, a Kubernetes manifest that fits."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import dask
import pytest
import typer
import yaml
from distributed.cli import dask_scheduler, dask_worker

from gpusim.batch import cluster
from gpusim.batch.run import status
from gpusim.batch.sweep import Sweep
from gpusim.cli.app import app

CLUSTER = Path(__file__).parents[2] / "examples" / "cluster"
SCRIPT = CLUSTER / "slurm.sh"
# Dask's programs, on loopback.
DASK = '#!/bin/sh\nexec "{}" "$@" --host 127.0.0.1\n'
# What srun does, with two tasks of this machine in place of a cluster's.
SRUN = '#!/bin/sh\n"$@" & a=$!\n"$@" & b=$!\ntrap "kill $a $b" TERM\nwait; wait\n'


@pytest.fixture(scope="module")
def parts() -> dict[tuple[str, str], dict]:
    made = yaml.safe_load_all((CLUSTER / "kubernetes.yaml").read_text())
    return {(one["kind"], one["metadata"]["name"]): one for one in made}


def pods(parts: dict) -> list[dict]:
    return [one["spec"]["template"] for one in parts.values() if "template" in one["spec"]]


def containers(parts: dict) -> dict[str, dict]:
    return {one["name"]: one for pod in pods(parts) for one in pod["spec"]["containers"]}


def test_the_script_is_one_of_bash_and_says_how_it_is_called():
    subprocess.run(["bash", "-n", SCRIPT], check=True)
    ended = subprocess.run(["bash", SCRIPT], capture_output=True, text=True)
    assert ended.returncode == 2 and "SWEEP.yaml OUT" in ended.stderr


def test_a_scheduler_that_does_not_start_ends_the_script(tmp_path: Path):
    for name in ("dask", "srun"):
        (tmp_path / name).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    ended = subprocess.run(
        ["bash", SCRIPT, tmp_path / "sweep.yaml", tmp_path / "out"],
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 1 and "did not start" in ended.stderr


def test_selectors_name_their_pods_and_volumes_their_claim(parts: dict):
    labels = [pod["metadata"]["labels"] for pod in pods(parts)]
    for (kind, _), one in parts.items():
        if kind == "Deployment":
            own = one["spec"]["template"]["metadata"]["labels"]
            assert one["spec"]["selector"]["matchLabels"] == own
        if kind == "Service":
            assert labels.count(one["spec"]["selector"]) == 1
    for pod in pods(parts):
        volumes = {one["name"]: one for one in pod["spec"].get("volumes", [])}
        for volume in volumes.values():
            claim = volume["persistentVolumeClaim"]["claimName"]
            assert ("PersistentVolumeClaim", claim) in parts
        for one in pod["spec"]["containers"]:
            assert {mount["name"] for mount in one.get("volumeMounts", [])} <= volumes.keys()


def test_the_programs_take_what_the_manifest_gives_them(parts: dict):
    """Each command line is read by the program's own parser; none is run."""
    found = containers(parts)
    known = {
        ("dask", "scheduler"): dask_scheduler.main,
        ("dask", "worker"): dask_worker.main,
        ("gpusim", "batch"): typer.main.get_command(app).commands["batch"],
    }
    read = {}
    for name, one in found.items():
        program, command, *words = one["args"]
        read[name] = known[program, command].make_context(command, words).params
    service = parts["Service", "gpusim-scheduler"]["spec"]["ports"][0]
    port = int(read["scheduler"]["port"])
    assert port == service["targetPort"] == found["scheduler"]["ports"][0]["containerPort"]
    address = f"tcp://gpusim-scheduler:{service['port']}"
    assert read["worker"]["scheduler"] == read["batch"]["scheduler"] == address
    assert read["batch"]["resume"]


def test_a_word_that_a_program_does_not_know_is_seen():
    with pytest.raises(Exception, match="--threads"):
        dask_worker.main.make_context("worker", ["tcp://host:8786", "--threads", "1"])


@pytest.mark.slow
def test_the_script_renders_a_sweep_and_goes_on_with_it(tmp_path: Path):
    """With `srun` replaced by two processes; a frame that is taken away is rendered again."""
    own, bin_ = Path(sys.executable).parent, tmp_path / "bin"
    bin_.mkdir()
    for name, text in (("srun", SRUN), ("dask", DASK.format(own / "dask"))):
        (bin_ / name).write_text(text)
        (bin_ / name).chmod(0o755)
    sweep = tmp_path / "sweep.yaml"
    sweep.write_text(
        yaml.safe_dump(
            {
                "camera": "mtf-only",
                "scenes": ["colorchecker"],
                "axes": {"seed": {"range": [0, 12]}},
                "rows": 32,
                "cols": 48,
                "tolerance": "1e-2",  # files are compared, not errors: the cheapest plan will do
                "probes": 0,
            }
        )
    )
    places = f"{bin_}:{own}:{os.environ['PATH']}"
    out = tmp_path / "out"
    raws = []
    for _ in range(2):
        subprocess.run(
            ["bash", SCRIPT, sweep, out],
            env=os.environ | {"PATH": places},
            check=True,
            timeout=300,
            start_new_session=True,
        )
        assert [one["number"] for one in status(Sweep.load(sweep), out).done] == list(range(12))
        assert not list(out.glob(".scheduler*"))
        raws.append({path.name: path.read_bytes() for path in out.glob("*.dng")})
        for path in out.glob("frame-*5*"):
            path.unlink()
    assert len(raws[0]) == 12 and raws[0] == raws[1]


def test_workers_are_forked_from_a_process_of_one_thread(monkeypatch):
    """What Dask gives a worker that it starts anew holds for the process that others come from."""
    seen = {}
    monkeypatch.setattr(cluster, "FORKS", True)
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    monkeypatch.setattr(cluster.forkserver, "ensure_running", lambda: seen.update(os.environ))
    cluster.prepare_workers()
    assert all(seen[name] == value for name, value in cluster.ENVIRONMENT.items())
    assert os.environ["OMP_NUM_THREADS"] == "7" and "MKL_NUM_THREADS" not in os.environ
    known = dask.config.get("distributed.nanny.pre-spawn-environ")
    assert {name: str(value) for name, value in known.items()} == cluster.ENVIRONMENT
