"""What the command line shows: the error screen, the progress bar, the table of a capture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from gpusim.certify.budget import WORST_TO_RMS
from gpusim.errors import UserError
from gpusim.gpu import compiling
from gpusim.plan.stages import RIM
from gpusim.report.words import (
    duration,
    error,
    is_whole,
    mebibytes,
    saturated,
    sigmas,
    tolerance,
)

RUNNERS_UP_SHOWN = 3  # the report has all


def show_error(mistake: UserError) -> None:
    """Print the error's screen on stderr; long paths are not broken, so that they can be copied."""
    screen = Text("error: ", style="bold red") + Text(mistake.screen(), style="default")
    Console(stderr=True).print(screen, soft_wrap=True)


def show_warning(text: str) -> None:
    """Print a warning on stderr."""
    shown = Text("warning: ", style="bold yellow") + Text(text, style="default")
    Console(stderr=True).print(shown, soft_wrap=True)


@contextmanager
def progress_bar(shown: bool = True) -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on stderr for each phase of the work; yield ``progress(phase, done, total)``.

    Compiling is a phase of its own, whichever phase it falls in.
    """
    columns = (
        TextColumn("{task.description:16}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not (shown and console.is_terminal)
    ) as bars:
        tasks: dict[str, Any] = {}

        def progress(phase: str, done: int, total: int) -> None:
            if phase not in tasks:
                tasks[phase] = bars.add_task(phase, total=total)
            bars.update(tasks[phase], completed=done, total=total)

        with compiling(lambda done, total: progress("compile", done, total)):
            yield progress


def show_capture(facts: Mapping[str, Any], folder: Path, console: Console | None = None) -> None:
    """Print adapter, stages, certificate and files of a capture on stdout.

    Parameters
    ----------
    facts : mapping
        What :func:`gpusim.report.facts` returned.
    folder : Path
        Where the files lie.
    console : Console, optional
        Where to print instead.
    """
    console = console or Console()
    device, certificate = facts["device"], facts["certificate"]
    console.print(f"{device['adapter']}, {device['driver']}, {device['backend']}", markup=False)
    console.print(stages(facts))
    plan = facts["plan"]
    for stage in plan["stages"]:
        if stage["name"] == RIM and stage["runs"]:
            text = f"warning: {stage['reason']}"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
    for one in facts["wavelengths"]["no_data"]:
        console.print(f"warning: {one['text']}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"convolved by {plan['name']}", markup=False, highlight=False)
    if plan["shortfall"]:
        text = f"best effort: {plan['shortfall']}"
        console.print(text, markup=False, highlight=False, soft_wrap=True)
    for other in plan["runners_up"][:RUNNERS_UP_SHOWN]:
        console.print(f"  not {other['name']}: {other['lost']}", markup=False, highlight=False)
    if certificate is None:
        console.print("certificate: none, no probes were asked for")
    else:
        met = "within" if certificate["met"] else "BEYOND"
        rms, worst = (
            f"{error(certificate[f'{which}_relative'])} of the local signal "
            f"({sigmas(certificate[f'{which}_sigma'])} of the noise)"
            for which in ("rms", "worst")
        )
        say = sigmas if certificate["unit"] == "sigma" else error
        row, col = certificate["worst_position"]
        for line in (
            f"certificate: {met} the tolerance of {tolerance(facts['capture'])}",
            *_missed(certificate, facts["capture"]["tolerance"], say),
            f"total RMS {say(certificate['total_rms'])}, worst {say(certificate['total_worst'])}: "
            f"engine {say(certificate['engine_rms'])}, bank {say(certificate['bank_rms'])}, "
            f"sensor {say(certificate['sensor_rms'])}, window {say(certificate['window'])}",
            f"engine's RMS error {rms}",
            f"worst of {certificate['probes']} probes {worst}",
            f"at row {row}, column {col}. {certificate['confidence']}",
        ):
            console.print(line, markup=False, highlight=False, soft_wrap=True)
    console.print(saturated(facts), markup=False, highlight=False)
    for name in facts["files"]:
        console.print(str(folder / name), markup=False, highlight=False, soft_wrap=True)


def _missed(
    certificate: Mapping[str, Any], allowed: float, say: Callable[[float], str]
) -> Iterator[str]:
    """Yield what a certificate does not meet, and by how much."""
    limits = {"RMS": ("total_rms", 1.0), "worst probe": ("total_worst", WORST_TO_RMS)}
    for name, (key, factor) in limits.items():
        found, limit = certificate[key], factor * allowed
        if found > limit:
            yield (
                f"not met: total {name} {say(found)}, allowed {say(limit)}: "
                f"{say(found - limit)} too much, {found / limit:.2g} times what is allowed"
            )


def stages(facts: Mapping[str, Any]) -> Table:
    """Return each stage: predicted error, predicted and measured time, and why it runs or not."""
    planned = "planned" if is_whole(facts) else "planned, frame"
    columns = ("stage", "error", planned, "time", "")
    table = Table(*columns, box=None, header_style="bold", pad_edge=False)
    for column in table.columns[1:4]:
        column.justify = "right"
    for name, seconds in facts["prepare_s"].items():
        table.add_row(f"prepare: {name}", "", "", duration(seconds))
    for stage in facts["plan"]["stages"]:
        table.add_row(
            stage["name"],
            error(stage["predicted_error"]) if stage["runs"] else "",
            duration(stage["predicted_cost_s"]) if stage["runs"] else "",
            duration(facts["times_s"].get(stage["name"])) if stage["runs"] else "left out",
            Text(stage["reason"]),
            style="" if stage["runs"] else "dim",
        )
    planned, seconds = facts["plan"]["predicted_s"], facts["capture"]["wall_s"]
    table.add_row("render", "", duration(planned), duration(seconds), "wall clock", style="bold")
    if "kernels" in facts["times_s"]:
        seconds = duration(facts["times_s"]["kernels"])
        table.add_row("kernels", "", "", seconds, "made tile by tile")
    if facts["certificate"] is not None:
        table.add_row("certificate", "", "", duration(facts["certificate"]["seconds"]), "apart")
    memory = facts["memory"]
    budget = f"of the GPU at most, of a budget of {mebibytes(memory['budget_bytes'])}"
    table.add_row("memory", "", "", mebibytes(memory["peak_bytes"]), budget)
    return table


def texts(rows: Sequence[tuple[str, str]]) -> Table:
    """Return a table of names and texts."""
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, text in rows:
        table.add_row(name, Text(text))
    return table
