"""The command line as the tests run it."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import pytest

from gpusim.cli import main

ROOT = Path(__file__).parent.parent


@dataclass
class Ran:
    """What a command left behind."""

    code: int
    out: str
    err: str


def gpusim(*arguments: object) -> Ran:
    """Run the command line in this process."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.dict(os.environ, COLUMNS="200"),
        mock.patch.object(sys, "argv", ["gpusim", *map(str, arguments)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as left,
    ):
        main()
    return Ran(left.value.code, out.getvalue(), err.getvalue())


def process(*arguments: object, **variables: object) -> Ran:
    """Run the command line as a user does, in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    done = subprocess.run(
        [sys.executable, "-m", "gpusim", *map(str, arguments)],
        env={**environment, **{name: str(value) for name, value in variables.items()}},
        capture_output=True,
        text=True,
        check=False,
    )
    return Ran(done.returncode, done.stdout, done.stderr)


def assert_refused(ran: Ran, *words: object) -> None:
    """Check that a command ended with one screen that has all `words`, and without a traceback."""
    assert ran.code == 2, ran
    assert ran.out == ""
    assert "Traceback" not in ran.err
    # Problem, file, field, value, allowed; of what YAML says, some lines more.
    assert len(ran.err.strip().splitlines()) <= 12
    for word in words:
        assert str(word) in ran.err
