"""How a part of the work is timed: the fastest of a few runs."""

from __future__ import annotations

from gpusim.gpu import Recording
from gpusim.plan.stage import stage_of

RUNS = 3  # in each turn, of which the fastest counts


def fastest(rec: Recording) -> dict[str, float]:
    """Return the least seconds of each stage over some runs."""
    rec.run()  # compiles, and fills the pool
    runs = [rec.run().times_s for _ in range(RUNS)]
    return {stage_of(path): min(run[path] for run in runs) for path in runs[0]}
