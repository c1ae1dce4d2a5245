"""A measurement as one HTML file: a figure and tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from gpusim.report.template import filled


@dataclass(frozen=True)
class Table:
    """A table with a title above.

    Attributes
    ----------
    title : str
    head : sequence of str
    rows : sequence of sequences
        Texts; numbers, shown with five digits to the right; pairs of a text and its class.
    styles : sequence of str
        Classes of the columns from the left, where they are not all plain: ``number`` stands right.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str | float | tuple[str, str]]]
    styles: Sequence[str] = ()


def sheet(title: str, summary: str, drawn: Figure, shows: str, *tables: Table) -> str:
    """Return the document, which needs no other file.

    Parameters
    ----------
    title, summary : str
    drawn : matplotlib.figure.Figure
    shows : str
        What the figure shows, for those who cannot see it.
    *tables : Table
    """
    values = {"title": title, "summary": summary, "figure": drawn, "shows": shows}
    return filled("report/templates/sheet.html", **values, tables=tables)
