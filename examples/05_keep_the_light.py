"""The light in a file: sensors, gains and temperatures are tried without the optics."""

import gpusim as gs

light = gs.expose(gs.Camera.load("mtf-only"), gs.Scene.load("colorchecker"), 1e-2, probes=16)
light.save("light.npz")
again = gs.Light.load("light.npz")
for celsius in (20, 60, 100):
    frame = again.capture(0.05, seed=1, temperature_c=celsius)
    print(celsius, "degC:", frame.electrons.mean(), "electrons")
noisier = again.sensor.model_copy(update={"temporal_dark_noise_e": 12.0})
print(again.at(sensor=noisier).capture(1 / 240, seed=1))
