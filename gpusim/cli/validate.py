"""``gpusim validate``."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Sequence
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


def kodak(out: Path, *, own_tracer: bool) -> int:
    """Reproduce the Kodak paper's validation; return the exit code, 1 where a bar fails."""
    from gpusim.validate import kodak_figures as figures
    from gpusim.validate import kodak_page as page
    from gpusim.validate.kodak import measure_edges, predictor_of, stand_in

    started, device = time.perf_counter(), default_device()
    with staging(out) as folder:
        # numba, which optiland uses, warns of its own insides.
        with screen.progress_bar() as progress, threadpool_limits(1), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            lens = stand_in()
            progress("predictions", 0, 1)
            predictor = predictor_of(lens, own=own_tracer)
            progress("predictions", 1, 1)
            edges = measure_edges(lens, predictor, progress)
        bars = edges.bars()
        drawn = {
            "positions": figures.draw_positions(edges),
            "edges": figures.draw_edges(edges),
            "mtf": figures.draw_mtfs(edges),
        }
        pictures = {name: png(figure) for name, figure in drawn.items()}
        names = {name: f"validation-kodak-{name}.png" for name in pictures}
        for name, picture in pictures.items():
            (folder / names[name]).write_bytes(picture)
        facts = {
            "gpusim": gpusim.__version__,
            "command": ["gpusim", *sys.argv[1:]],
            "adapter": device.report()["adapter"],
            "seconds": time.perf_counter() - started,
            **page.numbers(edges, bars),
        }
        text = json.dumps(facts, indent=1, allow_nan=False)
        (folder / "kodak.json").write_text(text + "\n")
        (folder / "kodak.html").write_text(page.html(edges, bars, pictures), encoding="utf-8")
        written = page.markdown(edges, bars, names)
        (folder / "validation-kodak.md").write_text(written, encoding="utf-8")
    console = Console()
    if not edges.independent:
        screen.show_warning(f"predicted by {edges.tracer}, which is not independent of the renders")
    console.print(bars_table(bars))
    held = sum(bar.held for bar in bars)
    said = f"{held} of {len(bars)} bars held, predicted by {edges.tracer}, in "
    said += duration(facts["seconds"])
    for line in (said, *(str(out / name) for name in ("kodak.html", "kodak.json"))):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return 0 if held == len(bars) else 1


def bars_table(bars: Sequence[Bar]) -> Table:
    """Return bars as a table."""
    shown = Table("what", "worst", "bar", "", box=None, header_style="bold")
    for bar in bars:
        verdict = Text("held", "green") if bar.held else Text("NOT HELD", "bold red")
        shown.add_row(Text(bar.name), f"{bar.value:.4g}", f"{bar.bound:g} {bar.unit}", verdict)
    return shown
