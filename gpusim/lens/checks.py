"""The figures that a lens's source states, beside those that the lens has."""

from __future__ import annotations

from dataclasses import dataclass

from gpusim.lens.model import Check, LensModel
from gpusim.lens.system import first_order


@dataclass(frozen=True)
class Checked:
    """A figure of the source beside the one that was found."""

    check: Check
    found: float

    @property
    def met(self) -> bool:
        """Whether the two agree within the tolerance."""
        return abs(self.found - self.check.value) <= self.check.tolerance


def checked(prescription: LensModel) -> list[Checked]:
    """Return each figure that the source states, with the one that the lens has."""
    return [
        Checked(
            check,
            getattr(first_order(prescription, printed=check.indices == "printed"), check.quantity),
        )
        for check in prescription.checks
    ]
