"""Error against run time: plans around the chosen one, each rendered, timed and certified."""

from gpusim.pareto.knobs import CHOSEN, Variant, variants
from gpusim.pareto.turns import Point, Sweep, sweep

__all__ = ["CHOSEN", "Point", "Sweep", "Variant", "sweep", "variants"]
