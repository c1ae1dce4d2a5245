"""``gpusim stress``."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gpusim.cli import screen
from gpusim.cli.files import staging
from gpusim.gpu import default_device
from gpusim.stress import run as run_cases
from gpusim.stress.table import FAILED, HELD, LIMIT, REFUSED, Row

STYLES = {HELD: "green", FAILED: "bold red"}


def run(as_json: bool, out: Path | None) -> int:
    """Run the stiff and extreme cases and show them; return the exit code, 1 where one fails."""
    adapter = default_device().report()["adapter"]
    with screen.progress_bar() as progress:
        rows = run_cases(progress=progress)
    counts = Counter(row.verdict for row in rows)
    failed = counts[FAILED]
    facts = {
        "adapter": adapter,
        "cases": [dataclasses.asdict(row) for row in rows],
        "failed": failed,
        "limits": counts[LIMIT],
    }
    text = json.dumps(facts, indent=1)
    if out is not None:
        with staging(out) as folder:
            (folder / "stress.json").write_text(text + "\n")
    if as_json:
        print(text)
    else:
        console = Console()
        console.print(table(rows))
        right = counts[HELD] + counts[REFUSED]
        console.print(f"{right} of {len(rows)} as expected, on {adapter}")
        if counts[LIMIT]:
            console.print(f"{counts[LIMIT]} declined that physics allows: limits of the engine")
    return 1 if failed else 0


def table(rows: list[Row]) -> Table:
    """Return the cases as a table."""
    shown = Table("case", "expected", "got", "verdict", box=None, header_style="bold")
    for row in rows:
        verdict = Text(row.verdict, style=STYLES.get(row.verdict, "yellow"))
        shown.add_row(Text(row.case), Text(row.expected), Text(row.got), verdict)
    return shown
