"""Colours of a ColorChecker in a picture against those of the chart under a light.

The chart's are its measured reflectances (BabelColor's mean of 30 charts) under an illuminant, for
the CIE's observer of 1931. A picture's exposure is free: its colours are scaled so that the
luminances of the six greys fit. Differences are those of CIELAB with the illuminant's white:
Delta E of 1976, of 1994 (graphic arts) and of 2000, by colour-science.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.metrics.patches import Patches, find_patches
from gpusim.metrics.picture import Plane
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, adaptation, rgb_to_xyz
from gpusim.scene.spectra import colorchecker, illuminant, xyz

GREYS = slice(18, 24)  # white to black, the last row
WHITE_OF = slice(19, 22)  # neutral 8, 6.5 and 5: neither near saturation nor near the noise
METHODS = {"76": "CIE 1976", "94": "CIE 1994", "2000": "CIE 2000"}


@dataclass(frozen=True, eq=False)
class Colours:
    """Colours of N patches, as a picture or a matrix makes them.

    Attributes
    ----------
    xyz : ndarray (N, 3)
        On the scale on which the illuminant's white has Y = 1.
    delta_e : dict of str to ndarray (N,)
        ``76``, ``94`` and ``2000``.
    """

    xyz: np.ndarray
    delta_e: dict[str, np.ndarray]

    @property
    def xy(self) -> np.ndarray:
        """Chromaticities (N, 2)."""
        return self.xyz[:, :2] / self.xyz.sum(axis=1, keepdims=True)


@dataclass(frozen=True, eq=False)
class ColourReport:
    """What the patches say.

    Attributes
    ----------
    patches : Patches
    names : tuple of str
    light : str
        Illuminant of the chart's colours.
    white_xyz : ndarray (3,)
        Its white.
    chart_xyz : ndarray (24, 3)
    as_is : Colours or None
        The picture's own colours, linear Rec.709, adapted to the illuminant; None of a raw frame.
    white_xy : ndarray (2,) or None
        Chromaticity of the picture's greys, as Rec.709 with its white D65; None of a raw frame.
    fitted : Colours
        Through the matrix.
    matrix : ndarray (3, 3)
        From the picture's red, green and blue to XYZ, by least squares over the patches.
    """

    patches: Patches
    names: tuple[str, ...]
    light: str
    white_xyz: np.ndarray
    chart_xyz: np.ndarray
    as_is: Colours | None
    white_xy: np.ndarray | None
    fitted: Colours
    matrix: np.ndarray


def measure_colour(
    planes: dict[str, Plane], light: str = "D65", corners: np.ndarray | None = None
) -> ColourReport:
    """Measure the colours of a ColorChecker.

    Parameters
    ----------
    planes : dict of str to Plane
        Channels of a picture; red, green and blue are used.
    light : str
        Illuminant, by its name.
    corners : ndarray (4, 2), optional
        See `gpusim.metrics.patches.find_patches`.

    Raises
    ------
    UserError
        The picture has no colours, or no chart is found.
    """
    if not set("RGB") <= set(planes):
        raise UserError(
            "The picture has no red, green and blue.",
            field="PICTURE",
            value=", ".join(planes),
            allowed="a colour picture, or a raw frame with red, green and blue filters",
        )
    chart = colorchecker()
    power = illuminant(light)
    white = xyz(power)
    chart_xyz = xyz(np.stack(list(chart.values())) * power) / white[1]
    white = white / white[1]
    used = {name: planes[name] for name in "RGB"}
    patches = find_patches(used, lambda rgb: _fit(rgb, chart_xyz)[1], corners)
    matrix, _ = _fit(patches.mean, chart_xyz)
    fitted = compared(patches.mean @ matrix.T, chart_xyz, white)
    as_is = white_xy = None
    if all(plane.sites is None for plane in used.values()):
        # Rec.709 is seen under D65, the white of (1, 1, 1); the chart's light is another white.
        to_xyz = rgb_to_xyz(REC709_CHROMATICITIES)
        own = patches.mean @ to_xyz.T
        greys = own[WHITE_OF].sum(axis=0)
        white_xy = greys[:2] / greys.sum()
        own = own @ adaptation(to_xyz.sum(axis=1), white).T
        scale = own[GREYS, 1] @ chart_xyz[GREYS, 1] / (own[GREYS, 1] @ own[GREYS, 1])
        as_is = compared(scale * own, chart_xyz, white)
    return ColourReport(
        patches, tuple(chart), light, white, chart_xyz, as_is, white_xy, fitted, matrix
    )


def _fit(rgb: np.ndarray, chart_xyz: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the matrix (3, 3) from RGB to XYZ by least squares, and its root mean square miss."""
    found, *_ = np.linalg.lstsq(rgb, chart_xyz, rcond=None)
    return found.T, float(np.sqrt(np.mean((rgb @ found - chart_xyz) ** 2)))


def compared(own: np.ndarray, chart_xyz: np.ndarray, white: np.ndarray) -> Colours:
    """Return colours with their differences from a chart's.

    Parameters
    ----------
    own, chart_xyz : ndarray (N, 3)
        On the scale on which white has Y = 1.
    white : ndarray (3,)
    """
    import colour  # a second to load

    xy = white[:2] / white.sum()
    one, other = (colour.XYZ_to_Lab(each, xy) for each in (own, chart_xyz))
    # The chart is the standard: Delta E 94 weighs by its chroma.
    return Colours(
        own,
        {name: colour.delta_E(other, one, method=method) for name, method in METHODS.items()},
    )
