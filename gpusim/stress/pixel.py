"""Cases of the pixel: light that reaches others, patterns of every size, slits that move."""

from __future__ import annotations

import numpy as np

from gpusim.gpu import Recording, default_device
from gpusim.sensor.aperture import Aperture, Part
from gpusim.sensor.cfa import PATTERNS, ColourFilterArray
from gpusim.sensor.crosstalk import record_crosstalk
from gpusim.sensor.crosstalk_model import Kernels
from gpusim.sensor.load import load_sensor
from gpusim.sensor.misregistration import mixed_pattern
from gpusim.stress.table import Case


def all_of_it() -> tuple:
    """Spread a frame with kernels of 7 x 7 that give everything away, in an X-Trans pattern."""
    pattern = [list(row) for row in PATTERNS["X-Trans"]]
    cfa = ColourFilterArray(pattern=pattern)
    sensor = load_sensor("imx477").model_copy(update={"rows": 60, "cols": 66, "cfa": cfa})
    kernel = np.full((7, 7), 1 / 48)
    kernel[3, 3] = 0.0
    frame, whole = np.zeros((60, 66), np.float32), (0, 0, 60, 66)
    frame[20:40, 20:40] = 1e7
    rec = Recording(default_device())
    signal = rec.buffer("signal", frame.shape, "f4")
    rec.upload(signal, frame)
    kernels = Kernels({"*": kernel.tolist()})
    spread = record_crosstalk(rec, signal, kernels, sensor, given=whole, wanted=whole)
    label = rec.download(spread)
    found = rec.run()[label].astype(float)
    short = found.sum() / frame.astype(float).sum() - 1
    right = abs(short) < 49 * 2.0**-24 and found.min() >= 0
    return "all light is still there, none of it negative", f"{short:+.1e} of it", right


def a_pixel_aside() -> tuple:
    """Shift the filters of a Bayer pattern by a whole pixel, and by next to nothing."""
    bayer = [["R", "G"], ["G", "B"]]
    names, mixtures = mixed_pattern(bayer, (1.0, 0.0), 1.0)
    moved = [dict(mixtures[name]) for name in names[0]] == [{"G": 1.0}, {"R": 1.0}]
    _, slight = mixed_pattern(bayer, (1e-9, 0.0), 1.0)
    own = min(dict(one)[name[0]] for name, one in slight.items())
    got = f"{'as shifted' if moved else 'otherwise'}; {1 - own:.1e} of another"
    return "the pattern one column on; a billionth of another filter", got, moved and own > 1 - 2e-9


def a_slit() -> tuple:
    """Look through a slit of a thousandth of a pixel that is drawn along itself and across."""
    slit = Aperture(rectangles=[Part(x=0.4995, y=0.0, width=0.001, height=1.0)])
    sensor = load_sensor("imx477").model_copy(update={"aperture": slit, "fill_factor": slit.area})
    f = np.array([0.5, 1.0, 3.0]) / sensor.pixel_pitch_um
    zero = np.zeros(3)
    still = np.abs(sensor.response_um.spectrum(f, zero))
    moved = sensor.model_copy(update={"scan_motion_px": (1.0, 0.0)})
    across = np.abs(moved.response_um.spectrum(f, zero))
    worst = max(np.abs(still - 1).max(), np.abs(across - np.abs(np.sinc([0.5, 1.0, 3.0]))).max())
    return "contrast 1, and |sinc| where it moves a pixel", f"off by {worst:.1e}", worst < 1e-4


CASES: tuple[Case, ...] = (
    ("cross-talk of all", all_of_it, None),
    ("filters aside", a_pixel_aside, None),
    ("a moving slit", a_slit, None),
)
