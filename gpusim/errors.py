"""The one error that is a user's mistake: a clear screen, never a traceback."""

from __future__ import annotations

from pathlib import Path

# Characters of a screen's line: paths reach 4096 (PATH_MAX of Linux), a value may be a whole file.
LONGEST, LONGEST_VALUE = 4400, 300


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

    Examples
    --------
    >>> import gpusim as gs
    >>> try:
    ...     gs.Lens.load("double-gaus")
    ... except gs.UserError as error:
    ...     error.field, "double-gauss" in error.screen()
    ('lens', True)
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
        rows = [_shown(self.problem, LONGEST)]
        for label in ("file", "field", "value", "allowed"):
            content = getattr(self, label)
            if content is not None:
                shown = _shown(content, LONGEST_VALUE if label == "value" else LONGEST)
                rows.append(f"  {label + ':':9}{shown}")
        return "\n".join(rows)

    __str__ = screen


def _shown(content: object, longest: int) -> str:
    """Return a text on one screen: shortened, and nothing in it that steers a terminal."""
    try:
        text = str(content)
    except ValueError:  # an integer of more digits than Python writes
        text = f"a number of {type(content).__name__} too long to write"
    if len(text) > longest:
        text = f"{text[:longest]} ... ({len(text)} characters)"
    return "".join(
        sign if sign.isprintable() or sign == "\n" else sign.encode("unicode_escape").decode()
        for sign in text
    )
