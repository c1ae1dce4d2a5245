"""What the models of sensor files share: bounds of numbers, and grids of wavelengths."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

from pydantic import Field

from gpusim.config.model import wrong
from gpusim.scene.spectra import WAVELENGTHS_NM

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]


def check_grid(wavelengths_nm: Sequence[float]) -> None:
    """Refuse wavelengths that do not rise or do not reach over the grid of all spectra."""
    if any(b <= a for a, b in pairwise(wavelengths_nm)):
        raise wrong("the wavelengths do not rise", "nm, each more than the one before")
    first, last = WAVELENGTHS_NM[[0, -1]]
    if not wavelengths_nm or wavelengths_nm[0] > first or wavelengths_nm[-1] < last:
        raise wrong("the wavelengths end too soon", f"{first:g} to {last:g} nm, or beyond")
