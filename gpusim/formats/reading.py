"""What readers of design programs' lens files share while they read: refusals, the import log."""

from __future__ import annotations

from pathlib import Path

from gpusim.errors import UserError
from gpusim.lens.import_log import ImportLog


class Reading:
    """One file being read.

    Attributes
    ----------
    file : Path
        Its name, for error texts; catalogue files are looked for beside it.
    import_log : ImportLog
        What became of each line.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self.import_log = ImportLog()

    def refuse(
        self, problem: str, where: str, value: object = None, allowed: str | None = None
    ) -> UserError:
        """Return the error that names the file, a place in it, its value and what is allowed."""
        return UserError(problem, file=self.file, field=where, value=value, allowed=allowed)

    def catalogue_beside(self, name: str) -> str | None:
        """Return the name of the file of a glass catalogue beside the lens, if there is one."""
        beside = {path.name.upper(): path.name for path in self.file.parent.glob("*.*")}
        return beside.get(f"{name}.AGF")
