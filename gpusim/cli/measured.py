"""What the commands of ``gpusim measure`` share: files, tables, places given by hand."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

import gpusim
from gpusim.cli.files import staging
from gpusim.errors import UserError
from gpusim.report.drawing import png

KINDS = ("json", "csv", "html", "png")


def deliver(
    name: str,
    path: Path,
    out: Path | None,
    facts: dict[str, Any],
    rows: Iterable[Sequence[object]],
    *,
    draw: Callable[[], Figure],
    html: Callable[[dict[str, Any], Figure], str],
    show: Callable[[dict[str, Any]], None],
    as_json: bool,
) -> None:
    """Write a measurement's files, and print it.

    Parameters
    ----------
    name : str
        Name of the files, without what follows the dot.
    path : Path
        The picture.
    out : Path, optional
        Folder.
    facts : dict
        Plain data.
    rows : iterable of sequences
        Rows of the CSV file, its titles first.
    draw, html, show : callable
        Called only where they are needed.
    as_json : bool
        Print the facts.
    """
    facts = {
        "gpusim": gpusim.__version__,
        "command": ["gpusim", *sys.argv[1:]],
        "picture": path.name,
        **facts,
    }
    text = json.dumps(facts, indent=1, allow_nan=False)
    if out is not None:
        with staging(out) as folder:
            (folder / f"{name}.json").write_text(text + "\n")
            with (folder / f"{name}.csv").open("w", newline="") as opened:
                csv.writer(opened).writerows(rows)
            drawn = draw()
            (folder / f"{name}.png").write_bytes(png(drawn))
            (folder / f"{name}.html").write_text(html(facts, drawn))
    if as_json:
        print(text)
        return
    show(facts)
    for kind in KINDS if out is not None else ():
        Console().print(str(out / f"{name}.{kind}"), markup=False, highlight=False, soft_wrap=True)


def print_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table; all but the first column stand to the right."""
    table = Table(box=None, pad_edge=False)
    for number, name in enumerate(head):
        table.add_column(name, justify="right" if number else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def say(text: str) -> None:
    """Print a line as it is."""
    Console().print(text, markup=False, highlight=False, soft_wrap=True)


def numbers(text: str, count: int, option: str, what: str) -> tuple[float, ...]:
    """Return the numbers of a text such as ``320,240``.

    Raises
    ------
    UserError
        There are more or fewer, or one is no number.
    """
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        raise UserError("The numbers cannot be read.", field=option, value=text, allowed=what)
    return found
