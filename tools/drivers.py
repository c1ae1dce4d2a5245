#!/usr/bin/env python
"""Hold every driver that is there to its bars: time to compile, a cold demonstration, its raw.

    tools/drivers.py [--tests] [--only] [ICD.json ...]

Drivers are the system's own and those of the ICD files given (of Mesa 25 and SwiftShader, say). On
each the demonstration runs with empty caches; with --tests the shader tests too. Times are those of
a clock: nothing else should run meanwhile. Then a table, and exit code 1 where a bar is missed:

- no kernel takes longer than COMPILE_S to compile;
- the demonstration, from empty caches and by the driver's own plan, takes at most DEMO_S, and its
  certificate holds;
- raws of drivers of one kind (llvmpipe) are the same number for number, all made by the first
  driver's plan, the others' once more: each measures other rates and may choose another;
- the tests pass.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import tifffile

COMPILE_S, DEMO_S = 10.0, 90.0
ROOT = Path(__file__).resolve().parents[1]
DEMO = ("render", "demo", "demo", "--certify", "64", "--memory", "512MiB")
TESTS = tuple(f"tests/{name}" for name in ("gpu", "optics", "sensor", "lens", "psf", "isp"))
SLOWEST_SHOWN = 6


def kernels() -> list[dict]:
    """Return what this process has compiled."""
    from gpusim.gpu import default_device

    return [
        {"path": one.path, "overrides": dict(one.overrides), "wall_s": one.wall_s}
        for one in default_device().compiled.values()
    ]


def pytest_sessionfinish() -> None:
    """Write down what the tests compiled: this file is a plugin of theirs."""
    Path(os.environ["GPUSIM_DRIVERS_OUT"]).write_text(json.dumps(kernels()))


def child(arguments: list[str]) -> int:
    """Run the command line in this process, and write down what it compiled."""
    from gpusim.cli import main

    sys.argv[1:] = arguments
    code = 0
    try:
        main()
    except SystemExit as end:
        code = int(end.code or 0)
    pytest_sessionfinish()
    return code


def run(command: list[str], icd: str | None, folder: Path) -> dict:
    """Run a command on a driver with the caches in a folder; return code, times and kernels."""
    out = folder / "kernels.json"
    caches = {name: folder / name for name in ("XDG_CACHE_HOME", "MESA_SHADER_CACHE_DIR", "TMPDIR")}
    for one in caches.values():
        one.mkdir(parents=True, exist_ok=True)
    environment = os.environ | {name: str(one) for name, one in caches.items()}
    environment |= {"GPUSIM_DRIVERS_OUT": str(out)}
    environment["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "tools")))
    if icd is not None:
        environment |= {"VK_DRIVER_FILES": icd, "VK_ICD_FILENAMES": icd}
    out.unlink(missing_ok=True)
    before, started = os.times(), time.perf_counter()
    log = folder / "log.txt"
    with log.open("w") as file:
        done = subprocess.run(command, cwd=ROOT, env=environment, stdout=file, stderr=file)
    after = os.times()
    return {
        "code": done.returncode,
        "wall_s": time.perf_counter() - started,
        "cpu_s": after.children_user
        + after.children_system
        - before.children_user
        - before.children_system,
        "kernels": json.loads(out.read_text()) if out.exists() else [],
        "log": log.read_text(),
    }


def numbers(raw: Path) -> str | None:
    """Return a digest of a raw's numbers: its bytes hold the time too."""
    return hashlib.sha256(tifffile.imread(raw).tobytes()).hexdigest() if raw.exists() else None


def measured(icd: str | None, tests: bool, plan: Path) -> dict:
    """Return what a driver did; its raw is by the plan of a file, or its own, kept there."""
    with tempfile.TemporaryDirectory() as name:
        folder, of_tests = Path(name) / "demo", Path(name) / "tests"
        out = folder / "out"
        words = [sys.executable, __file__, "--child", *DEMO, "--out"]
        demo = run([*words, str(out)], icd, folder)
        report = out / "report.json"
        facts = json.loads(report.read_text()) if report.exists() else None
        if plan.exists():
            out = folder / "by another's plan"
            run([*words, str(out), "--plan", str(plan)], icd, folder)
        elif facts is not None:
            plan.write_text(report.read_text())
        found = {
            "name": "?" if facts is None else facts["device"]["driver"],
            "adapter": "?" if facts is None else facts["device"]["adapter"],
            "demo": demo,
            "raw": numbers(out / "raw.dng"),
            "certificate": facts and facts["certificate"],
        }
        if tests:
            command = [sys.executable, "-m", "pytest", "-q", "-p", "drivers", "-p"]
            found["tests"] = run([*command, "no:cacheprovider", *TESTS], icd, of_tests)
        return found


def missed(found: dict) -> list[str]:
    """Return the bars that a driver misses."""
    demo = found["demo"]
    parts = [demo] + ([found["tests"]] if "tests" in found else [])
    result = [
        f"{one['path']} {one['overrides']} compiles for {one['wall_s']:.1f} s"
        for part in parts
        for one in part["kernels"]
        if one["wall_s"] > COMPILE_S
    ]
    if demo["code"]:
        result.append(f"the demonstration ends with {demo['code']}: {demo['log'][-400:]}")
    if demo["wall_s"] > DEMO_S:
        result.append(f"the demonstration takes {demo['wall_s']:.0f} s")
    if found.get("tests", {}).get("code"):
        result.append(f"tests fail: {found['tests']['log'][-2000:]}")
    return result


def main() -> int:
    """Measure, print, and return 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("icd", nargs="*", help="Vulkan ICD files (JSON) of further drivers")
    parser.add_argument("--tests", action="store_true", help="run the shader tests too")
    parser.add_argument("--only", action="store_true", help="leave the system's own driver out")
    given = parser.parse_args()
    icds = [*([] if given.only else [None]), *(str(Path(one).resolve()) for one in given.icd)]
    with tempfile.TemporaryDirectory() as folder:
        return compared(icds, given.tests, Path(folder) / "plan.json")


def compared(icds: list[str | None], tests: bool, plan: Path) -> int:
    """Measure drivers one after another by one plan; return 1 where a bar is missed."""
    failures, raws = [], {}
    for icd in icds:
        found = measured(icd, tests, plan)
        demo = found["demo"]
        worst = sorted(demo["kernels"], key=lambda one: -one["wall_s"])
        print(f"{found['adapter']}, {found['name']}")
        print(
            f"  demo: exit {demo['code']}, {demo['wall_s']:.0f} s, {demo['cpu_s']:.0f} s of the "
            f"processor; {len(worst)} kernels, raw {str(found['raw'])[:12]}"
        )
        if found["certificate"]:
            rms, most = (found["certificate"][f"total_{which}"] for which in ("rms", "worst"))
            print(f"  certificate: total RMS {rms:.2g}, worst {most:.2g}")
        for one in worst[:SLOWEST_SHOWN]:
            print(f"  {one['wall_s']:6.1f} s {one['path']} {one['overrides']}")
        if "tests" in found:
            print("  tests:", found["tests"]["log"].strip().splitlines()[-1])
        for one in missed(found):
            print(f"  MISSED: {one}")
            failures.append(one)
        if "llvmpipe" in found["adapter"]:
            raws[found["name"]] = found["raw"]
        sys.stdout.flush()
    if len(set(raws.values())) > 1:
        failures.append("raws differ")
        print(f"MISSED: raws differ between {', '.join(raws)}")
    return 1 if failures else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        sys.exit(child(sys.argv[2:]))
    sys.exit(main())
