"""``gpusim validate``."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text
from threadpoolctl import threadpool_limits

import gpusim
from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.gpu import default_device
from gpusim.report.drawing import png
from gpusim.report.words import duration
from gpusim.validate.bars import Bar
from gpusim.validate.report import Report

Progress = Callable[[str, int, int], None]


def kodak(out: Path, *, own_tracer: bool) -> int:
    """Reproduce the Kodak paper's validation; return the exit code, 1 where a bar fails."""
    from gpusim.validate import kodak_page as page
    from gpusim.validate.kodak_measured import measured

    return _written(out, lambda progress: page.report(measured(progress, own=own_tracer)))


def ansys(out: Path) -> int:
    """Reproduce the Ansys and Meta paper's validation; return the exit code."""
    from gpusim.validate import ansys_page as page
    from gpusim.validate.ansys_measured import measured

    def made(progress: Progress) -> Report:
        found = measured(progress)
        return page.report(found.targets, found.edges, found.even)

    return _written(out, made)


def samsung(out: Path, *, own_tracer: bool) -> int:
    """Reproduce the Samsung paper's validation; return the exit code, 1 where a bar fails."""
    from gpusim.validate.samsung import validated

    return _written(out, lambda progress: validated(progress, own=own_tracer))


def _written(out: Path, made: Callable[[Progress], Report]) -> int:
    """Make a report and write it into a folder; return the exit code."""
    started, device = time.perf_counter(), default_device()
    with staging(out) as folder:
        # numba, which optiland uses, warns of its own insides.
        with screen.progress_bar() as progress, threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            report = made(progress)
        drawn = {one.name: one.figure for one in report.sections if one.figure is not None}
        pictures = {name: png(figure) for name, figure in drawn.items()}
        names = {name: f"validation-{report.name}-{name}.png" for name in pictures}
        for name, picture in pictures.items():
            (folder / names[name]).write_bytes(picture)
        facts = {
            "gpusim": gpusim.__version__,
            "command": ["gpusim", *sys.argv[1:]],
            "adapter": device.report()["adapter"],
            "seconds": time.perf_counter() - started,
            **report.facts(),
        }
        text = json.dumps(facts, indent=1, allow_nan=False)
        (folder / f"{report.name}.json").write_text(text + "\n")
        (folder / f"{report.name}.html").write_text(report.html(pictures), encoding="utf-8")
        page = folder / f"validation-{report.name}.md"
        page.write_text(report.markdown(names), encoding="utf-8")
    console = Console()
    if not report.independent:
        screen.show_warning(f"predicted by {report.tracer}, not independent of the renders")
    console.print(bars_table(report.bars))
    held = sum(bar.held for bar in report.bars)
    said = f"{held} of {len(report.bars)} bars held, predicted by {report.tracer}, in "
    said += duration(facts["seconds"])
    for line in (said, *(str(out / f"{report.name}.{kind}") for kind in ("html", "json"))):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 0 if held == len(report.bars) else 1


def bars_table(bars: Sequence[Bar]) -> Table:
    """Return bars as a table."""
    shown = Table("what", "worst", "bar", "", box=None, header_style="bold")
    for bar in bars:
        verdict = Text("held", "green") if bar.held else Text("NOT HELD", "bold red")
        shown.add_row(Text(bar.name), f"{bar.value:.4g}", f"{bar.bound:.4g} {bar.unit}", verdict)
    return shown
