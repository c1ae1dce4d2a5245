"""A plan is made anew, tighter, where its certificate misses the tolerance.

Predictions are models; a certificate is measured. As an integrator rejects a step whose error is
too large and takes a shorter one (Hairer, Norsett and Wanner, Solving Ordinary Differential
Equations I, 2nd ed., sec. II.4), a render whose certificate misses is made again by a plan for less
error, in the ratio by which the first one missed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

from gpusim.certify import Certificate
from gpusim.errors import UserError
from gpusim.plan import Accuracy
from gpusim.plan.accuracy import RANGES

SAFETY = 0.7  # of the tolerance that would just do: errors do not fall in exact proportion
TIMES = 2  # plans after the first


class Certified(Protocol):
    """A result with its certificate and notes: a frame, or light."""

    @property
    def certificate(self) -> Certificate | None:
        """Measured at probes; None where it was not asked for."""

    @property
    def notes(self) -> tuple[str, ...]:
        """How it was made, in words."""


Result = TypeVar("Result", bound=Certified)


def planned_anew(accuracy: Accuracy, attempt: Callable[[Accuracy], Result]) -> Result:
    """Return what an attempt makes, made again by tighter plans while its certificate misses.

    Where no tighter plan can be had, the last result is returned with a note that says why.

    Parameters
    ----------
    accuracy : Accuracy
        What was asked for: a certificate is about its tolerance whatever the plan.
    attempt : callable
        Makes the result for an accuracy, whose `Accuracy.aim` the plan is made for.
    """
    made = attempt(accuracy)
    for _ in range(TIMES):
        aim = tighter(accuracy, made.certificate)
        if aim is None:
            break
        accuracy = replace(accuracy, aim=aim)
        try:
            made = attempt(accuracy)
        except UserError as refusal:
            note = f"a plan for {accuracy.in_words(aim)}, that would meet the tolerance, is refused"
            return replace(made, notes=(*made.notes, f"{note}: {refusal.problem}"))
    return made


def tighter(accuracy: Accuracy, certificate: Certificate | None) -> float | None:
    """Return the tolerance to plan for next; None where no plan helps, or none was asked for.

    Best effort asks for one render, and a time for no second one.
    """
    if certificate is None or certificate.met:
        return None
    if accuracy.best_effort or accuracy.within_s is not None:
        return None
    # What the sensor's own stages err by, no plan of the optics mends.
    if certificate.sensor_rms > accuracy.tolerance:
        return None
    # A probe may err by ten times the tolerance.
    found = max(certificate.total_rms, certificate.total_worst / 10)
    aim = SAFETY * accuracy.planned.tolerance * accuracy.tolerance / found
    return max(aim, RANGES[accuracy.unit][0])
