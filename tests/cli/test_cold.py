"""Cold starts at once: several first runs fill one empty cache, and none disturbs another."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT

from gpusim.isp.rawfile import read_codes

# Rates that each run measured for itself could make each another plan, and so another raw.
SCRIPT = """
import sys
from gpusim.calibrate import rates
from gpusim.cli import main
from gpusim.plan.costs import LAVAPIPE
rates.measure = lambda device, progress: LAVAPIPE
sys.argv[0] = "gpusim"
main()
"""
CAMERA = """
title: a camera
lens: {prescription: double-gauss, f_number: 8, max_field_deg: 1}
sensor: {preset: imx249-mono, rows: 24, cols: 32}
"""


@pytest.mark.slow
def test_four_first_runs_at_once_give_one_raw_and_one_cache(tmp_path: Path):
    cache, camera = tmp_path / "cache", tmp_path / "camera.yaml"
    camera.write_text(CAMERA)
    given = ["render", camera, "grey", "--tolerance", "1e-2", "--certify", "1"]
    outs = [tmp_path / f"out{number}" for number in range(4)]
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, *map(str, given), "--quiet", "--out", str(out)],
            env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)},
            stderr=subprocess.PIPE,
            text=True,
        )
        for out in outs
    ]
    said = [run.communicate()[1] for run in runs]
    assert [run.returncode for run in runs] == [0] * 4, said
    raws = [read_codes(out / "raw.dng").codes for out in outs]
    assert raws[0].std() > 1 and all((raw == raws[0]).all() for raw in raws)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["cache", "camera.yaml", *(out.name for out in outs)]
    )
    kept = [path for path in (cache / "gpusim").rglob("*") if path.is_file()]
    assert {path.suffix for path in kept} == {".json", ".nc"}, kept
