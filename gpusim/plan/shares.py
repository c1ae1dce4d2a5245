"""How a tolerance is shared out among the errors of the optics."""

from __future__ import annotations

# The planes' error is that of the worst spectrum in its weakest channel; the rest is well below it.
WORST_TO_RMS = 5.0
# Share of the tolerance that is left to the nodes; a photograph's contrast is larger than a
# chart's.
NODE_SHARE = 0.5
# The same of a scene of one tone, for nodes and for modes: the kernels' sums alone count, and
# neighbouring pixels err alike. It is the mean over the sensor: within 40 pixels of the rim of the
# phone lens's image circle four times as much was found.
TONE_SHARE = 0.1
# By how much the terms of a quantum efficiency that goes with the azimuth may err: share of a
# plane's light.
ANGLE_SHARE = 0.05
TAIL_SHARE = 0.4  # for the nodes of the tails, which add in the squares
ALIAS_SHARE = 0.7  # of the tolerance; with that of the nodes in the squares, all of it
MODES_SHARE = 0.5  # of the tolerance; with that of the nodes in the squares, 0.94 of it
