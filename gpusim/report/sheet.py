"""A measurement as one HTML file: a figure and tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from matplotlib.figure import Figure

from gpusim.report.drawing import card
from gpusim.report.page import document


def sheet(title: str, summary: str, drawn: Figure, shows: str, *tables: str) -> str:
    """Return the document, which needs no other file.

    Parameters
    ----------
    title, summary : str
    drawn : matplotlib.figure.Figure
    shows : str
        What the figure shows, for those who cannot see it.
    *tables : str
        HTML, as `table` returns it.
    """
    plots = f"<figure>{card(drawn, shows)}</figure>"
    return document(escape(title), escape(summary), plots, *tables)


def table(title: str, head: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    """Return a table as HTML; numbers stand to the right.

    Parameters
    ----------
    title : str
    head : sequence of str
    rows : iterable of sequences
        Texts; numbers, shown with five digits.
    """
    body, number = "", [False] * len(head)
    for row in rows:
        number = [not isinstance(one, str) for one in row]
        body += f"<tr>{''.join(_cell(one) for one in row)}</tr>"
    names = "".join(
        f'<th class="number">{escape(name)}</th>' if right else f"<th>{escape(name)}</th>"
        for name, right in zip(head, number, strict=True)
    )
    return (
        f'<h2>{escape(title)}</h2><div class="scroll"><table><thead><tr>{names}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f'<td class="number">{value:.5g}</td>'
