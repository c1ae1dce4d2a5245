"""Twenty frames of one light, two exposures in turns: optics once, then milliseconds a frame."""

import gpusim as gs

light = gs.expose(gs.Camera.load("mtf-only"), gs.Scene.load("colorchecker"), 1e-2, probes=16)
burst = light.burst(20, exposure_s=[1 / 240, 1 / 60], seed=7, truth=True)
print(burst, burst.raw.shape, burst.truth_dn.shape)
noise = burst.raw[1::2].astype(float) - burst.truth_dn[1]
print("temporal and fixed noise of the long exposures:", noise.std(), "DN")
