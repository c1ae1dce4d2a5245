"""Error against run time: plans around the chosen one, each rendered, timed and certified."""

from gpusim.pareto.sweep import Point, Sweep, sweep
from gpusim.pareto.variants import CHOSEN, Variant, variants

__all__ = ["CHOSEN", "Point", "Sweep", "Variant", "sweep", "variants"]
