"""What the panels say of a picture: histogram, edges, PSF and MTF, time and error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpusim.errors import UserError
from gpusim.library.frame import Frame
from gpusim.metrics.picture import CLIP_SHARE, Plane
from gpusim.metrics.sfr import Sfr, measure_sfr
from gpusim.plan.stages import Plan
from gpusim.preview.engine import Shown
from gpusim.report.words import error

BINS = 96
COLOURS = {"R": (0.92, 0.33, 0.28), "G": (0.35, 0.78, 0.45), "B": (0.36, 0.58, 0.97)}
GREY = (0.8, 0.8, 0.8)


@dataclass(frozen=True, eq=False)
class Histogram:
    """The raw's histogram: root of the counts over their largest, by colour; share saturated."""

    curves: dict[str, np.ndarray]
    saturated: dict[str, float]


def histogram(frame: Frame) -> Histogram:
    """Return the histogram of a raw by colour, and which share of each colour is saturated."""
    _, counts = frame.histogram(BINS)
    most = max(float(one.max()) for one in counts.values()) or 1.0
    row, col, rows, cols = frame.areas.active
    high = frame.saturated[row : row + rows, col : col + cols]
    clipped = {}
    for letter in counts:
        own = sites(frame, letter)
        seen = np.tile(own, [-(-n // p) for n, p in zip(high.shape, own.shape, strict=True)])
        clipped[letter] = float(high[seen[:rows, :cols]].mean())
    return Histogram({name: np.sqrt(one / most) for name, one in counts.items()}, clipped)


def sites(frame: Frame, letter: str) -> np.ndarray:
    """Return which photosites of a filter pattern have a colour, from the frame's first lit one."""
    letters = np.array([list(line) for line in frame.light.sensor.cfa.letters])
    first = frame.areas.lit
    shift = -first[0] % letters.shape[0], -first[1] % letters.shape[1]
    return np.roll(letters, shift, (0, 1)) == letter


def edge(shown: Shown, roi: tuple[int, int, int, int]) -> Sfr | str:
    """Measure a slanted edge of a raw (ISO 12233), in green or the first colour.

    Parameters
    ----------
    shown : Shown
        With pixels as large as the camera's photosites.
    roi : (x, y, width, height)
        The camera's photosites.

    Returns
    -------
    Sfr or str
        Or why there is none.
    """
    if shown.step != 1:
        return "wait for the refined picture, or zoom in"
    frame = shown.frame
    row, col, rows, cols = frame.areas.active
    sensor = frame.light.sensor
    black = float(np.mean(sensor.site_black_dn))
    values = frame.raw[row : row + rows, col : col + cols].astype(np.float64) - black
    letters = {letter for line in sensor.cfa.letters for letter in line}
    letter = "G" if "G" in letters else sorted(letters)[0]
    own = sites(frame, letter) if len(letters) > 1 else None
    high = CLIP_SHARE * (sensor.raw_max_dn - black)
    box = (roi[0] - shown.rect[0], roi[1] - shown.rect[1], roi[2], roi[3])
    plane = Plane(values, own, (-np.inf, high))
    try:
        return measure_sfr(plane.values, box, sites=plane.sites, clip=plane.clip)
    except UserError as refused:
        return refused.problem


def mtf(psf: np.ndarray, pitch_um: float, pixel_um: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the MTF of a PSF (n, n) along radius and across it, at 0 to 1 cycles a pixel.

    Returns
    -------
    cycles_px : ndarray (33,)
    curves : ndarray (2, 33)
    """
    cycles = np.linspace(0, 1, 33)
    place = (np.arange(len(psf)) - len(psf) / 2) * pitch_um / pixel_um
    turn = np.exp(-2j * np.pi * np.outer(cycles, place))
    light = psf.sum() or 1.0
    return cycles, np.abs([turn @ psf.sum(axis=axis) for axis in (0, 1)]) / light


def left_out(plan: Plan) -> list[tuple[str, str]]:
    """Return the stages that a plan leaves out, and why."""
    return [(stage.name, stage.reason) for stage in plan.stages if not stage.runs]


def error_bar(shown: Shown) -> str:
    """Return how far a picture may be off, in words."""
    certificate = shown.frame.certificate
    if certificate is not None:
        verdict = "met" if certificate.met else "NOT met"
        return f"certified: total RMS {error(certificate.total_rms)}, {verdict}"
    if shown.kind == "refined":
        return f"predicted error {error(shown.predicted_error)}, for {shown.knobs.tolerance}"
    coarse = f"{shown.step} x {shown.step} photosites as one, " if shown.step > 1 else ""
    return f"draft: {coarse}predicted error {error(shown.predicted_error)} and few fields"
