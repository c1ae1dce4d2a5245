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
    import pyarrow as pa
    from pyarrow import parquet

    rows = rows_of(outcome)
    columns = list(dict.fromkeys(name for row in rows for name in row))
    arrays = {}
    for name in columns:
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if len(kinds - {int, float}) > 0 and len(kinds) > 1:
            values = [None if value is None else str(value) for value in values]
        arrays[name] = pa.array(values)
    about = {"gpusim.sweep": outcome.sweep.model_dump_json()}
    table = pa.table(arrays).replace_schema_metadata(about)
    parquet.write_table(table, path)
