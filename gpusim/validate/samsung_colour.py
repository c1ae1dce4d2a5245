"""Colours of the Samsung validation: 18 patches of a ColorChecker through LibRaw, which is dcraw's.

A raw of the sensor is developed with its own black level, white balance and matrix (the paper's
figure 12), to XYZ, which cuts no colour off. What that must give is computed here from
reflectances, light, quantum efficiency and the lens's transmission,

    e_c = integral rho(l) S(l) T(l) QE_c(l) l dl,        XYZ = M_sRGB (M_cam)^-1 (e / e_white),

M_cam the file's matrix from XYZ times M_sRGB, rows scaled to a sum of 1 (dcraw 9.28,
cam_xyz_coeff). Against the chart the colours differ, for the sensor meets no Luther condition.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.lens.prescription import Prescription
from gpusim.lens.system import System, build
from gpusim.library.expose import expose
from gpusim.scene import make_scene
from gpusim.scene.colorimetry import adaptation
from gpusim.sensor.load import load_sensor
from gpusim.validate.bars import Bar
from gpusim.validate.certified import Certified, certificates_of
from gpusim.validate.samsung_camera import SENSOR, STANDARD, camera_of
from gpusim.validate.tracers import refracted_losses

ROWS, COLS = 760, 1012  # a quarter of the sensor's sides: patches of 138 px
TOLERANCE, PROBES, SEED = 4e-3, 8, 477
PATCHES = 18  # with colour
PER_ROW, PITCH, SIDE = 6, 0.42, 0.365  # of the chart, half-heights
INNER = 0.5  # of a patch's side is measured
XY_BAR = 0.002
# IEC 61966-2-1, in the digits of dcraw 9.28 (xyz_rgb).
SRGB_TO_XYZ = np.array([
    [0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]
])  # fmt: skip
LIGHT, CAMERA_LIGHT = "D50", "D65"  # of the scene, and for which the file's matrix holds
GRID_NM = (400, 700, 5)


@dataclass(frozen=True, eq=False)
class Colours:
    """Chromaticities of the chart's patches.

    Attributes
    ----------
    names : tuple of str
    developed, truth, chart : ndarray (24, 2)
        CIE xy of the developed picture, of what the model's own equations make of the patches, and
        of the patches themselves, adapted from the light of the scene to that of sRGB (Bradford).
    picture : ndarray (rows, cols, 3)
        The developed picture, sRGB.
    certificates : dict of str to Certified
    """

    names: tuple[str, ...]
    developed: np.ndarray
    truth: np.ndarray
    chart: np.ndarray
    picture: np.ndarray
    certificates: dict[str, Certified]

    @property
    def misses(self) -> np.ndarray:
        """Distances (24,) of the developed colours from the model's truth."""
        return np.hypot(*(self.developed - self.truth).T)

    @property
    def from_chart(self) -> np.ndarray:
        """Distances (24,) of the developed colours from the chart's."""
        return np.hypot(*(self.developed - self.chart).T)

    def bars(self) -> list[Bar]:
        """Return what has to hold."""
        name = f"chromaticity of {PATCHES} patches through LibRaw, against the model's truth"
        return [Bar.largest(name, self.misses[:PATCHES], XY_BAR, "xy")]


def measure_colours(lens: Prescription) -> Colours:
    """Render the chart before a lens, develop it, and predict its colours."""
    sensor = load_sensor(SENSOR).model_copy(update={"veiling_glare": 0.0}).roi(ROWS, COLS)
    camera, scene = camera_of(STANDARD, lens, sensor), make_scene("colorchecker")
    light = expose(camera, scene, TOLERANCE, probes=PROBES)
    frame = light.capture(seed=SEED)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "chart.dng"
        frame.save(file)
        xyz, picture = developed(file)
    light.release()
    truth, chart, names = predicted(sensor.qe, build(lens))
    return Colours(
        names,
        xy(patch_means(xyz)),
        xy(truth),
        xy(chart),
        picture,
        certificates_of({"colour": light}, TOLERANCE),
    )


def developed(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return XYZ (rows, cols, 3) of a raw file by LibRaw, and the picture in sRGB, 8 bits."""
    import rawpy

    same = {
        "use_camera_wb": True,
        "no_auto_bright": True,
        "adjust_maximum_thr": 0.0,  # or LibRaw takes the brightest sample for saturation
        "demosaic_algorithm": rawpy.DemosaicAlgorithm.AHD,
    }
    with rawpy.imread(str(file)) as raw:
        xyz = raw.postprocess(
            gamma=(1, 1), output_bps=16, output_color=rawpy.ColorSpace.XYZ, **same
        )
        return xyz.astype(float), raw.postprocess(output_color=rawpy.ColorSpace.sRGB, **same)


def patch_means(picture: np.ndarray) -> np.ndarray:
    """Return the means (24, 3) of the middles of the patches of a picture (rows, cols, 3)."""
    half, reach = picture.shape[0] / 2, INNER * SIDE * picture.shape[0] / 4
    found = []
    for number in range(24):
        row, col = divmod(number, PER_ROW)
        x = picture.shape[1] / 2 + (col - 2.5) * PITCH * half
        y = half + (row - 1.5) * PITCH * half
        cols, rows = (slice(round(at - reach), round(at + reach)) for at in (x, y))
        found.append(picture[rows, cols].mean((0, 1)))
    return np.array(found)


def xy(xyz: np.ndarray) -> np.ndarray:
    """Return chromaticities (N, 2)."""
    return xyz[:, :2] / xyz.sum(axis=1, keepdims=True)


def predicted(
    qe: dict[str, np.ndarray], system: System
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return XYZ (24, 3) by the model's equations, the chart's own, and the patches' names.

    Reflectances, lights and the observer are those of colour-science.
    """
    import colour

    shape = colour.SpectralShape(*GRID_NM)
    nm = shape.wavelengths
    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"]
    reflectances = np.array([sd.copy().align(shape).values for sd in patches.values()])
    own, daylight = (
        colour.SDS_ILLUMINANTS[name].copy().align(shape).values for name in (LIGHT, CAMERA_LIGHT)
    )
    observer = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape).values
    passed = refracted_losses(system, nm)
    counts = np.stack([qe[name] * passed * nm for name in "RGB"])
    to_xyz = SRGB_TO_XYZ @ np.linalg.inv(_camera_of_srgb(counts, reflectances * daylight, daylight,
                                                         observer))  # fmt: skip
    balanced = (reflectances * own) @ counts.T / (counts @ own)
    seen, white = (reflectances * own) @ observer, own @ observer
    adapted = adaptation(white / white[1], SRGB_TO_XYZ.sum(axis=1))
    return balanced @ to_xyz.T, seen / white[1] @ adapted.T, tuple(patches)


def _camera_of_srgb(
    counts: np.ndarray, patches: np.ndarray, white: np.ndarray, observer: np.ndarray
) -> np.ndarray:
    """Return the matrix (3, 3) from linear sRGB to the balanced colours of a camera.

    The file's matrix from XYZ is that of least squares over patches (24, K) which keeps the white:
    minimise |seen a - counted|^2 with sum(a) = 1, by Lagrange's multiplier.
    """
    white_xyz, white_counts = white @ observer, counts @ white
    seen, counted = patches @ observer / white_xyz, patches @ counts.T / white_counts
    one = np.ones((3, 1))
    system = np.block([[seen.T @ seen, one], [one.T, np.zeros((1, 1))]])
    right = np.vstack([seen.T @ counted, np.ones((1, 3))])
    matrix = np.linalg.solve(system, right)[:3].T * white_counts[:, None] / white_xyz
    camera = matrix @ SRGB_TO_XYZ
    return camera / camera.sum(axis=1, keepdims=True)
