"""A slanted edge, taken and measured: the SFR of ISO 12233 with its uncertainty."""

import numpy as np

import gpusim as gs
from gpusim.metrics.sfr import measure_sfr

camera = gs.Camera.load("mtf-only")
# The square in the chart's middle has sides of a tenth of the picture's height.
light = gs.expose(camera, gs.Scene.load("slanted-edge"), 1e-2, probes=16)
frame = light.capture(noise=False)
letters = np.array([list(row) for row in frame.light.sensor.cfa.letters])
sfr = measure_sfr(frame.raw.astype(float), (326, 226, 40, 28), sites=letters == "G")
print("MTF50:", sfr.falls_to(0.5), "cycles/pixel; edge at", round(sfr.line.angle_deg, 2), "deg")
