"""The linearity of a channel: EMVA Standard 1288, release 3.1, section 6.7."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.figure import Figure
from gpusim.metrics.photon_transfer import LEAST_LEVELS, Transfer

LINEARITY_SHARES = (0.05, 0.95)  # of saturation, between which linearity is judged (section 6.7)


@dataclass(frozen=True)
class Linearity:
    """The straight line through the signal, and how far it is missed.

    Attributes
    ----------
    offset_dn, slope_dn : float
        The line with the least relative deviations (section 6.7, equations (35) to (37)).
    fitted : ndarray of bool (n,)
    deviation_percent : ndarray (n,)
        Equation (38).
    """

    offset_dn: float
    slope_dn: float
    fitted: np.ndarray
    deviation_percent: np.ndarray


def linearity_of(transfer: Transfer) -> Linearity:
    """Fit the line with the least relative deviations: section 6.7, equations (35) to (38).

    Raises
    ------
    UserError
        Fewer than two levels between LINEARITY_SHARES.
    """
    fitted = transfer.between(*LINEARITY_SHARES)
    x, y = transfer.photons[fitted], transfer.signal[fitted]
    if x.size < 2:
        low, high = LINEARITY_SHARES
        raise UserError(
            f"too few levels between {low:.0%} and {high:.0%} of saturation for the linearity",
            field="photons",
            value=x.size,
            allowed=f"2 or more; the standard asks for {LEAST_LEVELS} levels",
        )
    slope, offset = np.polyfit(x, y, 1, w=1 / y)
    line = offset + slope * transfer.photons
    return Linearity(float(offset), float(slope), fitted, 100 * (transfer.signal - line) / line)


def linearity_errors(straight: Linearity, transfer: Transfer) -> tuple[Figure, Figure]:
    """Return the least and the largest deviation from the line where it is judged, per cent."""
    fitted = straight.fitted
    deviation = straight.deviation_percent[fitted]
    u = 100 * np.sqrt(transfer.mean_u2[fitted]) / transfer.signal[fitted]
    least, largest = deviation.argmin(), deviation.argmax()
    return (
        Figure(float(deviation[least]), float(u[least])),
        Figure(float(deviation[largest]), float(u[largest])),
    )
