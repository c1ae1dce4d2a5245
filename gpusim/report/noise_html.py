"""The EMVA 1288 data sheet as one HTML file: verdicts, figures with uncertainties, plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gpusim.metrics.emva import Characterisation
from gpusim.metrics.figure import Figure
from gpusim.metrics.loop import COVERAGE, Row
from gpusim.report.noise_facts import IN_THE_DARK, OF_A_CHANNEL, number, two_digits
from gpusim.report.noise_figure import draw_noise
from gpusim.report.sheet import Table
from gpusim.report.template import filled


def noise_html(found: Characterisation, rows: Sequence[Row] | None, title: str, how: str) -> str:
    """Return the data sheet as an HTML document that needs no other file.

    Parameters
    ----------
    found : Characterisation
    rows : sequence of Row, optional
        For a simulated sensor: what its file says beside what was found.
    title, how : str
        What was measured, and on which frames.
    """
    tables = [] if rows is None else [_verdicts(rows)]
    for one in found.channels:
        light = "" if one.wavelength_nm is None else f", light of {one.wavelength_nm:g} nm"
        tables.append(_table(f"Channel {one.name}{light}", one.figures, OF_A_CHANNEL))
    tables.append(_table("All pixels, in the dark", found.figures, IN_THE_DARK))
    return filled(
        "report/templates/noise.html",
        title=title,
        summary=f"{how}. EMVA 1288 R3.1; rows, columns and pixels by R4.0 Linear.",
        within=None if rows is None else [row.within for row in rows],
        coverage=COVERAGE,
        tables=tables,
        notes=found.notes,
        figure=draw_noise(found, title, how, titled=False),
    )


def _verdicts(rows: Sequence[Row]) -> Table:
    """Return parameter, data sheet, recovered, uncertainty and verdict."""
    head = ["Parameter", "Data sheet", "Expected", "Recovered", f"U (k = {COVERAGE})"]
    head += ["Unit", "Verdict", "Why another is expected"]
    cells = [
        (
            row.parameter, f"{row.data_sheet:.6g}", number(row.expected, row.uncertainty),
            number(row.recovered, row.uncertainty), two_digits(row.uncertainty), _unit(row.unit),
            ("within", "good") if row.within else ("outside", "bad"), (row.reason, "reason"),
        )
        for row in rows
    ]  # fmt: skip
    return Table("The sensor file and what was measured", head, cells, ("", *["number"] * 4))


def _table(
    title: str, figures: Mapping[str, Figure], names: Mapping[str, tuple[str, str, str]]
) -> Table:
    """Return figures with their standard uncertainties."""
    shown = [(*names[key], figures[key]) for key in names if key in figures]
    rows = [
        (name, symbol, number(one.value, one.u), two_digits(one.u), _unit(unit))
        for name, symbol, unit, one in shown
    ]
    head = ("Figure", "Symbol", "Value", "u (k = 1)", "Unit")
    return Table(title, head, rows, ("", "", "number", "number"))


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit
