"""A session: each change does again what it touches, and says what that was."""

import gpusim as gs

lens = gs.Lens.load("tessar").scaled(5.0).limited(4.0)
camera = gs.Camera(lens, gs.Sensor.load("imx477").roi(120, 160))
with gs.Session(camera, gs.Scene.load("slanted-edge"), tolerance=1e-2) as session:
    for change in ({}, {"exposure_s": 1 / 100}, {"f_number": 8.0}, {"focus_shift_um": 20.0}):
        frame = session.change(**change).frame()
        print(change, "->", session.redone, f"{frame.raw.mean():.1f} DN")
