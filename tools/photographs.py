#!/usr/bin/env python
"""Hold photographs to their bars: every camera preset before every picture, from empty caches.

    tools/photographs.py [--cameras NAME,...] [--driver ICD.json] [--keep DIR] PICTURE ...

Each pair is one `gpusim render`, certified, in a process of its own. Then a row of a table in
Markdown: time by phase, parts of the certificate, what is missed; exit code 1 where something is:

- the certificate meets its tolerance, 1e-3 in all;
- the run takes at most START_S and MEGAPIXEL_S for each million pixels, on two cores. Times are
  those of a clock: nothing else should run meanwhile.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from drivers import ROOT, run

START_S, MEGAPIXEL_S = 60.0, 8.0
CAMERAS = ROOT / "gpusim" / "data" / "cameras"
PARTS = ("engine_rms", "bank_rms", "sensor_rms", "window", "total_rms", "total_worst")
COLUMNS = (
    "camera",
    "picture",
    "MP",
    "wall s",
    "CPU s",
    "bar s",
    *PARTS,
    "missed",
    "phases",
)


def measured(camera: str, picture: Path, icd: str | None, out: Path, cache: Path) -> list[str]:
    """Render a picture through a camera on a driver; return its row of the table."""
    words = [sys.executable, "-m", "gpusim", "render", camera, str(picture), "--out", str(out)]
    done = run(words, icd, cache)
    row = [camera, picture.stem]
    report = out / "report.json"
    if not report.exists():
        return [
            *row,
            "",
            f"{done['wall_s']:.0f}",
            *[""] * (2 + len(PARTS)),
            f"no result: {done['log'][-300:]}",
            "",
        ]
    facts = json.loads(report.read_text())
    megapixels = facts["capture"]["rows"] * facts["capture"]["cols"] / 1e6
    bar_s = START_S + MEGAPIXEL_S * megapixels
    certificate = facts["certificate"]
    missed = [f"{done['wall_s']:.0f} s"] if done["wall_s"] > bar_s else []
    missed += [] if certificate["met"] else ["certificate"]
    return [
        *row,
        f"{megapixels:.2f}",
        f"{done['wall_s']:.0f}",
        f"{done['cpu_s']:.0f}",
        f"{bar_s:.0f}",
        *(f"{certificate[part]:.1e}" for part in PARTS),
        ", ".join(missed),
        phases(facts),
    ]


def phases(facts: dict) -> str:
    """Return what took a second or more of a run, by its report."""
    parts = {
        **{f"prepare {name}": seconds for name, seconds in facts["prepare_s"].items()},
        **facts["times_s"],
        "certificate": facts["certificate"]["seconds"],
        "all of the render": facts["capture"]["wall_s"],
    }
    return ", ".join(f"{name} {seconds:.0f}" for name, seconds in parts.items() if seconds >= 1)


def main() -> int:
    """Measure, print, and return 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("pictures", nargs="+", type=Path, help="photographs: EXR, TIFF, PNG, HDR")
    parser.add_argument("--cameras", help="names of presets, with commas; all of them if not given")
    parser.add_argument("--driver", type=Path, help="Vulkan ICD file (JSON) of another driver")
    parser.add_argument("--keep", type=Path, help="where to keep the renders, for a look at them")
    given = parser.parse_args()
    cameras = (
        given.cameras.split(",")
        if given.cameras
        else sorted(p.stem for p in CAMERAS.glob("*.yaml"))
    )
    icd = None if given.driver is None else str(given.driver.resolve())
    print(*("", *COLUMNS, ""), sep="|")
    print("|---" * len(COLUMNS) + "|", flush=True)
    missed = False
    for camera in cameras:
        for picture in given.pictures:
            with tempfile.TemporaryDirectory() as folder:
                out = (given.keep or Path(folder)) / f"{camera}-{picture.stem}"
                row = measured(camera, picture.resolve(), icd, out.resolve(), Path(folder))
            print(*("", *row, ""), sep="|", flush=True)
            missed |= bool(row[COLUMNS.index("missed")])
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
