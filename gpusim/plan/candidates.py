"""Ways to convolve: what each would cost and how much it would err, and why all but one lost."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gpusim.errors import UserError
from gpusim.plan.blocks import Layout


@dataclass(frozen=True)
class Part:
    """One scale of a candidate.

    Attributes
    ----------
    name : str
    pitch_um : float
        Pitch of its sim grid.
    layout : Layout
    method : str
    options : mapping
        Further fields of its `Scale`.
    rank : int
        With modes: how many are expected.
    nodes : int
        With other methods: PSF nodes of which a frame takes kernels. Nodes that see no light do not
        count, nor do those whose blocks are mirror images of others.
    """

    name: str
    pitch_um: float
    layout: Layout
    method: str = "fft"
    options: Mapping[str, object] = field(default_factory=dict)
    rank: int = 0
    nodes: int = 0

    @property
    def text(self) -> str:
        """What distinguishes it from others of its scale."""
        length = self.layout.grid.length
        return {
            "fft": f"transforms of {length}",
            "modes": f"{self.rank} mode{'s' * (self.rank > 1)}, transforms of {length}",
            "direct": f"{2 * int(self.options.get('support', 0))} taps wide",
        }[self.method]


@dataclass(frozen=True)
class Candidate:
    """One way to convolve.

    Attributes
    ----------
    name : str
        In a line.
    oversampling : int
        Sim samples per pixel.
    cut_um : float or None
        Radius at which the core of the PSFs is cut from their tail.
    sigma : float
        Gaussian low-pass of the sampled scene, sim samples.
    errors, limits : mapping of str to float
        Predicted error of each knob, and what the tolerance leaves to it.
    parts : tuple of Part
        None where it was not worked out: it cannot be chosen then. Without an obstacle, and with
        errors within their limits, because one with fewer samples a pixel suffices.
    obstacle : UserError, optional
        Why there are no parts.
    """

    name: str
    oversampling: int
    cut_um: float | None
    sigma: float
    errors: Mapping[str, float]
    limits: Mapping[str, float]
    parts: tuple[Part, ...] = ()
    obstacle: UserError | None = None

    @property
    def cost_s(self) -> float | None:
        """Predicted seconds of the first frame, kernels included; None without parts."""
        return sum(part.layout.cost_s for part in self.parts) if self.parts else None

    @property
    def worst(self) -> str:
        """The knob whose error exceeds its limit most, or comes closest to it."""
        return max(self.errors, key=lambda knob: self.errors[knob] / self.limits[knob])

    @property
    def excess(self) -> float:
        """Error of the worst knob over its limit: at most 1 within the tolerance."""
        return self.errors[self.worst] / self.limits[self.worst]


@dataclass(frozen=True)
class RunnerUp:
    """A way to convolve that was not chosen, and why."""

    name: str
    predicted_error: float
    predicted_cost_s: float | None
    lost: str


def choose(candidates: Sequence[Candidate]) -> tuple[Candidate, tuple[RunnerUp, ...]]:
    """Return the cheapest candidate within the tolerance, and the others with why they lost.

    Where none is within the tolerance, that which exceeds it least: its ``excess`` is above 1.

    Raises
    ------
    UserError
        When none can be done: the first one's reason.
    """
    possible = [one for one in candidates if one.parts]
    if not possible:
        raise next(one.obstacle for one in candidates if one.obstacle)
    chosen = min(possible, key=lambda one: (max(one.excess, 1.0), one.cost_s))
    others = [one for one in candidates if one is not chosen]
    others.sort(key=lambda one: (one.obstacle is not None, one.excess > 1, one.cost_s or math.inf))
    return chosen, tuple(
        RunnerUp(one.name, max(one.errors.values()), one.cost_s, _reason(one, chosen))
        for one in others
    )


def _reason(one: Candidate, chosen: Candidate) -> str:
    if one.obstacle is not None:
        return f"does not fit: {one.obstacle.value}"
    if one.excess > max(chosen.excess, 1.0):
        error, limit = one.errors[one.worst], one.limits[one.worst]
        return f"error of its {one.worst} {error:.1e} above {limit:.1e}"
    if one.cost_s is None:
        return f"too dear: {chosen.oversampling} samples a pixel meet the tolerance"
    own, best = f"{one.cost_s:.3g} s", f"{chosen.cost_s:.3g} s"
    return f"no cheaper: {own} as well" if own == best else f"too dear: {own} against {best}"
