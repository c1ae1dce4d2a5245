"""The plan of a render, and its text: what runs, why, and what it should cost."""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass

from gpusim.optics.highlight_plan import HighlightPlan
from gpusim.optics.nodes import Scale
from gpusim.optics.spectral_basis import Basis
from gpusim.plan.candidates import RunnerUp
from gpusim.plan.halo import HaloLevel
from gpusim.plan.stage import PlanStage, Stage
from gpusim.sensor.effects import running
from gpusim.sensor.sensor import Sensor

COLUMNS = 100  # of the plan's text
NAME = 26  # of which a stage and whether it runs take
REASON = 52  # of which a reason may take
RIM = "image circle"  # the stage that leaves black what lies beyond it


@dataclass(frozen=True)
class Plan:
    """What a render does.

    Attributes
    ----------
    basis : Basis
        The scene's spectra, reduced.
    scales : tuple of Scale
        The core of the PSFs on the sim grid; their tail, where it is cut off, on a coarse one.
    stages : tuple of PlanStage
        In the order that light takes.
    name : str
        How the convolution is done, in a line.
    predicted_s : float
        Time of one frame, everything together.
    kernels_s : float
        Time of the kernels and the highlights' light, which are made once.
    rates : str
        Whose rates the predictions are made from.
    runners_up : tuple of RunnerUp
        Other ways to convolve, and why each lost.
    halo : tuple of HaloLevel
        Levels of the bank's halo that are rendered.
    highlights : HighlightPlan or None
        How a photograph's highlights are summed; None where pixels see none.
    tolerance : float
        Tolerance that it was made for, relative to the local signal.
    shortfall : str
        Where the tolerance asked for cannot be met, and best effort was: for which one the plan was
        made instead, and why. Else empty.
    """

    basis: Basis
    scales: tuple[Scale, ...]
    stages: tuple[PlanStage, ...]
    name: str
    predicted_s: float
    kernels_s: float
    rates: str
    runners_up: tuple[RunnerUp, ...]
    tolerance: float
    shortfall: str = ""
    halo: tuple[HaloLevel, ...] = ()
    highlights: HighlightPlan | None = None

    def runs(self, name: str) -> bool:
        """Return whether a stage runs.

        Raises
        ------
        ValueError
            Where no `Stage` has that name.
        """
        name = Stage(name)
        return any(stage.runs for stage in self.stages if stage.name == name)

    def text(self) -> str:
        """Return the plan as lines of text, at most 100 columns wide."""
        lines = [f"{'':{NAME}}{'':{REASON}}{'error':>10}{'time':>11}"]
        for stage in self.stages:
            state = "run" if stage.runs else "skip"
            first = f"{state:5}{stage.name}"
            lines += _row(first, stage.reason, stage.predicted_error, stage.predicted_cost_s)
        lines += _row("", "with all dispatches", None, self.predicted_s)
        lines += _row("", "kernels and highlights, made once", None, self.kernels_s)
        lines += ["", *_row("chosen", self.name, None, None)]
        if self.shortfall:
            lines += _row("best effort", self.shortfall, None, None)
        for other in self.runners_up:
            lines += _row(
                "lost",
                f"{other.name}: {other.lost}",
                other.predicted_error,
                other.predicted_cost_s,
            )
        return "\n".join([*lines, "", f"Times from {self.rates}."])


def _row(first: str, reason: str, error: float | None, cost_s: float | None) -> list[str]:
    """Return a reason in as many lines as it needs, the numbers on the first of them."""
    lines = textwrap.wrap(reason, REASON)
    numbers = ("" if error is None else f"{error:.1e}", "" if cost_s is None else f"{cost_s:.3f} s")
    lines[0] = f"{first:{NAME}}{lines[0]:{REASON}}{numbers[0]:>10}{numbers[1]:>11}".rstrip()
    return [lines[0], *(f"{'':{NAME}}{line}" for line in lines[1:])]


def sensor_runs(sensor: Sensor, noise: bool = True) -> Callable[[str], bool]:
    """Return whether a stage of the sensor runs, by name, as ``Plan.runs`` does.

    ``noise``: with its noise and fixed patterns.
    """
    names = running(sensor, noise)

    def runs(name: str) -> bool:
        return Stage(name) in names

    return runs
