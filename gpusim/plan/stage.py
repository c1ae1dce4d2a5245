"""One stage in the description of a plan."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanStage:
    """One stage of the chain, or a part of its work: whether it runs, and why."""

    name: str
    runs: bool
    reason: str
    predicted_error: float | None = None
    predicted_cost_s: float | None = None
