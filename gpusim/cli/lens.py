"""``gpusim lens``."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from gpusim.cli.files import whole_file
from gpusim.cli.screen import progress_bar, texts
from gpusim.errors import UserError
from gpusim.lens.account import Account
from gpusim.lens.bank import cached_bank
from gpusim.lens.prescription import Prescription, load_prescription, presets
from gpusim.lens.sampling import window
from gpusim.lens.system import Checked, System, build, checked, first_order
from gpusim.report.lens_facts import checks_table, first_order_facts, identity, lens_facts

KINDS = (".nc", ".png", ".html")


def run(
    name: str | None,
    focal_length_mm: float | None,
    f_number: float | None,
    focus_shift_um: float | None,
    out: Path | None,
) -> None:
    """Show the data of a lens; write its bank or its page where `out` asks for them.

    Without a name, list the lenses that come with the package. Where a figure that the source
    states is not met, the exit code is 1, after everything was shown and written.
    """
    if name is None:
        if any(one is not None for one in (focal_length_mm, f_number, focus_shift_um, out)):
            raise UserError(
                "the options need a lens", field="LENS", allowed=", ".join(presets()) + ", a file"
            )
        Console().print(library())
        return
    lens = load_prescription(name)
    # The source's figures hold for the lens as published.
    checks = checked(lens)
    account = Account() if name in presets() else lens.account
    if focal_length_mm is not None:
        lens = lens.scaled(focal_length_mm)
    if f_number is not None:
        lens = lens.stopped(f_number)
    if focus_shift_um is not None:
        lens = lens.defocused(focus_shift_um)
    with ExitStack() as stack:
        file = None if out is None else stack.enter_context(whole_file(out, KINDS))
        system = build(lens)
        with progress_bar() as progress:
            if system.geometry.moved.any() and (file is None or file.suffix.lower() == ".nc"):
                # Without an axis there is no curve against field: first order, and the bank.
                facts = first_order_facts(system)
                if file is not None:
                    write_plane_bank(lens, file, progress)
            else:
                facts = work(lens, system, checks, file, progress)
    console = Console()
    console.print(texts([*identity(system.prescription), *facts]))
    show_account(console, account)
    show_checks(console, checks)
    if out is not None:
        print(out)
    if not all(one.met for one in checks):
        sys.exit(1)


def work(
    lens: Prescription,
    system: System,
    checks: list[Checked],
    file: Path | None,
    progress: Callable[[str, int, int], None],
) -> list[tuple[str, str]]:
    """Compute the bank of a lens, write what `file` asks for, and return the data to show."""
    bank = cached_bank(
        lens, progress=lambda done, all_: progress("PSF bank", done, all_), **window(system)
    )
    kind = None if file is None else file.suffix.lower()
    if kind == ".nc":
        bank.save(file)
    elif kind is not None:
        from gpusim.report.lens_figure import png
        from gpusim.report.lens_html import lens_html
        from gpusim.report.lens_page import lens_page

        page = lens_page(bank, system, lambda done, all_: progress("page", done, all_))
        if kind == ".png":
            file.write_bytes(png(page))
        else:
            file.write_text(lens_html(page, checks, lens.account), encoding="utf-8")
    return lens_facts(bank, system)


def write_plane_bank(
    lens: Prescription, file: Path, progress: Callable[[str, int, int], None]
) -> None:
    """Write the bank of a lens with moved elements, over both directions of the field."""
    from gpusim.lens.plane_bank import compute_plane_bank

    compute_plane_bank(lens, progress=lambda done, all_: progress("PSF bank", done, all_)).save(
        file
    )


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


def show_account(console: Console, account: Account) -> None:
    """Print what became of each thing that a lens file states."""
    if not account.rows:
        return
    table = Table("surface", "", "what", box=None, header_style="bold")
    styles = {"read": "", "ignored": "dim", "substituted": "yellow"}
    for row in account.rows:
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
