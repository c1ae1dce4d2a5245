"""Every trade-off between error and run time, in one object."""

from __future__ import annotations

from dataclasses import dataclass

from gpusim.errors import UserError


@dataclass(frozen=True)
class Accuracy:
    """Every trade-off between error and run time.

    Attributes
    ----------
    tolerance : float
        Root mean square error of the mean signal over probe pixels, half of them on the steepest
        edges, relative to the local signal; no probe may err by more than ten times it. The
        engine's approximations (planes, PSF nodes, oversampling, cut of the PSFs) are planned
        from it.
    probes : int
        Pixels of the certificate; 0 leaves it out.
    """

    tolerance: float = 1e-3
    probes: int = 64

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 1e-5 <= self.tolerance <= 0.1:
            raise UserError(
                "The tolerance is out of range.",
                field="tolerance",
                value=self.tolerance,
                allowed="1e-5 to 0.1, relative to the local signal",
            )
        if self.probes < 0:
            raise UserError(
                "Too few probes.", field="certify", value=self.probes, allowed="0 or more"
            )
