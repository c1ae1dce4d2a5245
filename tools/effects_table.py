"""Writes the table of a sensor's effects into docs/sensors.md, from the rows that the code runs by.

python tools/effects_table.py
"""

from __future__ import annotations

from pathlib import Path

from gpusim.sensor.effects import CCD, CMOS, EFFECTS, Effect

PAGE = Path(__file__).resolve().parents[1] / "docs" / "sensors.md"
BEGIN, END = "<!-- effects: tools/effects_table.py -->\n", "<!-- end of effects -->\n"


def _row(effect: Effect) -> str:
    kinds = [name for name, order in (("CMOS", CMOS), ("CCD", CCD)) if effect in order]
    fields = ", ".join(f"`{one}`" for one in effect.fields)
    cells = effect.name, effect.what, fields, f"`{effect.stage}`", " ".join(kinds)
    return f"| {' | '.join(cells)} |"


def table() -> str:
    """Return the table: a row for each effect, in their order."""
    head = "| effect | what it does | fields | stage | of |", "|---|---|---|---|---|"
    return "\n".join((*head, *map(_row, EFFECTS))) + "\n"


def with_table(page: str) -> str:
    """Return the page with the table between its two marks."""
    before, rest = page.split(BEGIN)
    return before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
