"""The report of a validation: bars and sections, as HTML, Markdown and JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gpusim.report.template import filled
from gpusim.validate.bars import Bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Rows:
    """A table: names of its columns, rows of as many cells, and what columns are together called.

    ``groups`` holds (columns, name) from the left, in HTML alone.
    """

    head: Sequence[str]
    body: Sequence[Sequence[str]]
    groups: Sequence[tuple[int, str]] = ()


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a report. ``name`` is that of the figure's file, where it has one."""

    title: str
    text: str = ""
    name: str = ""
    figure: Figure | None = None
    rows: Rows | None = None


@dataclass(frozen=True, eq=False)
class Report:
    """What a validation found.

    Attributes
    ----------
    name : str
        Stem of its files.
    title, paper, text : str
        Text says who predicted what, and how it is compared.
    bars : sequence of Bar
    sections : sequence of Section
    numbers : dict
        Every number, for the JSON file.
    tracer : str
        The program that predicted.
    independent : bool
        Whether it is not ours.
    """

    name: str
    title: str
    paper: str
    text: str
    bars: Sequence[Bar]
    sections: Sequence[Section]
    numbers: dict[str, Any] = field(default_factory=dict)
    tracer: str = ""
    independent: bool = True

    def facts(self) -> dict[str, Any]:
        """Return every number of the report."""
        bars = [
            dataclasses.asdict(bar) | {"value": known(bar.value), "held": bar.held}
            for bar in self.bars
        ]
        who = {"tracer": self.tracer, "independent": self.independent}
        return {"paper": self.paper, **who, "bars": bars, **self.numbers}

    def html(self, pictures: Mapping[str, bytes]) -> str:
        """Return a page that needs no other file; ``pictures`` are PNG files by section's name."""
        verdicts = {True: ("held", "good"), False: ("NOT HELD", "bad")}
        bars = [
            (bar.name, f"{bar.value:.4g}", f"{bar.bound:.4g}", bar.unit, verdicts[bar.held])
            for bar in self.bars
        ]
        return filled(
            "validate/report.html",
            title=self.title,
            summary=self.paper,
            text=self.text,
            bars=bars,
            sections=self.sections,
            pictures=pictures,
        )

    def markdown(self, names: Mapping[str, str]) -> str:
        """Return the page as Markdown; ``names`` are the files of the figures by section's name."""
        lines = [f"# {self.title}", "", f"{self.paper}.", "", self.text, "", "## Bars", ""]
        lines += ["| what | worst | bar | unit | held |", "|---|---|---|---|---|"]
        lines += [
            f"| {bar.name} | {bar.value:.4g} | {bar.bound:.4g} | {bar.unit} | "
            f"{'yes' if bar.held else '**no**'} |"
            for bar in self.bars
        ]
        for section in self.sections:
            lines += ["", f"## {section.title}", ""]
            if section.text:
                lines += [section.text, ""]
            if section.figure is not None:
                lines += [f"![{section.title}]({names[section.name]})", ""]
            if section.rows is not None:
                head, body = section.rows.head, section.rows.body
                lines += [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
                lines += [f"| {' | '.join(row)} |" for row in body] + [""]
        return "\n".join(lines).rstrip() + "\n"


def known(value: float) -> float | None:
    """Return a number for JSON, which has none for what is no number."""
    return None if math.isnan(value) else value
