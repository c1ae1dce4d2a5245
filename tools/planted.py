"""Defects that no mechanical mutator makes, planted by hand: each must turn its test red.

They are listed in ``planted.toml``; ``tools/mutate.py --planted`` plants them one at a time in a
copy of the project.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
COPIED = ("gpusim", "shaders", "tests", "tools", "pyproject.toml")
TIMEOUT_S = 600


@dataclass(frozen=True)
class Planted:
    """A defect: in a file a text becomes another, and a test (file, words of -k) should notice.

    ``slow``: the test is one of those that are marked so.
    """

    what: str
    file: str
    old: str
    new: str
    test: str
    words: str = ""
    slow: bool = False


LIST = tuple(
    Planted(**one) for one in tomllib.loads((PROJECT / "tools/planted.toml").read_text())["planted"]
)


def survivors(wanted: str = "") -> list[Planted]:
    """Plant each defect whose description has the words; return those that their tests miss."""
    missed = []
    with tempfile.TemporaryDirectory(prefix="gpusim-planted-") as scratch:
        copy = Path(scratch)
        for name in COPIED:
            here = PROJECT / name
            (shutil.copytree if here.is_dir() else shutil.copy)(here, copy / name)
        for one in LIST:
            if wanted not in one.what:
                continue
            file = copy / one.file
            sound = file.read_text(encoding="utf-8")
            if sound.count(one.old) != 1:
                raise SystemExit(f"{one.file} has not once what is to be changed: {one.what}")
            file.write_text(sound.replace(one.old, one.new), encoding="utf-8")
            red = _is_red(copy, one)
            file.write_text(sound, encoding="utf-8")
            print(f"{'noticed' if red else 'MISSED'}: {one.what}", flush=True)
            missed += [] if red else [one]
    return missed


def _is_red(copy: Path, one: Planted) -> bool:
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", one.test]
    command += ["-m", "slow" if one.slow else "not slow"]
    command += ["-k", one.words] if one.words else []
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S
    )
    if done.returncode not in (0, 1):  # 1: tests failed; else they did not run
        raise SystemExit(f"the tests did not run for: {one.what}\n{done.stdout}{done.stderr}")
    return done.returncode == 1
