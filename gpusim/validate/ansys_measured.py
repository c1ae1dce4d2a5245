"""All that the Ansys report measures: its parts know nothing of one another, and run at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from gpusim.validate.ansys import READINGS, Read, Reading, read
from gpusim.validate.ansys_electrons import EvenScene
from gpusim.validate.ansys_mtf import Sharpness, even_scene, sharpness, through_focus
from gpusim.validate.at_once import Progress, at_once


@dataclass(frozen=True, eq=False)
class Measured:
    """What was measured: targets and edges by reading, and the even scene."""

    targets: list[Read]
    edges: list[Sharpness]
    even: EvenScene


def measured(progress: Progress = lambda what, done, total: None) -> Measured:
    """Measure all of it.

    Parameters
    ----------
    progress : callable
        Called with (what, done, total).
    """
    of_each, count = (through_focus, sharpness, read), len(READINGS)
    parts = [partial(of, one) for of in of_each for one in READINGS]
    even, *found = at_once([partial(_even, READINGS[0]), *parts], progress)
    focus, edges, targets = (found[first : first + count] for first in range(0, 3 * count, count))
    sharp = [one.with_focus(*own) for one, own in zip(edges, focus, strict=True)]
    return Measured(targets, sharp, even)


def _even(reading: Reading, progress: Progress) -> EvenScene:
    progress("even scene", 0, 1)
    found = even_scene(reading)
    progress("even scene", 1, 1)
    return found
