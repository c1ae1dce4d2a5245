"""A chart through a lens onto a sensor: one raw file and its picture."""

import gpusim as gs

camera = gs.Camera.load("mtf-only")
light = gs.expose(camera, gs.Scene.load("colorchecker"), tolerance=1e-2, probes=16)
frame = light.capture(1 / 60, seed=7)
print(frame, frame.certificate.total_rms)
frame.save("first.dng")
frame.develop().save("first.png")
