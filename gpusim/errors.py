"""The one error that is a user's mistake: a clear screen, never a traceback."""

from __future__ import annotations

from pathlib import Path


class UserError(Exception):
    """A mistake in what the user gave: says which file, field and value, and what is allowed.

    Parameters
    ----------
    problem : str
        One sentence that says what is wrong.
    file : path, optional
        The file in which the mistake lies.
    field : str, optional
        The field, option or key, dotted where nested (``adc.bit_depth``).
    value : object, optional
        The value that was found.
    allowed : str, optional
        What would have been accepted.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | Path | None = None,
        field: str | None = None,
        value: object = None,
        allowed: str | None = None,
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.file = None if file is None else Path(file)
        self.field = field
        self.value = value
        self.allowed = allowed

    def screen(self) -> str:
        """Return the whole message, one labelled line for each thing known."""
        rows = [self.problem]
        for label in ("file", "field", "value", "allowed"):
            content = getattr(self, label)
            if content is not None:
                rows.append(f"  {label + ':':9}{content}")
        return "\n".join(rows)

    __str__ = screen
