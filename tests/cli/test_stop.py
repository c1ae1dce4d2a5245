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


def started(folder: Path, work: str) -> subprocess.Popen:
    run = subprocess.Popen(
        [sys.executable, "-c", SCRIPT.format(work=work), str(folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stdout.readline() == "at work\n"
    return run


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("work", WORK)
def test_a_signal_ends_a_run_within_a_second(tmp_path: Path, work: str, number: int):
    (tmp_path / "raw.dng").write_text("of before")
    run = started(tmp_path, WORK[work])
    sent = time.monotonic()
    run.send_signal(number)
    _, err = run.communicate(timeout=30)
    assert time.monotonic() - sent < 1.0
    assert run.returncode == 128 + number
    assert err.strip() == f"stopped by {number.name}"
    assert [file.name for file in tmp_path.iterdir()] == ["raw.dng"]


def test_the_next_run_removes_what_a_killed_one_left(tmp_path: Path):
    killed, alive = (started(tmp_path, WORK["pool"]) for _ in range(2))
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
