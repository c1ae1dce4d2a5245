"""``gpusim lens``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gpusim.cli.files import whole_file
from gpusim.cli.lens_plots import (
    Setting,
    Wanted,
    no_surfaces,
    places,
    second,
    studied,
    write_plots,
)
from gpusim.cli.screen import progress_bar, texts
from gpusim.errors import UserError
from gpusim.formats.lens_file import load_prescription, presets
from gpusim.formats.ready import ReadyLens, is_ready, load_ready
from gpusim.lens.checks import Checked, checked
from gpusim.lens.import_log import ImportLog
from gpusim.lens.model_glass import state_model_glasses
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import System, build, first_order
from gpusim.psf.compute import cached_bank
from gpusim.psf.compute_plane import cached_plane_bank
from gpusim.psf.plane_bank import PlaneBank
from gpusim.report.lens_facts import (
    checks_table,
    first_order_facts,
    identity,
    lens_facts,
    plane_facts,
    ready_facts,
    ready_identity,
)

if TYPE_CHECKING:
    from gpusim.report.lens.study import Study

KINDS = (".nc", ".png", ".html")


def run(name: str | None, setting: Setting, out: Path | None, wanted: Wanted) -> None:
    """Show the data of a lens; write its bank, its page and its figures where they are asked for.

    Without a name, list the lenses that come with the package. Where a figure that the source
    states is not met, the exit code is 1, after everything was shown and written.
    """
    if name is None:
        if setting.given or wanted.given or out is not None:
            raise UserError(
                "the options need a lens", field="LENS", allowed=", ".join(presets()) + ", a file"
            )
        Console().print(library())
        return
    if is_ready(name):
        for option, value in (setting.given | wanted.given).items():
            raise no_surfaces(name, option, value)
        show_ready(name, out)
        return
    wanted.check()
    other = None if wanted.beside is None else second(wanted.beside, name, setting)
    lens = load_prescription(name)
    # The source's figures hold for the lens as published.
    checks = checked(lens)
    # What is said of a lens of the package's own is of what comes now.
    import_log = lens.import_log if name not in presets() else ImportLog()
    said = len(lens.import_log.rows)
    if setting.nearest_glasses:
        lens = lens.with_nearest_glasses()
    else:
        state_model_glasses(lens)
    if import_log is not lens.import_log:
        import_log.rows += lens.import_log.rows[said:]
    lens = setting.of(lens)
    with ExitStack() as stack:
        file = None if out is None else stack.enter_context(whole_file(out, KINDS))
        at = stack.enter_context(places(wanted))
        system = build(lens)
        with progress_bar() as progress:
            studies = (
                studied(lens, name, setting, other, wanted) if wanted.files or wanted.page else []
            )
            write_plots(studies, at, progress)
            job = Job(lens, system, checks, import_log, file, studies, wanted.frequency, progress)
            # Without an axis there is no curve against field.
            facts = plane_work(job) if system.geometry.moved.any() else work(job)
    console = Console()
    console.print(texts([*identity(system.prescription), *facts]))
    show_import_log(console, import_log)
    show_checks(console, checks)
    for written in (wanted.figures, wanted.csv, wanted.json, out):
        if written is not None:
            print(written)
    if not all(one.met for one in checks):
        sys.exit(1)


@dataclass(frozen=True)
class Job:
    """What is to be done for a lens that is traced: ``file`` says what is to be written."""

    lens: Prescription
    system: System
    checks: list[Checked]
    import_log: ImportLog
    file: Path | None
    studies: list[Study]
    frequency: float | None
    progress: Callable[[str, int, int], None]


def work(job: Job) -> list[tuple[str, str]]:
    """Compute the bank of a lens, write what is asked for, and return the data to show."""
    bank = cached_bank(job.lens, progress=lambda done, all_: job.progress("PSF bank", done, all_))
    kind = None if job.file is None else job.file.suffix.lower()
    if kind == ".nc":
        bank.save(job.file)
    elif kind is not None:
        from gpusim.report.drawing import png
        from gpusim.report.lens.sheet import draw
        from gpusim.report.lens_html import lens_html
        from gpusim.report.lens_page import lens_page

        page = lens_page(
            bank,
            job.system,
            lambda done, all_: job.progress("page", done, all_),
            frequency=job.frequency,
        )
        if kind == ".png":
            job.file.write_bytes(png(draw(page)))
        else:
            text = lens_html(page, job.checks, job.lens.import_log, job.studies)
            job.file.write_text(text, encoding="utf-8")
    return lens_facts(bank, job.system)


def plane_work(job: Job) -> list[tuple[str, str]]:
    """Do what ``work`` does for a lens with moved elements, over both directions of the field.

    The bank takes a while: without a file to write, first-order data are all that is shown.
    """
    if job.file is None:
        return first_order_facts(job.system)
    bank = cached_plane_bank(
        job.lens, progress=lambda done, all_: job.progress("PSF bank", done, all_)
    )
    write_plane(bank, job.system, job.import_log, job.file, job.studies)
    return plane_facts(bank, job.system)


def write_plane(
    bank: PlaneBank,
    system: System | None,
    import_log: ImportLog,
    file: Path,
    studies: Sequence[Study] = (),
) -> None:
    """Write a bank over both directions of the field, or its page."""
    if file.suffix.lower() == ".nc":
        bank.save(file)
        return
    from gpusim.report.plane_page import plane_page

    page = plane_page(bank, system)
    if file.suffix.lower() == ".png":
        from gpusim.report.drawing import png
        from gpusim.report.plane_figure import draw_plane

        file.write_bytes(png(draw_plane(page)))
    else:
        from gpusim.report.lens_html import plane_html

        file.write_text(plane_html(page, import_log, studies), encoding="utf-8")


def show_ready(name: str, out: Path | None) -> None:
    """Show what a ready-made lens holds; write its bank or its page where `out` asks for them."""
    console = Console()
    with ExitStack() as stack:
        file = None if out is None else stack.enter_context(whole_file(out, KINDS))
        lens = load_ready(name)
        bank = lens.bank()
        if isinstance(bank, PlaneBank):
            facts = [("lens", bank.provenance["title"]), *plane_facts(bank, None)]
            if file is not None:
                write_plane(bank, None, ImportLog(), file)
        else:
            facts = [*ready_identity(lens), *ready_facts(bank)]
            if file is not None:
                write_ready(lens, file)
    console.print(texts(facts))
    if out is not None:
        print(out)


def write_ready(lens: ReadyLens, file: Path) -> None:
    """Write the bank of a ready-made lens, or its page."""
    from gpusim.report.drawing import png
    from gpusim.report.lens.sheet import draw_ready
    from gpusim.report.lens_html import ready_html
    from gpusim.report.lens_page import ready_page

    if file.suffix.lower() == ".nc":
        lens.bank().save(file)
        return
    page = ready_page(lens.bank())
    if file.suffix.lower() == ".png":
        file.write_bytes(png(draw_ready(page)))
    else:
        file.write_text(ready_html(page, lens), encoding="utf-8")


def library() -> Table:
    """Return the lenses that come with the package."""
    table = Table("lens", "f", "", "full field", "title", box=None, header_style="bold")
    for name in presets():
        lens = load_prescription(name)
        order = first_order(lens)
        table.add_row(
            name,
            f"{order.efl_mm:.4g} mm",
            f"f/{order.f_number:.3g}",
            f"{2 * lens.max_field_deg:.3g}\N{DEGREE SIGN}",
            Text(lens.title),
        )
    return table


def show_import_log(console: Console, import_log: ImportLog) -> None:
    """Print what became of each thing that a lens file states."""
    if not import_log.rows:
        return
    table = Table("surface", "", "what", box=None, header_style="bold")
    styles = {"read": "", "ignored": "dim", "substituted": "yellow"}
    for row in import_log.rows:
        table.add_row(str(row.where), Text(row.how, style=styles[row.how]), Text(row.what))
    console.print()
    console.print(table)


def show_checks(console: Console, checks: list[Checked]) -> None:
    """Print the source's figures beside those that were found, one line each."""
    console.print()
    if not checks:
        console.print("check values: the source states none, or not for a lens that was changed")
    for quantity, indices, source, found, verdict in checks_table(checks):
        style = "green" if verdict == "ok" else "bold red"
        console.print(
            Text(f"{quantity}, {indices} indices: source {source}, found {found}: ")
            + Text(verdict, style=style)
        )
