"""Every trade-off between error and run time, in one object."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from gpusim.errors import UserError

SMALLEST, LARGEST = 1e-5, 0.1  # of relative tolerances
RANGES = {"relative": (SMALLEST, LARGEST), "sigma": (1e-3, 10.0)}
BEST_EFFORT = "; or any, with --best-effort"  # what a refusal offers
FLOAT32 = "float32 leaves more in sums over a frame"
ALLOWED = (
    "1e-5 to 0.1, relative to the local signal; or 0.001sigma to 10sigma, of the temporal noise; "
    "or as good as 0.4 s allows"
)
DEADLINE = re.compile(r"as good as (\S+?) ?(m?s) allows?")


@dataclass(frozen=True)
class Accuracy:
    """Every trade-off between error and run time.

    Attributes
    ----------
    tolerance : float
        Root mean square error of the mean signal over probe pixels, half of them on the steepest
        edges; no probe may err by more than ten times it. The engine's approximations (planes, PSF
        nodes, oversampling, cut of the PSFs) are planned from it.
    probes : int, optional
        Pixels of the certificate; 0 leaves it out. None: as many as its verdict needs, see
        `gpusim.certify.probes`.
    unit : str
        Unit of the tolerance. "relative" is relative to the local signal; "sigma" is the pixel's
        temporal noise at the exposure. An error below a tenth of a sigma is invisible in the raw.
    best_effort: bool
        Whether a tolerance that cannot be met is planned for as well as can be; else it is refused.
    within_s : float, optional
        Seconds that a first frame may take as predicted: the tolerance is then the least that they
        allow, in place of `tolerance`. `gpusim.render.deadline` finds it.
    aim : float, optional
        Tolerance that plans are made for, where that is less than `tolerance`: those for
        `tolerance` itself missed it. See `gpusim.render.anew`.
    """

    tolerance: float = 1e-3
    probes: int | None = None
    unit: str = "relative"
    best_effort: bool = False
    within_s: float | None = None
    aim: float | None = None

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.unit not in RANGES:
            raise UserError(
                "There is no such unit of tolerances.",
                field="tolerance",
                value=self.unit,
                allowed=", ".join(RANGES),
            )
        low, high = RANGES[self.unit]
        if not low <= self.tolerance <= high:
            raise UserError(
                "The tolerance is out of range.",
                field="tolerance",
                value=self.text,
                allowed=ALLOWED,
            )
        if self.within_s is not None and not 0 < self.within_s < math.inf:
            raise UserError(
                "The time is none that work can take.",
                field="tolerance",
                value=self.text,
                allowed="seconds above 0",
            )
        if self.probes is not None and self.probes < 0:
            raise UserError(
                "Too few probes.", field="certify", value=self.probes, allowed="0 or more"
            )

    @classmethod
    def parse(cls, text: str, probes: int | None = None, *, best_effort: bool = False) -> Accuracy:
        """Return what a tolerance in words asks for.

        ``1e-3``; ``0.1sigma``; or ``as good as 0.4 s allows``.

        Raises
        ------
        UserError
            Not a number, or out of range.
        """
        number = text.strip().removesuffix("sigma")
        unit = "relative" if number == text.strip() else "sigma"
        deadline = DEADLINE.fullmatch(text.strip())
        try:
            if deadline is not None:
                within_s = float(deadline[1]) * (1e-3 if deadline[2] == "ms" else 1.0)
                return cls(LARGEST, probes, best_effort=best_effort, within_s=within_s)
            tolerance = float(number)
        except ValueError:
            raise UserError(
                "The tolerance is no number.", field="tolerance", value=text, allowed=ALLOWED
            ) from None
        return cls(tolerance, probes, unit, best_effort)

    @property
    def certified(self) -> bool:
        """Whether a certificate is asked for."""
        return self.probes != 0

    @property
    def planned(self) -> Accuracy:
        """What plans are made for."""
        return self if self.aim is None else replace(self, tolerance=self.aim, aim=None)

    @property
    def text(self) -> str:
        """The tolerance in words: 0.001, 0.1 sigma, or as good as 0.4 s allows."""
        if self.within_s is not None:
            return f"as good as {self.within_s:g} s allows"
        return self.in_words(self.tolerance)

    def in_words(self, tolerance: float) -> str:
        """Return another tolerance of the same unit in words."""
        return f"{tolerance:g}" + (" sigma" if self.unit == "sigma" else "")

    def relative(self, brightest_e: float, dark_noise_e: float, full_well_e: float) -> Accuracy:
        """Return a relative accuracy that meets this one at every signal up to the brightest.

        The noise of a signal of S electrons is sigma = sqrt(S + sigma_d^2) (EMVA 1288, without what
        only adds to it). An error r S is k sigma where r = k sigma / S, which falls as S rises: the
        brightest signal asks for the least r. Beyond the full well nothing is seen.

        Parameters
        ----------
        brightest_e : float
            Largest mean signal of the frame, electrons.
        dark_noise_e, full_well_e : float
            Figures of the sensor, electrons.

        Raises
        ------
        UserError
            When that is less than the engine's approximations can be planned for, and no best
            effort is asked for: then it is the least that they can be planned for.
        """
        if self.unit == "relative":
            return self
        unit = self.share(brightest_e, dark_noise_e, full_well_e)
        tolerance = min(self.tolerance * unit, LARGEST)
        if tolerance < SMALLEST:
            if not self.best_effort:
                raise UserError(
                    f"The tolerance cannot be met: at {min(brightest_e, full_well_e):.3g} "
                    f"electrons it is {tolerance:.1e} of the signal, and {FLOAT32}.",
                    field="tolerance",
                    value=self.text,
                    allowed=f"{rounded_up(SMALLEST / unit):g}sigma or more at this exposure"
                    f"{BEST_EFFORT}",
                )
            tolerance = SMALLEST
        return replace(self, tolerance=tolerance, unit="relative")

    def share(self, brightest_e: float, dark_noise_e: float, full_well_e: float) -> float:
        """Return the share of the brightest signal that one unit of the tolerance is.

        1 of a relative one; of one in sigmas, sigma over the signal: infinite where there is none.
        """
        signal = min(brightest_e, full_well_e)
        if self.unit == "relative":
            return 1.0
        return math.sqrt(signal + dark_noise_e**2) / signal if signal > 0 else math.inf


def rounded_up(tolerance: float) -> float:
    """Return a tolerance in two digits, none smaller: what is named can be asked for."""
    step = 10.0 ** (math.floor(math.log10(tolerance)) - 1)
    # A part in 1e9: what is written in two digits remains itself.
    return float(f"{math.ceil(tolerance / step * (1 - 1e-9)) * step:.1e}")
