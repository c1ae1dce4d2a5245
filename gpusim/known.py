"""How far data reach: what scenes, lenses and sensors say of themselves."""

from __future__ import annotations

from typing import NamedTuple


class Known(NamedTuple):
    """Over which wavelengths something is known: what, and from where to where, nm."""

    what: str
    first_nm: float
    last_nm: float
