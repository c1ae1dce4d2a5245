"""A published lens, scaled and stopped down: its layout, PSF and MTF, and a camera of it."""

import gpusim as gs

lens = gs.Lens.load("double-gauss").scaled(12.0).stopped(4.0)
print(lens.history)
print(lens.mtf(field=0.7).at(60.0))  # tangential and sagittal contrast at 60 cycles/mm
lens.layout().plot().savefig("layout.png")
lens.psf(field=0.7, wavelength_nm=550).plot().savefig("psf.png")
lens.mtf(field=0.7).plot().savefig("mtf.png")
print(gs.Camera(lens, gs.Sensor.load("imx477").roi(480, 640)).title)
