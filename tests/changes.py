"""What users may get wrong in a file: its content with some values replaced."""

from __future__ import annotations

import copy
from collections.abc import Sequence

Keys = Sequence[str | int]


def changed(data: dict, *changes: tuple[Keys, object]) -> dict:
    """Return a copy of nested data with the value at each path replaced; ``...`` removes it."""
    found = copy.deepcopy(data)
    for (*parents, last), value in changes:
        place = found
        for key in parents:
            place = place[key]
        if value is ...:
            del place[last]
        else:
            place[last] = value
    return found
