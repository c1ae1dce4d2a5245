"""One case and its verdict: what is expected, what came out, and whether that is right.

What is expected comes from a closed form or from the exact model, never from the engine. A case
that no program could do, for physics or the input forbid it, and that the product declines with a
clear error is "refused", and says so. One that physics allows and the engine declines is a "limit":
it is not as expected, and counted apart. What neither holds nor is declined fails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gpusim.errors import UserError

HELD, REFUSED, LIMIT, FAILED = "held", "refused", "limit", "FAILED"
LEVEL = 1e-6  # of the tests of laws, at a fixed seed


class Engine(str):
    """Words that a refusal must have where physics allows the case and the engine does not."""


# Case, what is done, and words that a refusal must have, should it be one: None where it must hold.
# What is done returns what is expected, what came out, and whether that is right.
Case = tuple[str, Callable[[], tuple], str | None]


@dataclass(frozen=True)
class Row:
    """One case: what it is, what was expected, what came out, and the verdict."""

    case: str
    expected: str
    got: str
    verdict: str


def judged(name: str, case: Callable[[], tuple], refusal: str | None) -> Row:
    """Run one case and judge it."""
    wanted = "it holds" if refusal is None else f"refused, naming {refusal}"
    try:
        expected, got, right = case()
    except UserError as error:
        clear = refusal is not None and refusal in error.screen()
        declined = LIMIT if isinstance(refusal, Engine) else REFUSED
        return Row(name, wanted, short(error), declined if clear else FAILED)
    except Exception as error:  # a crash is what this table is to show
        return Row(name, wanted, f"{type(error).__name__}: {error}", FAILED)
    if right == REFUSED:
        return Row(name, expected, got, LIMIT if isinstance(refusal, Engine) else REFUSED)
    return Row(name, expected, got, HELD if right else FAILED)


def short(error: UserError) -> str:
    """Return an error in one line."""
    value = "" if error.value is None else f" ({error.field or 'file'}: {error.value})"
    return f"{error.problem}{value}"
