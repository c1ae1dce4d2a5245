"""Interruptions: a run ends within a second, and leaves neither half a file nor its own folders."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import ROOT

from gpusim.cli import files
from gpusim.cli.files import LOCK, PREFIX, staging, sweep
from gpusim.errors import UserError

# A run at work inside a step that no exception of Python's enters: waiting for a pool of threads,
# and a call that holds the main thread. Each says when it is there.
WORK = {
    "pool": "with ThreadPoolExecutor(2) as pool: list(pool.map(time.sleep, [60] * 4))",
    "call": "signal.pthread_sigmask(signal.SIG_BLOCK, []); time.sleep(0)\n"
    "        import ctypes; ctypes.CDLL(None).usleep(60_000_000)",
    "swallowed": "for _ in range(600):\n"
    "            try: time.sleep(0.1)\n"
    "            except BaseException: pass",
}
SCRIPT = """
import signal, sys, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from gpusim.cli.files import staging
from gpusim.cli.stop import stopping
with stopping():
    with staging(Path(sys.argv[1])) as folder:
        (folder / "half").write_text("a")
        print("at work", flush=True)
        {work}
"""


def started(folder: Path, script: str, *arguments: str) -> subprocess.Popen:
    run = subprocess.Popen(
        [sys.executable, "-c", script, str(folder), *arguments],
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stdout.readline() == "at work\n"
    return run


def ended_within_a_second(run: subprocess.Popen, number: int) -> None:
    sent = time.monotonic()
    run.send_signal(number)
    try:
        _, err = run.communicate(timeout=30)
    finally:
        run.kill()  # one that does not end
    assert time.monotonic() - sent < 1.0
    assert run.returncode == 128 + number
    assert err.strip() == f"stopped by {signal.Signals(number).name}"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("work", WORK)
def test_a_signal_ends_a_run_within_a_second(tmp_path: Path, work: str, number: int):
    (tmp_path / "raw.dng").write_text("of before")
    ended_within_a_second(started(tmp_path, SCRIPT.format(work=WORK[work])), number)
    assert [file.name for file in tmp_path.iterdir()] == ["raw.dng"]


# Tables of a photograph's highlights, as many of these as a scene may have: planned, and made.
LAMPS = """
import sys
from pathlib import Path
import numpy as np
from optics.lamps import PITCH, SPECTRA
from optics.made import bank, sensor
from gpusim.cli.files import staging
from gpusim.cli.stop import stopping
from gpusim.gpu import default_device
from gpusim.optics.highlight_plan import plan_highlights
from gpusim.optics.highlight_tables import Tables
from gpusim.optics.point_sources import PointSources
from gpusim.scene.highlights import MOST, Highlights
rng = np.random.default_rng(1)
lens = bank(fields=6, size=256, circle_um=3000.0, sigma_um=(1.0,) * 7, lateral=(0.0,) * 7)
lamps = Highlights(rng.uniform(-1500, 1500, (MOST, 2)), 2 * PITCH, rng.random((MOST, 3)))
given = lens, sensor(2000, 2000), lamps, SPECTRA, 1e-3
device, planned = default_device(), plan_highlights(*given) if sys.argv[2] == "make" else None
table = Tables.table

def told(*given):
    Tables.table = table
    print("at work", flush=True)
    return table(*given)

with stopping(), staging(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("a")
    Tables.table = told
    while True:
        if planned is None:
            plan_highlights(*given)
        else:
            PointSources(device, planned).light([(0, 0, 2000, 2000)])
"""


@pytest.mark.slow
@pytest.mark.parametrize("work", ["plan", "make"])
@pytest.mark.parametrize("after_s", [0.1, 1.0])
def test_an_interrupt_ends_a_run_within_tables_of_highlights(
    tmp_path: Path, work: str, after_s: float
):
    run = started(tmp_path, LAMPS, work)
    time.sleep(after_s)
    ended_within_a_second(run, signal.SIGINT)
    assert list(tmp_path.iterdir()) == []


def test_the_next_run_removes_what_a_killed_one_left(tmp_path: Path):
    killed, alive = (started(tmp_path, SCRIPT.format(work=WORK["pool"])) for _ in range(2))
    killed.kill()
    killed.wait()
    assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 2
    with staging(tmp_path) as folder:
        (folder / "raw.dng").write_text("whole")
        # That of the run that lives, and this one's.
        assert len(list(tmp_path.glob(f"{PREFIX}*"))) == 2
    assert (tmp_path / "raw.dng").read_text() == "whole"
    alive.kill()
    alive.wait()
    sweep(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["raw.dng"]


def test_a_folder_without_a_lock_is_removed_once_it_is_old(tmp_path: Path):
    left = tmp_path / f"{PREFIX}abc"
    left.mkdir()
    sweep(tmp_path)
    assert left.is_dir()  # its run may be about to lock it
    os.utime(left, (0, 0))
    sweep(tmp_path)
    assert not left.exists()


def test_a_folder_that_is_removed_midway_is_one_clear_error(tmp_path: Path):
    out = tmp_path / "out"
    with pytest.raises(UserError, match="was removed") as caught, staging(out) as folder:
        shutil.rmtree(out)
        (folder / "raw.dng").write_text("a")
    assert caught.value.file == out and not out.exists()


LIMITED = """
import resource, sys
from pathlib import Path
from gpusim.cli.files import staging
resource.setrlimit(resource.RLIMIT_FSIZE, (40 << 10, 40 << 10))
{work}
"""
WRITES = {
    "plain": """
from gpusim.errors import UserError
try:
    with staging(Path(sys.argv[1])) as folder:
        (folder / "a").write_bytes(bytes(1 << 20))
except UserError as error:
    print(error.problem)
""",
    # HDF5 of its own accord crashes the process: see gpusim.psf.store.save_dataset.
    "bank": """
import numpy as np, xarray
from gpusim.psf.store import save_dataset
try:
    save_dataset(xarray.Dataset({"a": ("x", np.arange(1e5))}), Path(sys.argv[1]) / "a.nc")
except OSError as error:
    print(error.strerror)
""",
}


@pytest.mark.parametrize("kind", WRITES)
def test_a_file_larger_than_the_limit_is_one_clear_error(tmp_path: Path, kind: str):
    done = subprocess.run(
        [sys.executable, "-c", LIMITED.format(work=WRITES[kind]), str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "File too large" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_files_of_a_run_that_works_are_locked(tmp_path: Path):
    with staging(tmp_path) as folder:
        assert folder in files.UNFINISHED and (folder / LOCK).exists()
    assert not files.UNFINISHED and list(tmp_path.iterdir()) == []
