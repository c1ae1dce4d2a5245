"""Errors that are planted in the measurement of slanted edges (`gpusim.metrics.sfr`)."""

import numpy as np
from scipy.interpolate import BSpline

from gpusim.metrics import sfr


def differences(spline, places):
    """Return the basis' derivative by differences over half a pixel, uncorrected.

    It passes sinc(f / 2) of the response: at 0.5 cycles/px a tenth is lost.
    """
    at = [np.clip(places + way / 4, -spline.reach, spline.reach) for way in (1, -1)]
    basis = BSpline(spline.knots, np.eye(spline.count), sfr.DEGREE)
    return 2 * (basis(at[0]) - basis(at[1]))


def narrow(share, window=sfr._window):
    """Return a window that ends a tenth of the way out."""
    return window(10 * share)


PLANTED = ((sfr._Spline, "slopes", differences), (sfr, "_window", narrow))
