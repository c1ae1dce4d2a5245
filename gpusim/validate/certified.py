"""Renderers that certify their first frame, and make others by the same plan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from gpusim.plan import Accuracy
from gpusim.render import Capture, Renderer
from gpusim.render.anew import planned_anew


def certified(
    accuracy: Accuracy,
    make: Callable[[Accuracy], Renderer],
    take: Callable[[Renderer], Capture],
) -> tuple[Renderer, Capture]:
    """Return a renderer and its first frame, planned anew while that misses the tolerance.

    The renderer's further frames have no certificate.

    Parameters
    ----------
    accuracy : Accuracy
    make : callable
        Makes the renderer for an accuracy.
    take : callable
        Takes the frame.
    """
    kept: Renderer | None = None

    def attempt(asked: Accuracy) -> Capture:
        nonlocal kept
        renderer = make(asked)
        try:
            found = take(renderer)
        except BaseException:
            renderer.release()
            raise
        if kept is not None:
            kept.release()
        kept = renderer
        return found

    first = planned_anew(accuracy, attempt)
    assert kept is not None
    kept.accuracy = replace(kept.accuracy, probes=0)
    return kept, first
