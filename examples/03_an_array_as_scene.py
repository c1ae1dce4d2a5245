"""A NumPy array as a photograph: linear Rec. 709, its white at 500 cd/m^2."""

import numpy as np

import gpusim as gs

rows, cols = np.mgrid[0:1:240j, 0:1:320j]
rgb = np.stack([cols, rows, 0.5 + 0.4 * np.sin(40 * cols * rows)], axis=-1)
camera = gs.Camera.load("mtf-only")
light = gs.expose(camera, gs.Scene.from_rgb(rgb, white_cd_m2=500), tolerance=1e-2, probes=16)
light.capture(seed=1).save("array.png")
