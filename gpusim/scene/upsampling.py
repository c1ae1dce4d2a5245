"""RGB photographs as scenes: which spectra their colours stand for.

Mallett and Yuksel's spectra are sums of three. In the other tables each colour, divided by its
largest component, lies on one of three faces of the RGB cube. Its spectrum is a mean of those of
three nodes about it there, by which linear RGB, and so XYZ, are the means too. Smits's method
(1999) is exactly that with the cube's corners; of Jakob and Hanika's (2019), which is fitted anew
to each colour, the nodes are the corners and what lies midway.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from gpusim.errors import UserError
from gpusim.scene.bands import MOST_SAMPLES
from gpusim.scene.colorimetry import REC709_CHROMATICITIES, lab, rgb_to_xyz
from gpusim.scene.raster import Raster
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import (
    WAVELENGTHS_NM,
    illuminant_known,
    rgb_known,
    rgb_nodes,
    rgb_reflectances,
    white_radiance,
    xyz,
)

MALLETT = "mallett-2019"
TABLES = {MALLETT: None, "jakob-2019": "jakob_2019", "smits-1999": "smits_1999"}
WORDS = {
    MALLETT: "Mallett and Yuksel (2019)",
    "jakob-2019": "Jakob and Hanika (2019), at 19 colours and straight between",
    "smits-1999": "Smits (1999)",
}
BAND_ROWS = 256  # that are worked out at once
SHOWN = 64  # rows and columns of a picture whose colours are compared, at most


def _daylight(
    table: str | None, white: np.ndarray, scale_cd_m2: float, wavelengths_nm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of a photograph's planes under D65, and that of its white."""
    daylight = white_radiance("D65", scale_cd_m2, wavelengths_nm)
    if table is None:
        spectra = rgb_reflectances(wavelengths_nm) * daylight
    else:
        spectra = rgb_nodes(table, wavelengths_nm)[1] * daylight
    return spectra, white @ spectra


def check_upsampling(name: str) -> str:
    """Return a name of `TABLES`; refuse another."""
    if name not in TABLES:
        raise UserError(
            "there is no such way from RGB to spectra",
            field="upsampling",
            value=name,
            allowed=", ".join(TABLES),
        )
    return name


def lit_rgb(
    name: str,
    planes: np.ndarray,
    white_rgb: np.ndarray,
    *,
    scale_cd_m2: float,
    notes: tuple[str, ...],
    upsampling: str = MALLETT,
) -> Scene:
    """Return a photograph under D65.

    Parameters
    ----------
    name : str
    planes : ndarray (3, rows, cols), float32
        Linear R, G, B of Rec. 709.
    white_rgb : ndarray (3,)
        What is white in it.
    scale_cd_m2 : float
        Luminance of RGB (1, 1, 1).
    notes : tuple of str
    upsampling : str
        Method by which its colours become spectra: a name of `TABLES`.

    Raises
    ------
    UserError
        For another name, or a picture that is too large for it.
    """
    table = TABLES[check_upsampling(upsampling)]
    shares, white = planes, np.asarray(white_rgb, np.float64)
    if table is not None:
        nodes = rgb_nodes(table)[0]
        if len(nodes) * planes[0].size > MOST_SAMPLES:
            raise UserError(
                f"the picture is too large for the {len(nodes)} spectra of {upsampling}",
                field="upsampling",
                value=f"{planes[0].size:,} pixels",
                allowed=f"{MOST_SAMPLES // len(nodes):,} pixels, or {MALLETT}",
            )
        shares = node_shares(planes, nodes)
        white = node_shares(np.maximum(white, 0.0)[:, None, None], nodes)[:, 0, 0].astype(float)

    light = partial(_daylight, table, white, scale_cd_m2)
    spectra, white_spectrum = light(WAVELENGTHS_NM)
    mean, worst = round_trip(planes, shares, spectra, scale_cd_m2)
    notes += (
        f"spectra of {WORDS[upsampling]}: under D65 the picture's colours come back within "
        f"dE*ab {mean:.2f} in the mean, {worst:.2f} at most",
    )
    given = {"light": light, "made_of": (rgb_known(table), illuminant_known("D65"))}
    return Scene(name, spectra, Raster(shares), "D65", white_spectrum, notes, **given)


def node_shares(planes: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return how much of each node's colour makes up RGB: three at most, none negative.

    Parameters
    ----------
    planes : ndarray (3, rows, cols)
        None negative.
    nodes : ndarray (N, 3)
        RGB of all points of an even grid whose largest component is 1.

    Returns
    -------
    ndarray (N, rows, cols), float32
    """
    steps = len(np.unique(nodes)) - 1
    index = {tuple(np.round(steps * node).astype(int)): n for n, node in enumerate(nodes)}
    number = np.full((steps + 1,) * 3, -1)
    for place, n in index.items():
        number[place] = n
    out = np.zeros((len(nodes), *planes.shape[1:]), np.float32)
    cols = np.arange(planes.shape[2])[None]
    for first in range(0, planes.shape[1], BAND_ROWS):
        rgb = planes[:, first : first + BAND_ROWS].astype(np.float64)
        top = rgb.max(axis=0)
        place = steps * rgb / np.maximum(top, 1e-300)
        # The largest component stays at its end: of a cell the upper side.
        low = np.minimum(np.floor(place), steps - 1).astype(int)
        part = place - low
        # From the cell's far corner towards its near one, component by component, the smallest
        # first (Kuhn's triangles): each way's share is the difference of two.
        order = np.argsort(part, axis=0, kind="stable")
        ranked = np.take_along_axis(part, order, axis=0)
        corner = low + 1
        weights = [ranked[0], ranked[1] - ranked[0], ranked[2] - ranked[1]]
        rows = np.arange(first, first + rgb.shape[1])[:, None]
        for k, weight in enumerate(weights):
            chosen = number[tuple(corner)]
            # A corner that is no node has no weight.
            weight = np.where(chosen >= 0, weight, 0.0)
            out[np.maximum(chosen, 0), rows, cols] += (weight * top).astype(np.float32)
            corner = corner.copy()
            np.put_along_axis(
                corner, order[k : k + 1], np.take_along_axis(low, order[k : k + 1], 0), 0
            )
    return out


def round_trip(
    planes: np.ndarray, shares: np.ndarray, spectra: np.ndarray, scale_cd_m2: float
) -> tuple[float, float]:
    """Return the mean and the largest dE*ab (CIE 1976) between a picture's RGB and its spectra's.

    Only some of its colours are compared, each as bright as it is beside RGB (1, 1, 1).
    """
    every = [max(1, -(-size // SHOWN)) for size in planes.shape[1:]]
    part = np.s_[:, :: every[0], :: every[1]]
    rgb, share = (one[part].reshape(len(one), -1).T.astype(float) for one in (planes, shares))
    space = rgb_to_xyz(REC709_CHROMATICITIES)
    wanted = rgb @ space.T
    found = share @ xyz(spectra) / scale_cd_m2
    off = np.hypot.reduce(lab(found, space.sum(axis=1)) - lab(wanted, space.sum(axis=1)), axis=1)
    return float(off.mean()), float(off.max())
