"""The import log: what a reader made of a lens file, read, ignored or substituted, by surface.

Nothing in a file may vanish: each thing that it states has a row that says what became of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

How = Literal["read", "ignored", "substituted"]


class Row(NamedTuple):
    """One thing that a file states.

    ``where`` is the surface number in the prescription (from 1), or ``file``; ``what`` the thing in
    the file's own words, with the reason where it was not simply read.
    """

    where: int | str
    what: str
    how: How


@dataclass
class ImportLog:
    """The rows in the order in which the reader wrote them."""

    rows: list[Row] = field(default_factory=list)

    def read(self, where: int | str, what: str) -> None:
        """Add what was taken as the file states it."""
        self.rows.append(Row(where, what, "read"))

    def ignored(self, where: int | str, what: str) -> None:
        """Add what has no bearing on the optics that are modelled."""
        self.rows.append(Row(where, what, "ignored"))

    def substituted(self, where: int | str, what: str) -> None:
        """Add what was replaced: "this by that"."""
        self.rows.append(Row(where, what, "substituted"))

    def listed(self, how: How) -> list[str]:
        """Return the rows of one kind as texts: "surface 3: what" or "file: what"."""
        return [
            f"{'file' if row.where == 'file' else f'surface {row.where}'}: {row.what}"
            for row in self.rows
            if row.how == how
        ]
