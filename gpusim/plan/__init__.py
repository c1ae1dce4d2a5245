"""The planner: what runs, how, and what is left out, without a device."""

from gpusim.plan.accuracy import Accuracy
from gpusim.plan.choice import plan_optics, plans_optics
from gpusim.plan.stages import Plan, PlanStage

__all__ = ["Accuracy", "Plan", "PlanStage", "plan_optics", "plans_optics"]
