"""Spectral radiance by band: a sodium lamp's colour beside an even one."""

import numpy as np

import gpusim as gs

bands_nm = np.arange(400, 701, 10.0)
even = np.full(len(bands_nm), 0.004)  # W m^-2 sr^-1 nm^-1
lamp = np.where(bands_nm == 590, 0.12, 0.0)
cube = np.where(np.arange(64)[None, :, None] < 32, even, lamp) * np.ones((48, 1, 1))
light = gs.expose(
    gs.Camera.load("mtf-only"), gs.Scene.from_spectra(cube, bands_nm), 1e-2, probes=16
)
light.capture(seed=1).save("lamp.png")
