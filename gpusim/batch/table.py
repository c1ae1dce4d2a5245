"""One table of a batch: a row a frame, as Parquet."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from gpusim.batch.run import Outcome


def rows_of(outcome: Outcome) -> list[dict[str, Any]]:
    """Return a row for each frame: its settings as ``set.NAME``, figures, files or error."""
    rows = []
    for one in sorted([*outcome.done, *outcome.failed], key=lambda one: one["number"]):
        settings = {f"set.{name}": value for name, value in one["settings"].items()}
        figures = {
            name: value
            for name, value in one.items()
            if name not in ("settings", "files", "sweep", "gpusim")
        }
        rows.append({**figures, **settings, "files": " ".join(one.get("files", ()))})
    return rows


def write_table(outcome: Outcome, path: Path) -> None:
    """Write the table to a Parquet file, its units in the columns' names."""
    write_rows(rows_of(outcome), path, {"gpusim.sweep": outcome.sweep.model_dump_json()})


def write_rows(rows: list[dict[str, Any]], path: Path, about: dict[str, str]) -> None:
    """Write rows to a Parquet file; a column of unlike values becomes text."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = list(dict.fromkeys(name for row in rows for name in row))
    arrays = {}
    for name in columns:
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if len(kinds - {int, float}) > 0 and len(kinds) > 1:
            values = [None if value is None else str(value) for value in values]
        arrays[name] = pa.array(values)
    parquet.write_table(pa.table(arrays).replace_schema_metadata(about), path)
