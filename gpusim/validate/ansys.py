"""The validation of the Ansys and Meta paper, section 3, with our engine and a stand-in lens.

The paper contradicts itself. Section 1.2 has 3 mm and pixels of 1.98 um, section 2.2 has 1.061 mm
and 640 x 640 pixels of 2.534 mm / 640. Both are run: the first with all pixels, 16.6 degrees to
their corners, the second with the middle 320. The paper crops its sensor too, for the image circle
does not fill it, and these hold the height of its chart, 33.5 in at 60 cm.

The second takes a circular field of 64 degrees as the half field: a lens of 1.061 mm that covers no
more than 32 degrees from its axis lights 0.66 mm of the 1.79 mm to the corner of the sensor, and a
chart 50.3 in wide reaches 47 degrees. A fisheye of that focal length has the paper's distortion,
about -6.1 % on the average over the central 40 % of the way to the corner (section 3.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from gpusim.camera import Camera
from gpusim.formats.lens_file import load_prescription
from gpusim.lens.prescription import Prescription
from gpusim.lens.system import build
from gpusim.metrics.distortion import RADII, Distortion, measure_distortion
from gpusim.metrics.picture import Plane
from gpusim.plan import Accuracy
from gpusim.render import Capture, capture
from gpusim.scene import make_scene
from gpusim.scene.patterns import Frame
from gpusim.scene.scene import Scene
from gpusim.scene.spectra import grid_nm
from gpusim.sensor.load import load_sensor
from gpusim.sensor.sensor import Sensor
from gpusim.validate.ansys_targets import LAMP, LUMINANCE_CD_M2, board, chart, drawn, sinusoid
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificate_bar, certificates_of
from gpusim.validate.predict import FIELDS
from gpusim.validate.pupils import Pupils
from gpusim.validate.spheres import SphereTracer

LENS = Path(__file__).parents[1] / "data" / "validate" / "ansys-stand-in.yaml"
OBJECT_M = 0.6  # section 2.2
BAND_NM = (400.0, 1100.0)
WHOLE_PX = 640  # along each side of the paper's whole sensor
CENTRAL = 0.4  # of the way to the corner, and of the width of the picture (section 3.2)
PERIODS_PX = (3, 4, 5)  # figure 10
EXPOSURE_S = 1 / 60
# Planned for 3e-3, board and chart missed it by a fifth and were rendered twice.
TOLERANCE, PROBES = 1.5e-3, 8
LGD_BAR, PEAK_BAR = 0.05, 0.5  # percentage points, and percent
SCATTER_BAR = 0.02  # px, RMS of single corners about the curve through all
MEAN_LGD, MEAN_BAR = -6.1, 0.2  # percent (section 3.2), and percentage points
# About the board's squares, and how far its outermost corner lies from the picture's sides: nearer
# ones than 11 px are not found, for they are sought under a weight.
SQUARE_PX, MARGIN_PX = 16, 11.0


@dataclass(frozen=True, eq=False)
class Reading:
    """One of the paper's two accounts of its camera.

    Attributes
    ----------
    name : str
    efl_mm, pitch_um : float
    pixels : int
        Along each side of the square.
    field_deg : float
        A little beyond that of the corner.
    simulated : bool
        Whether it is the one of the paper's simulation. The other cannot have the paper's mean
        distortion: 6.8 degrees from the axis, where the central part of the sensor ends at 3 mm,
        even an orthographic fisheye, r = f sin(theta), has but -theta^2 / 6 = -0.23 % on the
        average.
    """

    name: str
    efl_mm: float
    pitch_um: float
    pixels: int
    field_deg: float
    simulated: bool

    @cached_property
    def lens(self) -> Prescription:
        """The stand-in before the target."""
        return load_prescription(LENS).scaled(self.efl_mm).limited(self.field_deg).looking(OBJECT_M)

    @cached_property
    def sensor(self) -> Sensor:
        """The monochrome sensor without veiling glare."""
        own = {"rows": self.pixels, "cols": self.pixels, "pixel_pitch_um": self.pitch_um}
        return load_sensor("arvr-640").model_copy(update=own | {"veiling_glare": 0.0})

    @cached_property
    def camera(self) -> Camera:
        """Both."""
        return Camera(lens=self.lens, sensor=self.sensor, title=f"stand-in, {self.name}")


def weights(sensor: Sensor, lamp: str = LAMP) -> tuple[np.ndarray, np.ndarray]:
    """Return wavelengths (K,) and the electrons that the light makes in each, relative."""
    scene = make_scene("grey", LUMINANCE_CD_M2, lamp)
    # Renders end where the lamp's own data do: D50 at 830 nm.
    nm = grid_nm(BAND_NM[0], min(BAND_NM[1], *(one.last_nm for one in scene.known)))
    white = scene.on(nm).white
    (qe,) = sensor.qe_at(nm).values()
    ends = np.ones(nm.size)
    ends[[0, -1]] = 0.5
    return nm, white * nm * qe * ends


READINGS = (
    Reading("section 2.2: 1.061 mm, 3.96 um", 1.061, 3.959375, 320, 53.0, True),
    Reading("section 1.2: 3 mm, 1.98 um", 3.0, 1.98, 640, 17.5, False),
)


class LensData:
    """What rays through the lens's surfaces say of its distortion: no code of the engine's.

    Parameters
    ----------
    lens : Prescription
    wavelengths_nm, weights : ndarray (K,)
        Light by which the centroids of rays are averaged: the polychromatic centroid. Coma puts it
        beside the chief ray, as it does corners: by 0.3 px at 1.061 mm.
    """

    def __init__(self, lens: Prescription, wavelengths_nm: np.ndarray, weights: np.ndarray) -> None:
        self.tracer = SphereTracer(build(lens))
        self.ideal_mm = np.linspace(
            0, self.tracer.efl_mm * math.tan(math.radians(lens.max_field_deg)), 241
        )
        fields = np.arctan(self.ideal_mm / self.tracer.efl_mm)
        self.nodes_nm = np.arange(*BAND_NM, 50.0)
        share = np.interp(wavelengths_nm, self.nodes_nm, np.arange(self.nodes_nm.size))
        below = np.minimum(share.astype(int), self.nodes_nm.size - 2)
        at = [np.bincount(below, weights * (below + 1 - share), self.nodes_nm.size)]
        at.append(np.bincount(below + 1, weights * (share - below), self.nodes_nm.size))
        self.weights = np.sum(at, axis=0) / weights.sum()
        traced = np.linspace(0, fields[-1], FIELDS)
        self.heights_mm = np.stack([self._centroids_mm(traced, fields, nm) for nm in self.nodes_nm])
        self.real_mm = self.weights @ self.heights_mm

    def _centroids_mm(self, traced: np.ndarray, fields: np.ndarray, nm: float) -> np.ndarray:
        """Return where a wavelength's rays of fields land on the average, from those of a few."""
        pupils = Pupils(self.tracer, traced, nm)
        beside_um = [pupils.sent(float(field))[1] for field in traced]
        return self.tracer.chief_mm(fields, nm) + 1e-3 * CubicSpline(traced, beside_um)(fields)

    def lgd(self, real_mm: np.ndarray) -> np.ndarray:
        """Return (r_d - r_u) / r_u at heights r_d; r_u is by the magnification of the middle."""
        middle = self.real_mm[1] / self.ideal_mm[1]
        ratio = np.append(1.0, self.real_mm[1:] / self.ideal_mm[1:] / middle) - 1
        return np.interp(real_mm, self.real_mm, ratio)

    def mean_lgd(self, upto_mm: float) -> float:
        """Return the mean of LGD from the axis to a height."""
        return float(self.lgd(np.linspace(0, upto_mm, 801)).mean())

    def wave(self, places_mm: np.ndarray, period_mm: float) -> np.ndarray:
        """Return what a wave on the ideal plane looks like along the x axis, sharp but in colour.

        Parameters
        ----------
        places_mm : ndarray (N,)
        period_mm : float
            On the ideal plane.
        """
        total = np.zeros(places_mm.size)
        for weight, heights in zip(self.weights, self.heights_mm, strict=True):
            ideal = np.sign(places_mm) * np.interp(np.abs(places_mm), heights, self.ideal_mm)
            total += weight * np.cos(2 * np.pi * ideal / period_mm)
        return total


@dataclass(frozen=True, eq=False)
class Peak:
    """A sinusoid's spectrum over the central part of the middle rows.

    Attributes
    ----------
    period_px : int
        Period of the target.
    measured_cy_px, predicted_cy_px : float
        Frequencies of the peak.
    frequency_cy_px, spectrum, predicted : ndarray (F,)
        Over the largest.
    """

    period_px: int
    measured_cy_px: float
    predicted_cy_px: float
    frequency_cy_px: np.ndarray
    spectrum: np.ndarray
    predicted: np.ndarray

    @property
    def error(self) -> float:
        """Error of the peak's place, percent."""
        return 100 * (self.measured_cy_px / self.predicted_cy_px - 1)


@dataclass(frozen=True, eq=False)
class Read:
    """What one reading gave.

    Attributes
    ----------
    reading : Reading
    lens : LensData
    distortion : Distortion
    board : ndarray (rows, cols)
        The checkerboard, electrons/s.
    peaks : list of Peak
    certificates : dict of str to Certified
        By target.
    chart : ndarray (rows, cols)
        The eSFR chart, electrons/s: a picture, of which nothing is measured.
    """

    reading: Reading
    lens: LensData
    distortion: Distortion
    board: np.ndarray
    peaks: list[Peak]
    certificates: dict[str, Certified]
    chart: np.ndarray

    @property
    def radii(self) -> np.ndarray:
        """Radii at which there are corners, shares of the way to the picture's corner."""
        seen = self.distortion.radius
        return RADII[(seen.min() <= RADII) & (RADII <= seen.max())]

    @property
    def corner_mm(self) -> float:
        """Way from the middle to the corner."""
        return 1e-3 * self.distortion.corner_px * self.reading.pitch_um

    @property
    def lgd_errors(self) -> np.ndarray:
        """LGD at `radii`, measured less the lens's: percentage points."""
        own = self.distortion.fits["chosen"].lgd(self.radii)
        return 100 * (own - self.lens.lgd(self.radii * self.corner_mm))

    @property
    def mean_lgd(self) -> float:
        """Mean LGD over the central part of the paper's whole sensor, by the corners: percent."""
        share = CENTRAL * WHOLE_PX / self.reading.pixels
        return 100 * float(self.distortion.fits["chosen"].lgd(np.linspace(0, share, 801)).mean())

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        name, unit = self.reading.name, "% points"
        errors = [peak.error for peak in self.peaks]
        scatter = [self.distortion.fits["chosen"].rms_px]
        mean, off = f"mean LGD against the paper's, {name}", [self.mean_lgd - MEAN_LGD]
        return [
            Bar.largest(f"LGD at every radius, {name}", self.lgd_errors, LGD_BAR, unit),
            Bar.largest(f"scatter of corners, RMS, {name}", scatter, SCATTER_BAR, "px"),
            *([Bar.largest(mean, off, MEAN_BAR, unit)] if self.reading.simulated else []),
            Bar.largest(f"peaks of 1/3, 1/4, 1/5 cycles/px, {name}", errors, PEAK_BAR, "%"),
            certificate_bar(self.certificates, f"certificates, total, {name}"),
        ]


def rate_of(
    camera: Camera, scene: Scene, tile: tuple[int, int, int, int] | None = None
) -> tuple[Capture, np.ndarray]:
    """Return a capture of a rectangle with its certificate, and the electrons/s (rows, cols)."""
    accuracy, kept = Accuracy(TOLERANCE, PROBES), ("rate",)
    given = {"exposure_s": EXPOSURE_S, "accuracy": accuracy, "noise": False, "keep": kept}
    found = capture(camera, scene, tile=tile, **given)
    return found, found.rate


def square_mm(reading: Reading, lens: LensData) -> float:
    """Return the side of the board's squares on the ideal plane."""
    last_mm = 1e-3 * (reading.pixels / 2 - MARGIN_PX) * reading.pitch_um * math.sqrt(2)
    squares = reading.pixels // (2 * SQUARE_PX)
    return float(np.interp(last_mm, lens.real_mm, lens.ideal_mm)) / math.sqrt(2) / squares


def checkerboard(reading: Reading, lens: LensData) -> str:
    """Return the YAML of a board that covers the picture."""
    count = reading.pixels // SQUARE_PX + 2
    side = square_mm(reading, lens) / (0.5e-3 * reading.pixels * reading.pitch_um)  # half-heights
    return board(count, side)


def spectrum(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return frequencies, the modulus under a Hann window over its largest, and the peak."""
    length = 64 * values.size
    size = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size), length))
    frequency = np.fft.rfftfreq(length)
    size[frequency < 0.05] = 0  # shading
    return frequency, size / size.max(), float(frequency[np.argmax(size)])


def middle(reading: Reading) -> tuple[int, int, int, int]:
    """Return the rectangle (x, y, width, height) that sinusoids are measured in."""
    count = reading.pixels
    first, last = (round(count * (1 + way * CENTRAL) / 2) for way in (-1, 1))
    return first, count // 2 - 1, last - first, 2


def peak_of(picture: np.ndarray, reading: Reading, lens: LensData, period_px: int) -> Peak:
    """Return a sinusoid's peak in a picture of the middle, and the one of rays."""
    first, _, width, _ = middle(reading)
    row = picture.mean(axis=0)
    places = (first + np.arange(width) + 0.5 - reading.pixels / 2) * 1e-3 * reading.pitch_um
    frequency, size, at = spectrum(row)
    _, expected, predicted = spectrum(lens.wave(places, 1e-3 * period_px * reading.pitch_um))
    shown = slice(None, None, 8)
    return Peak(period_px, at, predicted, frequency[shown], size[shown], expected[shown])


def read(
    reading: Reading, progress: Callable[[str, int, int], None] = lambda what, done, total: None
) -> Read:
    """Render and measure the targets of one reading."""
    lens = LensData(reading.lens, *weights(reading.sensor))
    total, captures, peaks = 2 + len(PERIODS_PX), {}, []
    progress(reading.name, 0, total)
    frame = Frame.of(reading.sensor)
    squares = drawn(checkerboard(reading, lens), frame)
    captures["checkerboard"], rate = rate_of(reading.camera, squares)
    whole = {"W": Plane(rate.astype(float), None, (-math.inf, math.inf))}
    distortion = measure_distortion(whole)
    for period in PERIODS_PX:
        progress(reading.name, len(captures), total)
        wave = drawn(sinusoid(period), frame)
        name = f"1/{period} cycles/px"
        captures[name], picture = rate_of(reading.camera, wave, middle(reading))
        peaks.append(peak_of(picture, reading, lens, period))
    progress(reading.name, len(captures), total)
    captures["eSFR chart"], picture = rate_of(reading.camera, chart(reading.camera.frame))
    progress(reading.name, total, total)
    certificates = certificates_of(captures, TOLERANCE)
    return Read(reading, lens, distortion, rate, peaks, certificates, picture)


def bars(found: list[Read]) -> list[Bar]:
    """Return what has to hold."""
    return [bar for one in found for bar in one.bars()]
