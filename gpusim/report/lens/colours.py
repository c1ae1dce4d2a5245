"""Colours of fields and of wavelengths."""

from __future__ import annotations

import numpy as np

from gpusim.report.lens_page import CURVE_FIELDS
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, encode_srgb, rgb_to_xyz
from gpusim.scene.spectra import WAVELENGTHS_NM, colour_matching

# Axis, half and full field: even in lightness, told apart by all kinds of colour vision (from
# ColorBrewer's PuOr), and none of them the colour of a wavelength that is shown. Two more for
# lenses without an axis, from its PRGn and PiYG.
PALETTE = ("#1b1f24", "#d9730d", "#6a3fa0", "#3f8a2f", "#c2348b")
FIELD_COLOURS = dict(zip(CURVE_FIELDS, PALETTE, strict=False))


def wavelength_colour(wavelength_nm: float, luminance: float = 0.2) -> tuple[float, float, float]:
    """Return the sRGB colour of a wavelength, no lighter than reads on white paper."""
    xyz = [np.interp(wavelength_nm, WAVELENGTHS_NM, curve) for curve in colour_matching()]
    to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
    linear = np.maximum(np.linalg.solve(to_xyz, xyz), 0)
    linear /= linear.max()
    return tuple(encode_srgb(linear * min(1.0, luminance / (to_xyz[1] @ linear))).tolist())
