"""All that the Ansys report measures: its parts know nothing of one another, and run at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from gpusim.validate.ansys import READINGS, Read, Reading, read
from gpusim.validate.ansys_electrons import EvenScene
from gpusim.validate.ansys_mtf import Sharpness, even_scene, sharpness
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
    edges, targets = ([partial(of, one) for one in READINGS] for of in (sharpness, read))
    found = at_once([*edges, *targets, partial(_even, READINGS[0])], progress)
    return Measured(found[len(edges) : -1], found[: len(edges)], found[-1])


def _even(reading: Reading, progress: Progress) -> EvenScene:
    progress("even scene", 0, 1)
    found = even_scene(reading)
    progress("even scene", 1, 1)
    return found
