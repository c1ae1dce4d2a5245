"""A corpus of damaged OpenEXR files: each is read as a picture, or is one clear error, in bounds.

A process of its own reads them, so that a crash of the library's is a failed test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import ROOT
from scene.damaged_exr import COMPRESSIONS, damaged, write_whole

SECONDS, BYTES = 2.0, 1 << 30  # for one file: processor time, and memory beyond that of a whole one
SCREEN_LINES = 8
KINDS = ("half scan lines", "float scan lines", "half tiles")
# Reads the files of a folder in order, of which the first is whole; tells what became of each.
READ = """
import json, resource, sys, time, warnings
from pathlib import Path
import numpy as np
from gpusim.errors import UserError
from gpusim.scene import make_scene
warnings.simplefilter("ignore")
for path in sorted(Path(sys.argv[1]).glob("*.exr")):
    started = time.process_time()
    said = ""
    try:
        planes = make_scene(path).source.planes
        outcome = "read" if np.isfinite(planes).all() and (planes >= 0).all() else "no radiance"
    except UserError as error:
        outcome, said = "refused", error.screen()
    except Exception as error:
        outcome, said = "traceback", repr(error)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    print(json.dumps([outcome, said, time.process_time() - started, memory]), flush=True)
"""


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Write whole and damaged files; return their folder, and what was done to each."""
    folder, done = tmp_path_factory.mktemp("corpus"), []
    for compression in COMPRESSIONS:
        # The header is the same whatever packs the samples.
        for kind in KINDS if compression == "NO" else KINDS[:1]:
            tiled, sample = "tiles" in kind, "f4" if "float" in kind else "f2"
            whole = write_whole(folder / "whole.exr", compression, tiled, sample).read_bytes()
            for what, content in (("whole", whole), *damaged(whole, compression == "NO")):
                (folder / f"{len(done):05d}.exr").write_bytes(content)
                done.append(f"{compression}, {kind}: {what}")
    (folder / "whole.exr").unlink()
    return folder, done


def test_a_damaged_file_is_read_or_is_one_clear_error(corpus: tuple[Path, list[str]]):
    folder, done = corpus
    run = subprocess.run(
        [sys.executable, "-c", READ, str(folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    found = [json.loads(line) for line in run.stdout.splitlines()]
    assert (run.returncode, len(found)) == (0, len(done)), f"crash: {done[len(found)]}"
    allowed = found[0][3] + BYTES
    for what, (outcome, said, seconds, memory) in zip(done, found, strict=True):
        assert outcome in (("read",) if what.endswith("whole") else ("read", "refused")), (
            what,
            said,
        )
        assert len(said.splitlines()) <= SCREEN_LINES, (what, said)
        assert seconds < SECONDS and memory < allowed, (what, seconds, memory)
    assert sum(one[0] == "refused" for one in found) > len(found) / 4
